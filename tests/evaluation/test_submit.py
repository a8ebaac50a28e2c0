import zipfile
from dataclasses import replace

import cv2
import numpy as np
import pytest
import torch

from mobilestereonet.cli.engine import MatcherOptions
from mobilestereonet.cli.submit import submit as command
from mobilestereonet.data.files import read_pfm, write_pfm, write_png
from mobilestereonet.data.sample import StereoSample
from mobilestereonet.errors import InputError
from mobilestereonet.evaluation import (
    BENCHMARKS,
    Benchmark,
    Submission,
    check_submission,
    open_benchmark,
    plan_submission,
    write_submission,
)

SIZE = (4, 6)
PNG = Submission({"a": "disp_0/a.png", "b": "disp_0/b.png"})
PFM = Submission({"a": "low/a.pfm"}, {"a": "low/a.txt"}, "runtime ")


def _match(left, right):
    return left[:, 0] * 100


def _samples(scenes):
    for index, scene in enumerate(scenes):
        views = torch.full((3, *SIZE), 0.1 * (index % 5))
        yield StereoSample(views, views, name=f"somewhere/{scene}")


def test_names_that_the_servers_take():
    kitti2015 = list(plan_submission("kitti2015", "m").maps.values())
    assert len(kitti2015) == 200
    assert (kitti2015[0], kitti2015[-1]) == ("disp_0/000000_10.png", "disp_0/000199_10.png")
    kitti2012 = list(plan_submission("kitti2012", "m").maps.values())
    assert len(kitti2012) == 195
    assert (kitti2012[0], kitti2012[-1]) == ("000000_10.png", "000194_10.png")
    eth3d = plan_submission("eth3d", "m")
    assert len(set(eth3d.maps.values()) | set(eth3d.runtimes.values())) == 94
    assert eth3d.maps["lakeside_1l"] == "low_res_two_view/lakeside_1l.pfm"
    assert eth3d.runtimes["delivery_area_3s"] == "low_res_two_view/delivery_area_3s.txt"


def test_names_that_middlebury_takes():
    plan = plan_submission("middlebury", "Ours", "H")
    assert len(plan.maps) == len(plan.runtimes) == 30
    assert plan.maps["Adirondack"] == "trainingH/Adirondack/disp0Ours.pfm"
    assert plan.runtimes["Staircase"] == "testH/Staircase/timeOurs.txt"
    trial = plan_submission("middlebury", "Ours", training_only=True)
    assert len(trial.maps) == 15
    assert all(name.startswith("trainingQ/") for name in trial.maps.values())


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        (("kitti2016", "m"), "unknown benchmark 'kitti2016'"),
        (("middlebury", "m", "X"), "size is one of Q, H, F, got 'X'"),
        (("middlebury", "a/b"), "'a/b'"),
        (("middlebury", "ours_s"), "no _s at the end"),
        (("kitti2015", "m", "Q", True), "training scenes alone"),
    ],
)
def test_bad_plans(arguments, word):
    with pytest.raises(InputError, match=word):
        plan_submission(*arguments)


def test_kitti_archive(tmp_path):
    archive = tmp_path / "out.zip"
    write_submission(PNG, _match, _samples("ab"), archive)
    assert list(tmp_path.iterdir()) == [archive]
    with zipfile.ZipFile(archive) as file:
        assert file.namelist() == ["disp_0/a.png", "disp_0/b.png"]
        maps = [
            cv2.imdecode(np.frombuffer(file.read(name), np.uint8), cv2.IMREAD_UNCHANGED)
            for name in file.namelist()
        ]
    assert [values.dtype for values in maps] == [np.uint16] * 2
    # 0 px is the smallest disparity that is not "no estimate", 10 px are 2560.
    np.testing.assert_array_equal(maps, [np.full(SIZE, 1), np.full(SIZE, 2560)])


def test_pfm_archive(tmp_path):
    calls = []

    def match(left, right):
        calls.append(left.shape)
        return _match(left, right) + 7

    write_submission(PFM, match, _samples("a"), tmp_path / "out.zip")
    assert len(calls) == 2  # the first one warms up
    with zipfile.ZipFile(tmp_path / "out.zip") as file:
        file.extractall(tmp_path / "files")
    np.testing.assert_array_equal(read_pfm(tmp_path / "files/low/a.pfm"), np.full(SIZE, 7))
    label, seconds = (tmp_path / "files/low/a.txt").read_text().split()
    assert label == "runtime" and 0 < float(seconds) < 1


