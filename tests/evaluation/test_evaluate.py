import csv
import dataclasses
import json
import math

import cv2
import numpy as np
import pytest
import torch
from rich.console import Console

from mobilestereonet.cli.calibration import RigFiles
from mobilestereonet.cli.engine import MatcherOptions
from mobilestereonet.cli.evaluate import evaluate as run_command
from mobilestereonet.cli.scoring import ScoringOptions
from mobilestereonet.cli.table_options import TableOptions
from mobilestereonet.data.disparity_files import write_disparity_png
from mobilestereonet.data.files import write_png
from mobilestereonet.data.rig import Camera, CameraPair, Rig
from mobilestereonet.data.sample import Calibration, StereoSample
from mobilestereonet.engines.sgbm import StereoSGBM
from mobilestereonet.errors import InputError
from mobilestereonet.evaluation import (
    EvaluationProtocol,
    authors_protocol,
    evaluate,
    save_evaluations,
)
from mobilestereonet.inference import Rectifier
from mobilestereonet.nets import Prediction, build_model
from mobilestereonet.settings import parse_assignments
from mobilestereonet.weights import save_weights

SCALE = 100.0


def _match(left, right):
    """A matcher whose disparity is the red channel of the left view times `SCALE`."""
    assert left.shape == right.shape and left.ndim == 4
    return left[:, 0] * SCALE


def _sample(name, height, width, error=2.0, **maps) -> StereoSample:
    """The matcher is wrong by ``error`` px at every pixel of this sample."""
    generator = torch.Generator().manual_seed(height * width)
    left = torch.rand(3, height, width, generator=generator) * 0.5 + 0.2
    disparity = left[0] * SCALE - error
    calibration = Calibration(focal=100, baseline=0.1)
    valid = torch.ones_like(disparity, dtype=torch.bool)
    return StereoSample(left, left, disparity, valid, calibration=calibration, name=name, **maps)


def _evaluate(data, match=_match, **options):
    return evaluate(match, data, model="red", data_name="made up", **options)


def test_figures():
    data = [_sample("a", 4, 6, error=2.0), _sample("b", 8, 6, error=4.0)]
    result = _evaluate(data, thresholds=(1, 3))
    scores = result.scores.masks["all"]
    assert scores.per_image["epe"] == pytest.approx(3.0, abs=1e-4)
    assert scores.per_pixel["epe"] == pytest.approx(10 / 3, abs=1e-4)  # 24 px of 2, 48 px of 4
    assert (scores.per_image["bad1"], scores.per_image["bad3"]) == (100.0, 50.0)
    assert (scores.images, scores.pixels) == (2, 72)
    assert result.seconds_per_image > 0


def test_batches_hold_samples_of_one_kind():
    occluded = torch.zeros(4, 6, dtype=torch.bool)
    occluded[:, :3] = True
    data = [
        _sample("a", 4, 6, 1.0),
        _sample("b", 4, 6, 2.0, occluded=occluded),
        _sample("c", 4, 6, 3.0, occluded=~occluded),
        _sample("d", 4, 8, 4.0),
        _sample("e", 4, 8, 5.0),
        _sample("f", 4, 8, 6.0),
    ]
    seen = []

    def match(left, right):
        seen.append(tuple(left.shape))
        return _match(left, right)

    batched = _evaluate(data, match, batch_size=2).scores
    assert seen == [(1, 3, 4, 6), (2, 3, 4, 6), (2, 3, 4, 8), (1, 3, 4, 8)]
    single = _evaluate(data, batch_size=1).scores
    assert list(batched.masks) == ["all", "noc", "occ"]
    assert batched.masks["noc"].images == 2
    for mask, scores in batched.masks.items():
        assert scores.per_image == pytest.approx(single.masks[mask].per_image, rel=1e-12)


def test_the_authors_protocols():
    assert authors_protocol("sceneflow") == EvaluationProtocol(192, 0.1, crop=(512, 960))
    assert authors_protocol("kitti2015") == EvaluationProtocol(192, 0.1, padding=(384, 1248))
    assert authors_protocol("kitti2012").padding == (384, 1248)
    assert authors_protocol("eth3d") == EvaluationProtocol(192, 0.1)


