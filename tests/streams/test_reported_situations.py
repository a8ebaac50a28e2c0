"""Situations that people reported publicly, through the commands; their inputs are shared.

Those of calibrations and of image files are in `tests/data_sets`, checkpoints in `tests/weights`.
"""

import json

import cv2
import numpy as np
import pytest

from extras import SHARED, need_extra, needs_shared
from mobilestereonet.data import open_data_set, read_calibration, read_disparity

BUGS = SHARED / "bugs"
pytestmark = needs_shared


@pytest.fixture(scope="module")
def truth():
    """Disparity of the pair of all cases, 370 x 250; 0 where it is not known."""
    need_extra("skimage")
    from skimage.data import stereo_motorcycle

    known = np.nan_to_num(stereo_motorcycle()[2].astype(np.float32), posinf=0)
    return cv2.resize(known, (370, 250), interpolation=cv2.INTER_NEAREST) * (370 / 741)


def error(path, truth):
    disparity, valid = read_disparity(path, scale=256)
    known = valid & (truth > 0)
    return float(np.abs(disparity - truth)[known].mean())


@pytest.mark.parametrize(
    "source",
    [
        ("video-rotation/left180.mp4", "video-rotation/right180.mp4"),
        ("video-top-bottom/top_bottom.mp4",),
    ],
)
def test_videos_of_turned_and_stacked_views(msnet, tmp_path, truth, source):
    need_extra("av")
    paths = [BUGS / name for name in source]
    code, _, err = msnet("video", *paths, "--frames", tmp_path, "--model", "sgbm")
    assert code == 0
    assert ("one view above the other" in err) == (len(source) == 1)
    assert error(tmp_path / "000000_disparity.png", truth) < 1.6


def test_videos_of_two_rates(msnet, tmp_path):
    need_extra("av")
    videos = [BUGS / "video-rates" / name for name in ("left30.mp4", "right15.mp4")]
    code, out, err = msnet("video", *videos, "--frames", tmp_path, "--model", "sgbm")
    assert code == 0
    assert "2 frames" in out and "2 of 4 frames" in err and "no partner" in err


def test_a_header_of_a_gigapixel_stops_its_pair_alone(msnet, tmp_path):
    folder = BUGS / "huge-header"
    code, out, err = msnet(
        "batch", folder / "left", folder / "right", "-o", tmp_path, "--model", "sgbm"
    )
    assert code == 1
    assert "2 pairs matched, 0 kept, 1 failed" in out
    assert "2.jpg: 1600000000 pixels" in err
    assert len(list(tmp_path.iterdir())) == 2


def test_what_a_mac_leaves_beside_pictures(msnet, tmp_path):
    folder = BUGS / "appledouble"
    views = folder / "left", folder / "right"
    code, out, err = msnet("batch", *views, "-o", tmp_path, "--model", "sgbm")
    assert (code, err) == (0, "")
    assert "1 pairs matched" in out
    scenes = open_data_set("sceneflow", BUGS / "appledouble-sceneflow/data", split="test")
    assert len(scenes) == 1
    assert scenes[0].disparity.max() > 0


def test_negative_disparities_are_those_of_another_sign(msnet, tmp_path):
    figures = []
    for ending in ("npy", "pfm"):
        options = ("left=left/*.jpg", "right=right/*.jpg", f"disparity=disparity/*.{ending}")
        words = [word for text in options for word in ("--set", text)]
        data = ("--data", "folder", "--root", BUGS / "npy-sign", *words)
        report = tmp_path / f"{ending}.json"
        assert msnet("evaluate", *data, "--model", "sgbm", "--json", report)[0] == 0
        (record,) = json.loads(report.read_text())
        figures.append(record["masks"]["all"]["per_image"]["epe"])
    assert figures[0] == pytest.approx(figures[1], abs=0.02)
    assert 0 < figures[0] < 4


def test_the_depth_of_a_fisheye_rig_is_right_far_from_the_middle(msnet, tmp_path, truth):
    folder, depth = BUGS / "fisheye-rig", tmp_path / "depth.npy"
    command = ("predict", folder / "left.jpg", folder / "right.jpg", "-o", tmp_path)
    command += ("--model", "sgbm", "--depth", depth, "--rig", folder / "rig.yml")
    code, _, err = msnet(*command)
    assert code == 2 and "--fisheye" in err and "--pinhole" in err
    assert msnet(*command, "--fisheye")[0] == 0
    views = (folder / "left.jpg", folder / "right.jpg", "-o", tmp_path / "rectified")
    assert msnet("rectify", *views, "--rig", folder / "rig.yml", "--fisheye")[0] == 0
    known = read_calibration(tmp_path / "rectified" / "calib.txt")
    # The pair was made of views of 150 px focal length, of cameras 0.12 m apart.
    metres = np.load(depth)
    rows, columns = np.mgrid[: metres.shape[0], : metres.shape[1]]
    x, y = (columns - known.cx) / known.focal, (rows - known.cy) / known.focal
    places = [np.float32(150 * x + 184.5), np.float32(150 * y + 124.5)]
    disparity = cv2.remap(truth, *places, cv2.INTER_NEAREST, borderValue=0)
    matched = (metres > 0) & (disparity > 0)
    ratio = metres[matched] * disparity[matched] / (150 * 0.12)
    angle = np.degrees(np.arctan(np.hypot(x, y)))[matched]
    for lowest, highest in ((0, 25), (25, 35), (35, 50)):
        ring = ratio[(angle >= lowest) & (angle < highest)]
        assert ring.size > 1000
        assert np.median(ring) == pytest.approx(1, abs=0.04)