@pytest.mark.parametrize("benchmark", ["eth3d", "middlebury", "kitti2015"])
def test_whole_archives_pass_the_check(tmp_path, benchmark):
    plan = plan_submission(benchmark, "Ours")
    write_submission(plan, _match, _samples(plan.maps), tmp_path / "out.zip")
    with zipfile.ZipFile(tmp_path / "out.zip") as file:
        assert set(file.namelist()) == {*plan.maps.values(), *plan.runtimes.values()}


@pytest.mark.parametrize(
    ("scenes", "word"),
    [("a", r"out\.zip: lacks disp_0/b\.png"), ("abc", "somewhere/c is no scene")],
)
def test_nothing_is_left_of_a_wrong_archive(tmp_path, scenes, word):
    with pytest.raises(InputError, match=word):
        write_submission(PNG, _match, _samples(scenes), tmp_path / "out.zip")
    assert not list(tmp_path.iterdir())


def test_a_disparity_too_large_for_kitti(tmp_path):
    with pytest.raises(InputError, match="does not fit 16 bits"):
        write_submission(PNG, lambda a, b: _match(a, b) + 300, _samples("ab"), tmp_path / "o.zip")


def _check(plan, folder, extra=()):
    archive = folder.parent / "archive.zip"
    with zipfile.ZipFile(archive, "w") as file:
        for path in sorted(folder.rglob("*.*")):
            file.write(path, path.relative_to(folder).as_posix())
        for name in extra:
            file.writestr(name, "more")
    check_submission(plan, archive, dict.fromkeys(plan.maps, SIZE))


@pytest.fixture
def png_folder(tmp_path):
    for name in PNG.maps.values():
        write_png(tmp_path / "files" / name, np.full(SIZE, 256, np.uint16))
    return tmp_path / "files"


@pytest.fixture
def pfm_folder(tmp_path):
    write_pfm(tmp_path / "files" / "low/a.pfm", np.ones(SIZE, np.float32))
    (tmp_path / "files/low/a.txt").write_text("runtime 0.25\n")
    return tmp_path / "files"


def test_the_checker_takes_what_is_right(png_folder):
    _check(PNG, png_folder, extra=["disp_0/"])


def test_the_checker_refuses_wrong_names_and_counts(png_folder):
    with pytest.raises(InputError, match=r"should not, readme\.txt \(1 such files; 2 are exp"):
        _check(PNG, png_folder, extra=["readme.txt"])
    with pytest.raises(InputError, match=r"lacks disp_0/b\.png .* 2 are expected, 1 are there"):
        (png_folder / "disp_0/b.png").unlink()
        _check(PNG, png_folder)


@pytest.mark.filterwarnings("ignore:Duplicate name")
def test_the_checker_refuses_a_name_that_is_there_twice(png_folder):
    with pytest.raises(InputError, match=r"has twice disp_0/a\.png"):
        _check(PNG, png_folder, extra=["disp_0/a.png"])


@pytest.mark.parametrize(
    ("image", "word"),
    [
        (np.full(SIZE, 200, np.uint8), "16 bits, this one is uint8"),
        (np.full((*SIZE, 3), 200, np.uint16), r"shape is \(4, 6, 3\)"),
        (np.full((4, 7), 200, np.uint16), r"shape is \(4, 7\), its left view has \(4, 6\)"),
        (np.zeros(SIZE, np.uint16), "every value is 0"),
    ],
)
def test_the_checker_refuses_wrong_pngs(png_folder, image, word):
    write_png(png_folder / "disp_0/b.png", image)
    with pytest.raises(InputError, match=rf"disp_0/b\.png: .*{word}"):
        _check(PNG, png_folder)


@pytest.mark.parametrize(
    ("values", "word"),
    [
        (np.full(SIZE, np.nan), "negative or not finite"),
        (np.full(SIZE, np.inf), "negative or not finite"),
        (np.full(SIZE, -1), "negative or not finite"),
        (np.ones((5, 6)), r"shape is \(5, 6\)"),
        (np.ones((*SIZE, 3)), r"shape is \(4, 6, 3\)"),
    ],
)
def test_the_checker_refuses_wrong_pfms(pfm_folder, values, word):
    _check(PFM, pfm_folder)
    write_pfm(pfm_folder / "low/a.pfm", values)
    with pytest.raises(InputError, match=rf"low/a\.pfm: .*{word}"):
        _check(PFM, pfm_folder)


@pytest.mark.parametrize("text", ["", "0.25", "runtime", "runtime 0", "runtime nan", "time 1"])
def test_the_checker_refuses_wrong_runtimes(pfm_folder, text):
    (pfm_folder / "low/a.txt").write_text(text)
    with pytest.raises(InputError, match="must hold 'runtime SECONDS'"):
        _check(PFM, pfm_folder)


