"""Depth, points, confidence and checks from ``msnet predict``."""

import json
import re
from pathlib import Path

import cv2
import numpy as np
import pytest
import trimesh

from mobilestereonet import create_model
from mobilestereonet.weights import save_weights


@pytest.fixture
def folder(tmp_path):
    """A pair of a plane at 20 px of disparity, and its calibration."""
    noise = np.random.default_rng(0).integers(0, 256, (120, 260, 3), dtype=np.uint8)
    wide = cv2.GaussianBlur(noise, (0, 0), 1)
    cv2.imwrite(str(tmp_path / "left.png"), wide[:, :240])
    cv2.imwrite(str(tmp_path / "right.png"), wide[:, 20:])
    matrix = "[500 0 {}; 0 500 60; 0 0 1]"
    (tmp_path / "calib.txt").write_text(
        f"cam0={matrix.format(120)}\ncam1={matrix.format(125)}\ndoffs=5\nbaseline=100\n"
    )
    text = (tmp_path / "calib.txt").read_text()
    half = text.replace(" 60; 0", " 30; 0").replace("120;", "60;").replace("125;", "65;")
    (tmp_path / "half.txt").write_text(half + "width=120\nheight=60\n")
    (tmp_path / "small.txt").write_text(half)
    (tmp_path / "large.txt").write_text(
        text.replace("120;", "239;").replace("125;", "244;").replace(" 60; 0", " 119; 0")
    )
    (tmp_path / "wide.txt").write_text(text.replace("500", "15.8"))
    return tmp_path


def predict(msnet, folder, *options, right="right.png"):
    views = folder / "left.png", folder / right
    return msnet("predict", *views, "-o", folder / "out", "--model", "sgbm", *options)


def test_depth_points_and_mesh(msnet, folder):
    depth = [folder / "new" / name for name in ("depth.png", "depth.npy", "depth.tiff")]
    points = [folder / "new" / name for name in ("points.ply", "points.glb")]
    options = [text for path in depth for text in ("--depth", path)]
    options += [text for path in points for text in ("--points", path)]
    meshes = [folder / "new" / name for name in ("scene.glb", "scene.obj", "scene.stl")]
    options += [text for path in meshes for text in ("--mesh", path)]
    code, out, err = predict(msnet, folder, *options, "--calib", folder / "calib.txt", "--json")
    assert (code, err) == (0, "")
    assert {str(path) for path in (*depth, *points, *meshes)} <= set(
        json.loads(out)["files"].values()
    )
    pictured = json.loads(out)["files"]["depth_picture"]
    assert Path(pictured).name == "left_depth_picture.png"
    height, width = cv2.imread(pictured).shape[:2]
    assert height == 120 and 240 < width < 480
    # 500 px * 0.1 m / (20 px + 5 px)
    assert np.median(np.load(depth[1])) == pytest.approx(2, abs=0.01)
    assert np.median(cv2.imread(str(depth[0]), cv2.IMREAD_UNCHANGED)) == pytest.approx(2000, abs=10)
    np.testing.assert_array_equal(
        cv2.imread(str(depth[2]), cv2.IMREAD_UNCHANGED), np.load(depth[1])
    )
    assert b"element vertex" in points[0].read_bytes()[:300]
    assert points[1].read_bytes()[:4] == b"glTF"
    surface = trimesh.load(meshes[0]).to_mesh()
    assert np.median(surface.vertices[:, 2]) == pytest.approx(-2, abs=0.01)
    assert len(trimesh.load(meshes[2]).faces) == len(surface.faces) > 10000


def test_the_depths_standard_deviation(msnet, folder):
    views = folder / "left.png", folder / "right.png"
    files = [folder / name for name in ("depth.npy", "std.npy", "std.tiff")]
    options = [text for path in files[1:] for text in ("--depth-std", path)]
    options += ["--depth", files[0], "--rig", folder / "calib.txt", "--min-confidence", 0.1]
    command = ("predict", *views, "-o", folder / "out", "--model", "msnet2d")
    code, out, err = msnet(*command, *options, "--json")
    assert (code, err) == (0, "")
    assert {str(path) for path in files} <= set(json.loads(out)["files"].values())
    depth, found = map(np.load, files[:2])
    assert ((found > 0) == (depth > 0)).all() and depth.any()
    np.testing.assert_array_equal(cv2.imread(str(files[2]), cv2.IMREAD_UNCHANGED), found)
    sure = np.load(folder / "out/left_confidence.npy")
    assert np.median(found[sure > 0.9]) < np.median(found[(sure < 0.8) & (found > 0)])
    save_weights(create_model("msnet2d", max_disparity=32), folder / "own.safetensors")
    command = ("predict", *views, "-o", folder / "new", "--weights", folder / "own.safetensors")
    code, out, err = msnet(*command, *options)
    assert (code, out) == (2, "") and not (folder / "new").exists()
    assert "is no probability of an error" in err and "msnet fit-confidence" in err


