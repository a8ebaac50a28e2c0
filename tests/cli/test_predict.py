"""The commands predict, demo and models, as a user runs them."""

import json
import re
import sys
from dataclasses import replace

import cv2
import numpy as np
import pytest
import torch
from safetensors.torch import save_file
from skimage.data import stereo_motorcycle

from extras import need_extra
from mobilestereonet import StereoMatcher, __version__, create_model, save_weights, versions
from mobilestereonet.cli.engine import MatcherOptions
from mobilestereonet.engines.torch import TorchEngine


@pytest.fixture(scope="session")
def weights(tmp_path_factory):
    torch.manual_seed(1)
    folder = tmp_path_factory.mktemp("weights")
    for name in ("msnet3d-cascade", "msnet3d", "msnet2d"):
        path = folder / f"{name}.test-1.safetensors"
        save_weights(create_model(name, max_disparity=32), path, card={"licence": "MIT"})
    return path


@pytest.fixture
def folder(tmp_path, weights):
    """A folder with everything that a bad command may name."""
    left, right = np.random.default_rng(0).integers(0, 256, (2, 20, 40, 3), dtype=np.uint8)
    images = {
        "left.png": left,
        "right.png": right,
        "wide.png": np.zeros((20, 48, 3), np.uint8),
        "line.png": np.zeros((1, 40, 3), np.uint8),
        "column.png": np.zeros((20, 1, 3), np.uint8),
        "nan.tiff": np.full((20, 40, 3), np.nan, np.float32),
    }
    for name, image in images.items():
        assert cv2.imwrite(str(tmp_path / name), image)
    (tmp_path / "empty.png").touch()
    (tmp_path / "cut.png").write_bytes((tmp_path / "left.png").read_bytes()[:100])
    (tmp_path / "text.txt").write_text("no image\n")
    whole = weights.read_bytes()
    (tmp_path / "net.safetensors").write_bytes(whole)
    (tmp_path / "cut.safetensors").write_bytes(whole[:-1000])
    (tmp_path / "cut.pth").write_bytes(whole[:1000])
    save_file({"weight": torch.zeros(3)}, tmp_path / "foreign.safetensors")
    torch.save({"weight": torch.zeros(3)}, tmp_path / "foreign.pth")
    return tmp_path


def tree(folder):
    return {path: path.is_file() and path.read_bytes() for path in folder.rglob("*")}


def test_predict_writes_what_the_library_gives(msnet, folder):
    before = tree(folder)
    left, right, output = folder / "left.png", folder / "right.png", folder / "a" / "b"
    net = folder / "net.safetensors"
    code, out, err = msnet("predict", left, right, "-o", output, "--weights", net, "--json")
    assert (code, err) == (0, "")
    facts = json.loads(out)
    assert (facts["model"], facts["engine"]) == ("msnet2d", "torch")
    assert (facts["width"], facts["height"]) == (40, 20)
    assert facts["seconds"] > 0
    assert facts["findings"][0]["check"] == "content"
    files = [f"left_{end}" for end in ("disparity.png", "disparity.pfm", "disparity.npy")]
    assert sorted(facts["files"].values()) == sorted(
        str(output / name) for name in [*files, "left_picture.png"]
    )
    expected = StereoMatcher.from_pretrained(net, precision="auto")(left, right).disparity
    np.testing.assert_allclose(np.load(facts["files"]["npy"]), expected, rtol=0, atol=1e-3)
    levels = cv2.imread(facts["files"]["png"], cv2.IMREAD_UNCHANGED)
    np.testing.assert_allclose(levels / 256, expected, rtol=0, atol=1 / 256)
    assert cv2.imread(facts["files"]["picture"]).shape[1] > 80
    after = tree(folder)
    assert {path: after[path] for path in before} == before