def test_middleburys_runtime_is_the_number_alone(pfm_folder):
    with pytest.raises(InputError, match=r"must hold 'SECONDS', got 'runtime 0\.25'"):
        _check(replace(PFM, runtime_label=""), pfm_folder)


def test_the_checker_refuses_a_file_that_is_no_zip(tmp_path):
    archive = tmp_path / "out.zip"
    archive.write_text("no zip")
    with pytest.raises(InputError, match=r"out\.zip: not a whole ZIP archive"):
        check_submission(PNG, archive, {})
    with pytest.raises(FileNotFoundError):
        check_submission(PNG, tmp_path / "absent.zip", {})


def _frames(folder, count):
    noise = np.random.default_rng(0).integers(0, 255, (16, 40, 3), dtype=np.uint8)
    for index in range(count):
        for camera, start in (("colored_0", 0), ("colored_1", 4)):
            view = np.ascontiguousarray(noise[:, start : start + 32])
            write_png(folder / "testing" / camera / f"{index:06d}_10.png", view)


def test_command(tmp_path, capsys):
    _frames(tmp_path / "kitti", 195)
    sgbm = MatcherOptions(model="sgbm")
    command("kitti2012", tmp_path / "kitti", tmp_path / "out.zip", options=sgbm)
    assert "195 disparity maps; names" in capsys.readouterr().out
    with pytest.raises(InputError, match="is a folder: name the ZIP file"):
        command("kitti2012", tmp_path / "kitti", tmp_path, options=sgbm)
    with zipfile.ZipFile(tmp_path / "out.zip") as file:
        values = cv2.imdecode(np.frombuffer(file.read("000194_10.png"), np.uint8), -1)
    assert values.shape == (16, 32) and np.median(values) == 4 * 256


def test_a_trial_of_what_is_there(tmp_path, capsys):
    _frames(tmp_path / "kitti", 3)
    sgbm, archive = MatcherOptions(model="sgbm"), tmp_path / "out.zip"
    command("kitti2012", tmp_path / "kitti", archive, options=sgbm, partial=True)
    told = capsys.readouterr().out
    assert (
        "3 disparity maps; a trial, which the server refuses: it lacks 192 scenes, 000003_10"
        in told
    )
    with zipfile.ZipFile(archive) as file:
        assert file.namelist() == [f"00000{index}_10.png" for index in range(3)]
    (tmp_path / "kitti/testing/colored_1/000001_10.png").unlink()
    with pytest.raises(FileNotFoundError, match=r"000001_10\.png: its right view"):
        command("kitti2012", tmp_path / "kitti", archive, options=sgbm, partial=True)
    with pytest.raises(FileNotFoundError, match="nothing found"):
        open_benchmark("kitti2012", tmp_path, partial=True)


def test_a_trial_without_one_of_the_splits(tmp_path):
    for view in ("im0", "im1"):
        write_png(tmp_path / f"trainingQ/Piano/{view}.png", np.zeros((4, 6, 3), np.uint8))
    write_pfm(tmp_path / "trainingQ/Piano/disp0GT.pfm", np.ones((4, 6), np.float32))
    (part,) = open_benchmark("middlebury", tmp_path, partial=True)
    assert [frame.name for frame in part.frames] == ["Piano"]


def test_a_benchmark_is_one_entry(tmp_path, monkeypatch):
    """A new one, of two pairs of a folder, needs nothing else."""
    for side in ("left", "right"):
        for index in range(2):
            write_png(tmp_path / side / f"{index}.png", np.full((4, 6, 3), 9, np.uint8))
    entry = Benchmark("folder", {"all": ["0", "1"]}, "{method}/{scene}.pfm", sizes=())
    monkeypatch.setitem(BENCHMARKS, "mine", entry)
    plan = plan_submission("mine", "m")
    assert plan.maps == {"0": "m/0.pfm", "1": "m/1.pfm"} and not plan.runtimes
    (pairs,) = open_benchmark("mine", tmp_path)
    write_submission(plan, _match, (pairs[i] for i in range(2)), tmp_path / "out.zip")
    with pytest.raises(InputError, match="unknown benchmark 'other'"):
        open_benchmark("other", tmp_path)


def test_an_incomplete_benchmark_is_refused_before_any_work(tmp_path):
    _frames(tmp_path, 3)
    with pytest.raises(InputError, match="expected 195 frames, found 3"):
        open_benchmark("kitti2012", tmp_path)