def test_the_range_and_the_median_are_told(msnet, folder):
    rig = ("--rig", folder / "calib.txt", "--points", folder / "points.ply")
    _, out, _ = predict(msnet, folder)
    told = r"sgbm on sgbm int16, 240x120: \d+\.\d\d s; disparity (\S+) to (\S+) px \(median 20\)"
    low, high = map(float, re.match(rf"{told}\n", out).groups())
    assert low <= 20 <= high
    _, out, _ = predict(msnet, folder, *rig)
    assert re.match(rf"{told}; depth \S+ to \S+ m \(median 2\)\n", out)
    _, out, _ = predict(msnet, folder, *rig, "--json")
    facts = json.loads(out)
    assert facts["disparity"]["median"] == pytest.approx(20, abs=0.1)
    assert facts["depth"]["low"] <= facts["depth"]["median"] == pytest.approx(2, abs=0.01)


def test_numbers_instead_of_a_file(msnet, folder):
    numbers = ("--focal", 500, "--baseline", 0.1, "--doffs", 5)
    code, _, _ = predict(msnet, folder, "--depth", folder / "depth.npy", *numbers)
    assert code == 0
    assert np.median(np.load(folder / "depth.npy")) == pytest.approx(2, abs=0.01)


def test_a_baseline_in_millimetres_is_asked_about(msnet, folder):
    numbers = ("--focal", 500, "--baseline", 100, "--doffs", 5)
    code, _, err = predict(msnet, folder, "--depth", folder / "depth.npy", *numbers)
    asked = "msnet: a baseline of 100 m: is it in metres? 100 mm would be 0.1\n"
    assert (code, err) == (0, asked)
    rig = folder / "no_baseline.txt"
    rig.write_text("cam0=[500 0 20; 0 500 20; 0 0 1]\ncam1=[500 0 20; 0 500 20; 0 0 1]\n")
    numbers = ("--rig", rig, "--baseline", 100)
    _, _, err = predict(msnet, folder, "--depth", folder / "depth.npy", *numbers)
    assert asked in err


def test_the_unit_is_heard_and_warned_of_without_a_file(msnet, folder):
    numbers = ("--focal", 1000, "--baseline", 0.1, "--unit", "mm", "--depth", folder / "a.npy")
    code, _, err = predict(msnet, folder, *numbers)
    assert code == 0
    assert err == ("msnet: --unit: of a calibration, --rig FILE, and without effect here\n")
    file = ("--calib", folder / "calib.txt", "--depth", folder / "b.npy")
    depths = {}
    for unit in ("mm", "cm"):
        assert predict(msnet, folder, *file, "--unit", unit)[0] == 0
        depths[unit] = np.median(np.load(folder / "b.npy"))
    assert depths["cm"] == pytest.approx(10 * depths["mm"])
    code, _, err = predict(msnet, folder, *file, "--unit", "m")
    assert code == 2
    assert "a baseline of 100 m is implausible" in err and "--baseline 100" in err


def test_a_field_of_view_is_told_to_be_assumed(msnet, folder):
    numbers = ("--fov", 27, "--baseline", 0.1, "--doffs", 5, "--depth", folder / "depth.npy")
    code, _, err = predict(msnet, folder, *numbers)
    assert code == 0
    assert err.startswith("msnet: assumed: square pixels, the principal point in the middle")
    assert "doffs" not in err
    code, _, err = predict(msnet, folder, *numbers[:4], *numbers[6:])
    assert code == 0
    assert "rectified views, doffs 0 (cameras that do not converge), 27 degrees" in err
    assert predict(msnet, folder, *numbers)[0] == 0
    focal = 120 / np.tan(np.radians(13.5))
    assert np.median(np.load(folder / "depth.npy")) == pytest.approx(focal * 0.1 / 25, rel=0.01)