def test_crop_takes_the_bottom_right():
    sample = _sample("a", 6, 9)
    sample.disparity[:2] = 1  # far off, but above the crop
    sample.disparity[:, :4] = 1  # and left of it

    def match(left, right):
        assert torch.equal(left[0], sample.left[:, 2:, 4:])
        return _match(left, right)

    scores = _evaluate([sample], match, protocol=EvaluationProtocol(crop=(4, 5))).scores
    assert scores.masks["all"].pixels == 20
    assert scores.masks["all"].per_image["epe"] == pytest.approx(2.0, abs=1e-4)
    with pytest.raises(InputError, match="cannot crop 7x5 from a frame of 6x9"):
        _evaluate([sample], protocol=EvaluationProtocol(crop=(7, 5)))


def test_min_share_comes_from_the_protocol():
    sample = _sample("a", 4, 6)
    sample.disparity[:] = 200
    scores = _evaluate([sample], protocol=EvaluationProtocol(min_share=0.1)).scores
    assert scores.masks["all"].skipped == 1


def test_pictures(tmp_path):
    _evaluate([_sample("scene/a", 40, 60), _sample("b", 30, 50)], pictures=tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["b.png", "scene_a.png"]
    picture = cv2.imread(str(tmp_path / "scene_a.png"))
    assert picture.shape[1] == 3 * 60 + 2 * 4
    # An error of 2 px at 18 to 68 px: 2 / 3 of the threshold, KITTI's last cold colour.
    np.testing.assert_array_equal(picture[-20, -30, ::-1], (224, 243, 248))


def test_pictures_share_the_range_of_the_ground_truth(tmp_path):
    sample = _sample("a", 30, 50)
    last = (122, 4, 3)  # turbo's
    for factor in (0.5, 4):
        _evaluate([sample], lambda left, _, f=factor: f * sample.disparity[None], pictures=tmp_path)
        disparity = cv2.imread(str(tmp_path / "a.png"))[-30:, 54:104, ::-1]
        assert (disparity == last).all(2).any() == (factor > 1)


def test_a_sparse_error_map_shows_thick_points(tmp_path):
    sample = _sample("a", 30, 50)
    valid = torch.zeros(30, 50, dtype=torch.bool)
    valid[10, 20] = valid[10, 23] = True
    prediction = sample.disparity.clone()
    prediction[10, 23] += 100
    _evaluate(
        [dataclasses.replace(sample, valid=valid)], lambda *_: prediction[None], pictures=tmp_path
    )
    errors = cv2.imread(str(tmp_path / "a.png"))[-30:, -50:, ::-1]
    assert (errors[9:12, 19:22] == (49, 54, 149)).all()
    assert (errors[9:12, 22:25] == (165, 0, 38)).all()
    assert (errors != 0).any(2).sum() == 18


def test_json(tmp_path):
    protocol = EvaluationProtocol(max_disparity=math.inf)
    save_evaluations([_evaluate([_sample("a", 4, 6)], protocol=protocol)], json=tmp_path / "a.json")
    (record,) = json.loads((tmp_path / "a.json").read_text())
    assert (record["model"], record["data"]) == ("red", "made up")
    assert record["protocol"]["max_disparity"] is None
    assert record["masks"]["all"]["pixels"] == 24
    assert record["masks"]["all"]["median"]["epe"] == pytest.approx(2.0, abs=1e-4)
    (pair,) = record["pairs"]
    assert (pair["pair"], pair["d1_all"], pair["d1_noc"]) == ("a", 0.0, None)


def _half_occluded() -> torch.Tensor:
    return (torch.arange(6) < 3).expand(4, 6)


def test_csv_files(tmp_path):
    data = [_sample("a", 4, 6, error=1.5, occluded=_half_occluded()), _sample("b, c", 4, 6, 5.0)]
    evaluations = [_evaluate(data), _evaluate(data[1:])]
    save_evaluations(evaluations, summary=tmp_path / "all.csv", pairs=tmp_path / "pairs.csv")
    with (tmp_path / "pairs.csv").open(newline="") as file:
        pairs = list(csv.DictReader(file))
    assert [row["pair"] for row in pairs] == ["a", "b, c", "b, c"]
    assert [float(row["epe_all"]) for row in pairs] == pytest.approx([1.5, 5, 5], abs=1e-4)
    assert [row["bad1_noc"] for row in pairs] == ["100.0", "", ""]
    assert [row["pixels_noc"] for row in pairs] == ["12", "", ""]
    assert all(float(row["seconds"]) > 0 for row in pairs)
    with (tmp_path / "all.csv").open(newline="") as file:
        first, second = csv.DictReader(file)
    assert first["model"] == "red" and first["pairs"] == "2"
    assert float(first["epe_all_median"]) == pytest.approx(3.25, abs=1e-4)
    assert float(first["epe_noc_mean"]) == pytest.approx(1.5, abs=1e-4)
    assert first["bad2_all_mean"] == "50.0"
    assert second["epe_noc_mean"] == second["pixels_noc"] == ""


def test_the_table_says_the_protocol_and_what_is_unknown():
    def text(data, **options):
        console = Console(width=100)
        with console.capture() as capture:
            console.print(_evaluate(data, protocol=EvaluationProtocol(**options)))
        return capture.get()

    known = text([_sample("a", 4, 6, occluded=_half_occluded())], min_share=0.1)
    words = " ".join(known.split())
    for part in ("mean", "median", "per pixel", "noc (not occluded)", "occ (occluded)", "2.000"):
        assert part in words
    assert "0 < d < 192" in words and "Skipped: images where fewer than 10 %" in words
    assert all(title in words for title in ("EPE", "bad-1", "bad-2", "D1", "GT"))
    rows = (line.split() for line in text([_sample("a", 4, 6)]).splitlines())
    (row,) = (row for row in rows if row[:1] == ["noc"])
    assert set(row[1:]) == {"-"}


def test_empty_and_skipped_images_have_their_columns():
    far = _sample("far", 4, 6)
    far.disparity[:] = 200
    evaluation = _evaluate([_sample("a", 4, 6), far], protocol=EvaluationProtocol(min_share=0.1))
    assert [column.header for column in evaluation.table().columns][-1] == "skipped"
    assert [row["d1_all"] for row in evaluation.pair_rows()] == [0.0, None]


def test_a_set_without_a_pixel_to_score_is_an_error():
    unknown = _sample("a", 4, 6)
    unknown.valid[:] = False
    with pytest.raises(InputError, match="made up: none of its 2 pairs has a pixel with ground"):
        _evaluate([unknown, unknown])
    assert _evaluate([unknown, _sample("b", 4, 6)]).scores.masks["all"].empty == 1


def test_bad_input():
    sample = _sample("a", 4, 6)
    with pytest.raises(InputError, match="made up has no sample"):
        _evaluate([])
    with pytest.raises(InputError, match="no ground truth"):
        _evaluate([StereoSample(sample.left, sample.right, name="bare")])
    with pytest.raises(InputError, match="24 disparities that are not finite"):
        _evaluate([sample], lambda left, right: _match(left, right) * math.nan)
    with pytest.raises(InputError, match="gave shape"):
        _evaluate([sample], lambda left, right: left)


def test_options_of_data_sets():
    assert parse_assignments(["size=H", "webp=true", "scale=4"]) == {
        "size": "H",
        "webp": True,
        "scale": 4,
    }
    with pytest.raises(InputError, match="key=value"):
        parse_assignments(["size"])


@pytest.fixture
def kitti(tmp_path):
    """Three KITTI 2015 frames of noise, shifted by 8 px, the right half of it foreground."""
    noise = np.random.default_rng(0).integers(0, 255, (32, 100, 3), dtype=np.uint8)
    training = tmp_path / "kitti" / "training"
    for index in range(3):
        name = f"{index:06d}_10.png"
        write_png(training / "image_2" / name, np.ascontiguousarray(noise[:, :80]))
        write_png(training / "image_3" / name, np.ascontiguousarray(noise[:, 8:88]))
        truth = np.full((32, 80), 8 + 4 * (index == 2), np.float32)
        truth[:, :20] = 0
        write_disparity_png(training / "disp_occ_0" / name, truth)
        objects = np.repeat(np.arange(80)[None] >= 40, 32, axis=0).astype(np.uint8)
        write_png(training / "obj_map" / name, objects)
    return tmp_path / "kitti"


@pytest.mark.filterwarnings("ignore:kitti2015")
def command(data, root, model=None, weights=None, **values):
    names = {field.name for field in dataclasses.fields(ScoringOptions)}
    scoring = {name: values.pop(name) for name in list(values) if name in names}
    run_command(
        ScoringOptions(data=data, root=root, **scoring),
        options=MatcherOptions(weights=weights),
        model=model,
        tables=TableOptions(),
        **{"cameras": RigFiles(), **values},
    )


def test_command(kitti, tmp_path, capsys):
    report, pictures = tmp_path / "report.json", tmp_path / "pictures"
    tables = {"csv": tmp_path / "all.csv", "per_pair": tmp_path / "folder/pairs.csv"}
    command("kitti2015", kitti, ["sgbm"], batch_size=2, json=report, pictures=pictures, **tables)
    assert [len(table.read_text().splitlines()) for table in tables.values()] == [1 + 1, 1 + 3]
    text = capsys.readouterr().out
    assert "sgbm on kitti2015 (training)" in text
    assert "median" in text and "per pixel" in text and "fg" in text
    (record,) = json.loads(report.read_text())
    assert record["masks"]["all"]["per_image"]["epe"] == pytest.approx(4 / 3, abs=0.05)
    assert record["masks"]["fg"]["pixels"] == 3 * 32 * 40
    assert len(list((pictures / "sgbm").iterdir())) == 3


def test_raw_views_are_rectified(tmp_path, capsys):
    """The right camera is turned; the truth is that of the rectified left view."""
    noise = np.random.default_rng(0).integers(0, 255, (48, 120, 3), dtype=np.uint8)
    scene = cv2.GaussianBlur(noise, (0, 0), 1)
    matrix, turned = np.array([[90.0, 0, 50], [0, 90, 24], [0, 0, 1]]), np.array([0.0, 0, 0.05])
    warp = matrix @ cv2.Rodrigues(turned)[0] @ np.linalg.inv(matrix)
    right = cv2.warpPerspective(scene[:, 8:108], warp, (100, 48))
    write_png(tmp_path / "left/a.png", np.ascontiguousarray(scene[:, :100]))
    write_png(tmp_path / "right/a.png", right)
    lens = {"K1": matrix, "D1": np.zeros(5), "K2": matrix, "D2": np.zeros(5)}
    np.savez(tmp_path / "rig.npz", **lens, R=cv2.Rodrigues(turned)[0], T=np.array([-0.1, 0, 0]))
    rectifier = RigFiles(rig=[tmp_path / "rig.npz"])
    calibration = rectifier.read().calibration((100, 48))
    truth = np.full((48, 100), 8 * calibration.focal / 90, np.float32)
    write_disparity_png(tmp_path / "disparity/a.png", truth)
    figures = []
    for cameras in (rectifier, RigFiles()):
        options = {"settings": ["disparity=disparity/*.png", "scale=256"], "cameras": cameras}
        command("folder", tmp_path, ["sgbm"], json=tmp_path / "a.json", **options)
        (record,) = json.loads((tmp_path / "a.json").read_text())
        figures.append(record["masks"]["all"]["per_image"]["epe"])
    assert figures[0] < 0.3 < 1 < figures[1]


def test_rectified_data_is_not_rectified_again():
    sample = _sample("a", 40, 64)
    lens = Camera(np.array([[60.0, 0, 32], [0, 60, 20], [0, 0, 1]]), np.zeros(5))
    turned = cv2.Rodrigues(np.array([0, 0, 0.02]))[0]
    raw = CameraPair(lens, lens, turned, np.array([-0.1, 0, 0]), (64, 40))
    with pytest.raises(InputError, match="a: its views are rectified already"):
        Rectifier(Rig((raw,))).sample(sample)
    raw_sample = dataclasses.replace(sample, calibration=None, disparity=sample.disparity[1:])
    with pytest.raises(InputError, match="truth has 64x39, the rectified views 64x40"):
        Rectifier(Rig((raw,))).sample(raw_sample)
    rectified = Calibration(70, 0.2)
    known = Rectifier(Rig((rectified,))).sample(sample)
    assert known.calibration == dataclasses.replace(rectified, size=(64, 40))
    assert known.left is sample.left


@pytest.mark.filterwarnings("ignore:kitti2015")
def test_the_legend_comes_once_at_the_end(kitti, capsys):
    command("kitti2015", kitti, ["sgbm", "sgbm"])
    text = " ".join(capsys.readouterr().out.split())
    assert text.count("sgbm on kitti2015") == 2 and "sgbm (2)" in text
    for words in ("fg (foreground)", "bg (background)", "bad-t: share", "Skipped: images"):
        assert text.count(words) == 1
    assert text.rindex("bad-3") < text.index("fg (foreground)")


@pytest.mark.filterwarnings("ignore:kitti2015")
def test_command_with_a_network_under_the_authors_protocol(kitti, tmp_path, monkeypatch):
    weights, report = tmp_path / "some.safetensors", tmp_path / "report.json"
    torch.manual_seed(0)
    save_weights(build_model("msnet2d", max_disparity=32), weights)
    seen = []
    monkeypatch.setattr(
        "mobilestereonet.engines.torch.TorchEngine.__call__",
        lambda self, left, right, confidence: seen.append(left) or Prediction(left[:, 0]),
    )
    command("kitti2015", kitti, weights=weights, authors=True, json=report)
    assert {tuple(view.shape) for view in seen} == {(1, 3, 384, 1248)}
    assert all(not view[..., :-32, :].any() and not view[..., 80:].any() for view in seen)
    (record,) = json.loads(report.read_text())
    assert record["model"] == "msnet2d (some.safetensors)"
    assert record["protocol"]["padding"] == [384, 1248]
    assert record["protocol"]["min_share"] == 0.1


@pytest.mark.filterwarnings("ignore:kitti2015")
def test_sgbm_is_not_padded_under_the_authors_protocol(kitti, tmp_path):
    reports = [tmp_path / "ours.json", tmp_path / "authors.json"]
    for authors, report in zip((False, True), reports, strict=True):
        command("kitti2015", kitti, ["sgbm"], authors=authors, json=report)
    ours, theirs = (json.loads(report.read_text())[0] for report in reports)
    assert theirs["masks"] == ours["masks"]
    assert theirs["protocol"]["padding"] is None


@pytest.mark.filterwarnings("ignore:kitti2015")
def test_command_with_bad_input(kitti, tmp_path, monkeypatch):
    with monkeypatch.context() as patch, pytest.raises(InputError, match="is a folder: name the"):
        patch.setattr(StereoSGBM, "__call__", lambda *_: pytest.fail("pairs were matched"))
        command("kitti2015", kitti, ["sgbm"], json=tmp_path)
    with pytest.raises(InputError, match="unknown data set 'kitty': did you mean"):
        command("kitty", kitti, ["sgbm"])
    with pytest.raises(InputError, match="no option 'size'"):
        command("kitti2015", kitti, ["sgbm"], settings=["size=H"])
    (kitti / "training").rename(kitti / "testing")
    with pytest.raises(InputError, match="no ground truth: choose another split"):
        command("kitti2015", kitti, ["sgbm"], split="testing")
    with pytest.raises(InputError, match="belongs to one model"):
        command("kitti2015", kitti, ["sgbm", "msnet2d"], weights=tmp_path / "w.safetensors")