def test_predict_with_the_embedded_weights_beside_its_input(msnet, folder, weights, monkeypatch):
    monkeypatch.setattr(versions, "FOLDER", weights.parent)
    before = tree(folder)
    code, out, _ = msnet("predict", folder / "left.png", folder / "right.png", "-o", folder)
    assert code == 0
    assert re.match(r"balanced \(msnet3d[\w-]*\) on torch (fp32|bf16), 40x20: ", out)
    for line in out.splitlines()[1:]:
        assert line.startswith(str(folder / "left_"))
    after = tree(folder)
    assert {path: after[path] for path in before} == before
    assert len(after) == len(before) + 4


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"left": "absent.png"}, "absent.png: no such file"),
        ({"right": "absent.png"}, "absent.png: no such file"),
        ({"left": "text.txt"}, "text.txt: not an image"),
        ({"right": "empty.png"}, "empty.png: not an image"),
        ({"right": "cut.png"}, "cut.png: "),
        ({"right": "wide.png"}, "left.png has 40x20, .*wide.png has 48x20"),
        ({"left": "line.png", "right": "line.png"}, "line.png: .*2x2 pixels, got 40x1"),
        ({"left": "column.png", "right": "column.png"}, "column.png: .*2x2 pixels, got 1x20"),
        ({"left": "nan.tiff"}, "nan.tiff: .*nan"),
        ({"--model": "raft"}, "unknown model 'raft'"),
        ({"--model": "baseline3d", "--weights": None}, "no weights of 'baseline3d'"),
        ({"--model": "msnet3d"}, "net.safetensors: holds msnet2d, not msnet3d"),
        ({"--model": "sgbm"}, "sgbm has no weights"),
        ({"--weights": "absent.safetensors"}, "absent.safetensors: no such file"),
        ({"--weights": "cut.safetensors"}, "cut.safetensors: not a whole safetensors file"),
        ({"--weights": "foreign.safetensors"}, "foreign.safetensors: .*of no registered network"),
        ({"--weights": "left.png"}, "left.png: not a whole safetensors file"),
        ({"--weights": "cut.pth"}, "cut.pth: not a readable PyTorch checkpoint"),
        ({"--weights": "foreign.pth"}, "foreign.pth: .*of no registered network"),
        ({"-o": "text.txt"}, "text.txt/left_disparity.png: cannot be written"),
        ({"-o": "text.txt/below"}, "text.txt/below/left_disparity.png: cannot be written"),
    ],
)
def test_bad_input_ends_with_one_line_and_writes_nothing(
    msnet, folder, weights, monkeypatch, change, message
):
    monkeypatch.setattr(versions, "FOLDER", weights.parent)
    monkeypatch.setattr(TorchEngine, "__call__", lambda *_: pytest.fail("the network was run"))
    before = tree(folder)
    good = {"left": "left.png", "right": "right.png", "-o": "new", "--weights": "net.safetensors"}
    chosen = {key: value for key, value in (good | change).items() if value is not None}
    named = {key: v if key == "--model" else folder / v for key, v in chosen.items()}
    options = [text for key in named if key.startswith("-") for text in (key, named[key])]
    code, out, err = msnet("predict", named["left"], named["right"], *options)
    assert code == 2
    assert out == ""
    assert re.fullmatch(rf"msnet: .*{message}.*\n", err)
    assert not re.search(r"(\S+): \1: ", err)  # no file is named twice
    assert tree(folder) == before


@pytest.mark.skipif(sys.platform != "linux", reason="needs /proc, where even root cannot write")
def test_unwritable_folder_is_found_before_the_network_runs(msnet, folder, monkeypatch):
    monkeypatch.setattr(TorchEngine, "__call__", lambda *_: pytest.fail("the network was run"))
    pair = folder / "left.png", folder / "right.png"
    net = folder / "net.safetensors"
    for place in ("/proc", "/proc/new"):
        code, _, err = msnet("predict", *pair, "-o", place, "--weights", net)
        assert code == 2
        assert err.startswith(f"msnet: {place}: no files can be written there")


def test_demo_scores_the_motorcycle(msnet, tmp_path):
    code, out, _ = msnet("demo", "-o", tmp_path, "--model", "sgbm")
    assert code == 0
    *_, truth = stereo_motorcycle()
    known = np.isfinite(truth) & (truth > 0) & (truth < 192)
    error = np.abs(np.load(tmp_path / "motorcycle_disparity.npy") - truth)[known]
    d1 = 100 * np.mean((error > 3) & (error > 0.05 * truth[known]))
    figures = f"EPE {error.mean():.3f} px, D1 {d1:.2f} %, bad-3 {100 * np.mean(error > 3):.2f} %"
    assert figures in out
    assert f"over {known.sum()} pixels" in out
    assert "faster" not in out
    assert re.search(r"Time \d+\.\d\d s", out)
    assert str(tmp_path / "motorcycle_picture.png") in out
    picture = cv2.imread(str(tmp_path / "motorcycle_picture.png"))
    assert picture.shape[0] == 500
    assert picture.shape[1] > 2 * 741