def test_a_known_distance_gives_the_scale(msnet, folder):
    known = ("--known", "120,60=3.5", "--depth", folder / "depth.npy")
    code, _, err = predict(msnet, folder, *known)
    assert code == 0
    assert err.startswith("msnet: assumed: ") and "60 degrees wide; 3.5 m at a dis" in err
    assert "doffs 0" in err
    assert np.median(np.load(folder / "depth.npy")) == pytest.approx(3.5, rel=0.01)
    # What it says does the same, also for videos.
    focal, baseline = re.search(r"--focal (\S+) --baseline (\S+)", err).groups()
    numbers = ("--focal", focal, "--baseline", baseline, "--depth", folder / "again.npy")
    assert predict(msnet, folder, *numbers)[0] == 0
    np.testing.assert_allclose(np.load(folder / "again.npy"), np.load(folder / "depth.npy"), 1e-4)


def test_raw_pictures_are_rectified_on_the_way(msnet, folder):
    camera = np.array([[500.0, 0, 120], [0, 500, 60], [0, 0, 1]])
    storage = cv2.FileStorage(str(folder / "rig.yml"), cv2.FILE_STORAGE_WRITE)
    turned = cv2.Rodrigues(np.array([0, 0, 0.02]))[0]
    distortion = np.array([-0.1, 0, 0, 0, 0])
    values = {"M1": camera, "D1": distortion, "M2": camera, "D2": distortion, "R": turned}
    for name, value in (values | {"T": np.array([-0.1, 0, 0])}).items():
        storage.write(name, value)
    storage.release()
    depth = ("--depth", folder / "depth.npy")
    assert predict(msnet, folder, "--rig", folder / "rig.yml", *depth)[0] == 0
    rectified = folder / "rectified"
    views = folder / "left.png", folder / "right.png"
    assert msnet("rectify", *views, "--rig", folder / "rig.yml", "-o", rectified)[0] == 0
    twice = ("--rig", rectified / "calib.txt", "--depth", rectified / "depth.npy")
    views = rectified / "left.png", rectified / "right.png"
    assert msnet("predict", *views, "-o", folder / "out", "--model", "sgbm", *twice)[0] == 0
    once, again = np.load(folder / "depth.npy"), np.load(rectified / "depth.npy")
    assert np.median(once) == pytest.approx(np.median(again), rel=0.01)


def test_left_right(msnet, folder):
    code, _, _ = predict(msnet, folder, "--left-right")
    assert code == 0
    right = np.load(folder / "out" / "left_right_disparity.npy")
    assert np.median(right) == pytest.approx(20, abs=0.1)
    occluded = cv2.imread(str(folder / "out" / "left_occluded.png"), cv2.IMREAD_UNCHANGED)
    # The right camera does not see the left columns.
    assert occluded[:, :18].mean() > 200
    assert occluded[:, 30:200].mean() < 20


def test_one_picture_twice_is_warned_of(msnet, folder):
    code, _, err = predict(msnet, folder, right="left.png")
    assert code == 0
    assert err.startswith("msnet: content: both views are the same picture")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (
            ("--depth", "d.npy"),
            "depth, points and meshes need --rig FILE; or --focal PX (or",
        ),
        (
            ("--depth", "d.npy"),
            "and --baseline METRES; or, with predict, --known COLUMN,ROW=METRES",
        ),
        (("--doffs", 3), "--doffs: a calibration needs --rig FILE; or --focal PX"),
        (("--points", "p.ply", "--baseline", 1), "--baseline needs --focal or --fov, too"),
        (("--depth", "d.npy", "--calib", "calib.txt", "--unit", "inch"), "there are m, cm, mm"),
        (("--points", "p.ply", "--focal", 500), "--focal needs --baseline METRES, too (or --known"),
        (("--depth", "d.npy", "--focal", 500, "--baseline", 0), "baseline must be positive"),
        (("--depth", "d.npy", "--focal", -5, "--baseline", 1), "focal must be positive"),
        (("--calib", "calib.txt", "--focal", 1), "leave the options out"),
        (("--calib", "none.txt"), "none.txt: no such file"),
        (("--depth", "d.npy", "--calib", "calib.txt", "--baseline", 1), "--baseline says 1 m"),
        (
            ("--depth", "d.npy", "--known", "120,60"),
            "--known 120,60: write it as COLUMN,ROW=METRES",
        ),
        (("--depth", "d.npy", "--known", "1,2=0"), "--known 1,2=0: write it as COLUMN,ROW=METRES"),
        (("--depth", "d.npy", "--known", "1,2=3", "--baseline", 1), "in place of --baseline"),
        (("--depth", "d.npy", "--known", "1,2=3", "--calib", "calib.txt"), "leave the options out"),
        (("--depth", "d.npy", "--known", "240,60=3"), "column 240, row 60 is outside"),
        (("--fov", 60, "--focal", 500), "two ways to say one thing"),
        (("--depth", "d.npy", "--fov", 190, "--baseline", 1), "up to 170"),
        (("--depth", "d.npy", "--fov", 60), "--fov needs --baseline METRES, too (or --known"),
        (("--depth", "d.npy", "--rig", "wide.txt"), "a view of 165 degrees: is it of pictures of"),
        (("--depth", "d.npy", "--rig", "large.txt"), "is the middle of pictures of about 478x238"),
        (("--depth", "d.npy", "--rig", "small.txt"), "is the middle of pictures of about 120x60"),
        (("--depth", "d.npy", "--calib", "calib.txt", "--raw"), "about rectified pictures alone"),
        (("--depth", "d.npy", "--calib", "half.txt"), "of pictures of 120x60, these have 240x120"),
        (("--depth", "d.npy", "--calib", "half.txt"), "--resized says that they were only"),
        (("--min-confidence", 1), "--min-confidence is for depth and points: ask for some"),
        (("--max-depth", 9, "--drop-edges"), "--max-depth, --keep-edges is for depth and points"),
        (("--calib", "left.png", "--depth", "d.npy"), "left.png: unknown calibration format"),
        (("--depth", "d.exr"), "d.exr: depth is written as"),
        (("--points", "p.obj"), "p.obj: points are written as"),
        (("--confidence",), "sgbm has no confidence"),
        (("--depth-std", "s.npy", "--calib", "calib.txt"), "sgbm has no confidence"),
        (("--depth-std", "s.npy"), "points and meshes need --rig FILE"),
        (("--depth-std", "s.png"), "s.png: a standard deviation is written as .npy"),
    ],
)
def test_bad_input_writes_nothing(msnet, folder, options, message):
    before = sorted(folder.rglob("*"))
    named = [folder / text if "." in str(text) else text for text in options]
    code, out, err = predict(msnet, folder, *named)
    assert (code, out) == (2, "")
    assert message in err
    assert err.count("\n") == 1
    assert sorted(folder.rglob("*")) == before


def test_a_recording_with_depth_needs_views_that_can_give_it(msnet, folder):
    path = folder / "right.png"
    cv2.imwrite(str(path), np.roll(cv2.imread(str(path)), 6, axis=0))
    log = ("--rerun", folder / "log.rrd")
    code, _, err = predict(msnet, folder, *log, "--calib", folder / "calib.txt")
    assert code == 2
    assert "say --force" in err
    assert not (folder / "log.rrd").exists()


def test_a_rig_alone_tells_no_depth_of_bad_views(msnet, folder):
    path = folder / "right.png"
    cv2.imwrite(str(path), np.roll(cv2.imread(str(path)), 6, axis=0))
    rig = ("--rig", folder / "calib.txt")
    code, out, err = predict(msnet, folder, *rig)
    assert code == 0 and "msnet doctor" in err
    assert "disparity" in out and "depth" not in out
    assert "depth" not in json.loads(predict(msnet, folder, *rig, "--json")[1])
    assert "depth" in json.loads(predict(msnet, folder, *rig, "--json", "--force")[1])


def test_one_view_above_the_other_with_an_odd_width(msnet, folder):
    views = [cv2.imread(str(folder / f"{side}.png"))[:, :-1] for side in ("left", "right")]
    cv2.imwrite(str(folder / "both.png"), np.vstack(views))
    both = (folder / "both.png", "-o", folder / "out", "--model", "sgbm", "--layout", "top-bottom")
    assert msnet("predict", *both)[0] == 0
    assert np.median(np.load(folder / "out" / "both_disparity.npy")) == pytest.approx(20, abs=0.1)