def test_demo_tells_the_time_of_two_levels(msnet, tmp_path, weights, monkeypatch):
    monkeypatch.setattr(versions, "FOLDER", weights.parent)
    code, out, _ = msnet("demo", "-o", tmp_path, "--threads", 1)
    assert code == 0
    network = r"balanced \(msnet3d[\w-]*\) on torch (fp32|bf16)"
    assert re.match(rf"Middlebury's Motorcycle, {network}, 741x500\n", out)
    assert re.search(r"\nTime \d+\.\d\d s \(first run, warm-up included\)\n", out)
    assert re.search(r"\nWith --quality fast: \d+\.\d\d s, EPE \d+", out)


@pytest.mark.parametrize("faster", [True, False])
def test_demo_says_when_the_faster_model_was_not_faster(msnet, tmp_path, monkeypatch, faster):
    match, seconds = StereoMatcher.match, iter([2.0, 1.0 if faster else 3.0])

    def timed(self, pair):
        result = match(self, pair)
        return replace(result, info=replace(result.info, seconds=next(seconds)))

    monkeypatch.setattr(StereoMatcher, "match", timed)
    opened = StereoMatcher.from_pretrained("sgbm")
    monkeypatch.setattr(MatcherOptions, "open_matcher", lambda _: opened)
    code, out, _ = msnet("demo", "-o", tmp_path)
    assert code == 0
    assert ("other programs use the cores: the times mean little" in out) is not faster


def test_the_demos_ground_truth_scores_its_map(msnet, tmp_path):
    _, out, _ = msnet("demo", "-o", tmp_path, "--model", "sgbm")
    epe = re.search(r"EPE (\d+\.\d{3}) px", out)[1]
    names = {"left": "left.png", "right": "right.png", "disparity": "truth.pfm"}
    options = [text for key, name in names.items() for text in ("--set", f"{key}={name}")]
    data = ("--data", "folder", "--root", tmp_path)
    code, out, _ = msnet("evaluate", *data, *options, "--model", "sgbm")
    assert code == 0
    assert re.search(rf"\b{epe}\b", out)


def test_the_version(msnet):
    assert msnet("--version") == (0, f"mobilestereonet {__version__}\n", "")


def test_help_of_the_model_fits_the_command(msnet):
    for command, takes in (("predict", True), ("bench", True), ("export", False)):
        assert ("onnx:FILE" in msnet(command, "--help")[1]) is takes


def test_the_demos_pair_is_there_for_other_commands(msnet, tmp_path):
    msnet("demo", "-o", tmp_path, "--model", "sgbm")
    pair = tmp_path / "left.png", tmp_path / "right.png", "--calib", tmp_path / "calib.txt"
    depth = tmp_path / "depth.npy"
    code, _, _ = msnet("predict", *pair, "-o", tmp_path, "--model", "sgbm", "--depth", depth)
    assert code == 0
    disparity = np.load(tmp_path / "motorcycle_disparity.npy")
    known = np.isfinite(disparity)
    expected = 994.978 * 0.193001 / (disparity[known] + 31.086)
    np.testing.assert_allclose(np.load(depth)[known], expected, rtol=1e-4)


def test_the_demos_video_is_one_of_a_calibrated_camera(msnet, tmp_path):
    need_extra("av")
    code, out, _ = msnet("demo", "-o", tmp_path, "--model", "sgbm", "--video")
    assert code == 0
    video, calibration = (tmp_path / f"side_by_side.{ending}" for ending in ("mp4", "txt"))
    assert f"Video and its calibration {video}, {calibration}\n" in out
    matcher = StereoMatcher.from_pretrained("sgbm")
    result = next(iter(matcher.stream(video, rig=calibration)))
    whole = np.load(tmp_path / "motorcycle_disparity.npy")[74 : 74 + 352, :480]
    known = np.isfinite(whole) & (result.depth() > 0)
    depth = 994.978 * 0.193001 / (whole + 31.086)
    assert np.median(np.abs(result.depth() / depth - 1)[known]) < 0.01


def test_values_of_the_network_are_set(msnet, folder, weights):
    pair = folder / "left.png", folder / "right.png", "-o", folder / "maps", "--weights", weights
    code, out, _ = msnet("predict", *pair, "--json", "--set", "net.estimator=mode")
    assert code == 0
    assert json.loads(out)["refined"] is True
    for value, message in (
        ("estimator=mode", "--set estimator=mode: write it as net.estimator=mode"),
        ("net.estimator=median", "estimator"),
        ("net.colour=red", "colour"),
    ):
        code, out, err = msnet("predict", *pair, "--set", value)
        assert (code, out) == (2, "")
        assert re.fullmatch(rf"msnet: .*{message}.*\n", err)
