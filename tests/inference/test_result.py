import warnings
from dataclasses import replace

import cv2
import numpy as np
import pytest

from mobilestereonet import Calibration, StereoResult
from mobilestereonet.data.calibration import write_calibration
from mobilestereonet.data.disparity_files import read_disparity
from mobilestereonet.errors import InputError
from mobilestereonet.inference import RunInfo


@pytest.fixture
def result():
    disparity = np.array([[0.001, 1, 2.5], [100.25, 300, 9]], np.float32)
    valid = np.array([[True, True, True], [True, True, False]])
    left = np.arange(18, dtype=np.uint8).reshape(2, 3, 3)
    return StereoResult(left, disparity, valid)


def test_depth_is_focal_times_baseline_over_disparity(result):
    depth = result.depth(Calibration(focal=1000, baseline=0.5))
    assert depth.dtype == np.float32
    # 0.001 px is below the smallest disparity, the last pixel is not valid.
    expected = [[0, 500, 200], [500 / 100.25, 500 / 300, 0]]
    np.testing.assert_allclose(depth, expected, rtol=1e-6)


def test_depth_knows_the_difference_of_principal_points(result):
    depth = result.depth(Calibration(focal=1000, baseline=0.5, doffs=1.5))
    np.testing.assert_allclose(depth[0], [500 / 1.501, 200, 125], rtol=1e-6)
    depth = result.depth(Calibration(focal=1000, baseline=0.5, doffs=-2))
    np.testing.assert_allclose(depth[0], [0, 0, 1000], rtol=1e-6)


@pytest.mark.parametrize("scale", [0.4, 1.0, 5.0])
def test_a_standard_deviation_is_of_errors_as_probable_as_the_confidence_says(result, scale):
    errors = np.random.default_rng(0).laplace(0, scale, 400_000)
    below = np.full((2, 3), np.mean(np.abs(errors) < 3), np.float32)
    sure = replace(result, confidence=below)
    np.testing.assert_allclose(sure.disparity_std(), errors.std(), rtol=0.04)
    certain = replace(result, confidence=np.ones((2, 3), np.float32)).disparity_std()
    assert (certain == 0.5).all() and certain.dtype == np.float32
    assert np.isfinite(replace(result, confidence=0 * below).disparity_std()).all()


@pytest.mark.parametrize("doffs", [0.0, 1.5])
def test_the_depths_deviation_is_that_of_the_disparity_through_its_slope(result, doffs):
    camera = Calibration(focal=1000, baseline=0.5, doffs=doffs)
    sure = replace(result, confidence=np.full((2, 3), 0.99, np.float32))
    found, depth, step = sure.depth_std(camera), sure.depth(camera), 1e-3
    near, far = (
        replace(result, disparity=result.disparity + d).depth(camera) for d in (step, -step)
    )
    there = result.disparity > 0.5
    slope = (far - near) / (2 * step) * sure.disparity_std()
    np.testing.assert_allclose(found[there], slope[there], rtol=3e-2)
    assert found.dtype == np.float32 and ((found > 0) == (depth > 0)).all()
    by_hand = sure.depth_std(focal=1000, baseline=0.5, doffs=doffs)
    np.testing.assert_array_equal(by_hand, found)


def test_a_standard_deviation_needs_a_confidence_that_is_fitted(result):
    camera = Calibration(focal=1000, baseline=0.5)
    with pytest.raises(InputError, match="needs a matcher with confidence=True"):
        result.depth_std(camera)
    info = RunInfo("own", "torch", "bf16", "cpu", True, 3, 2, 1 / 3)
    sure = replace(result, confidence=np.full((2, 3), 0.9, np.float32), info=info)
    with pytest.raises(InputError, match=r"of own is no probability of an error.*fit-confidence"):
        sure.depth_std(camera)
    assert replace(sure, info=replace(info, confidence_fitted=True)).depth_std(camera).any()
    with pytest.raises(InputError, match="needs a calibration"):
        replace(sure, info=None).depth_std()


def test_a_calibration_is_taken_by_its_path(result, tmp_path):
    calibration = Calibration(focal=100.0, baseline=0.1, cx=1.0, cy=1.0)
    write_calibration(tmp_path / "calib.txt", calibration, result.disparity.shape[::-1])
    for path in (tmp_path / "calib.txt", str(tmp_path / "calib.txt")):
        np.testing.assert_allclose(result.depth(path), result.depth(calibration))
    points = result.points(tmp_path / "calib.txt").points
    np.testing.assert_allclose(points, result.points(calibration).points)


def test_depth_of_another_size_is_refused(result):
    calibration = Calibration(focal=1000, baseline=0.5, doffs=8, size=(6, 4))
    for use in (result.depth, result.points):
        with pytest.raises(InputError, match=r"of 6x4, these have 3x2.*--resized"):
            use(calibration)
        with pytest.raises(InputError, match=r"give the calibration of these views$"):
            use(replace(calibration, size=(3, 20)))  # cut, not resized
    result.depth(replace(calibration, size=(3, 2)))


def test_a_least_confidence_needs_a_confidence(result):
    with pytest.raises(InputError, match=r"min_confidence 0.5 needs .* confidence=True"):
        result.points(Calibration(focal=1000, baseline=0.5), min_confidence=0.5)


def test_printing_a_result_tells_no_pixels(result):
    info = RunInfo("msnet2d", "torch", "bf16", "cpu", True, 3, 2, 1 / 3)
    text = "StereoResult(3x2, disparity 0.0 to 300.0 px, msnet2d, torch, bf16)"
    assert repr(replace(result, info=info)) == text
    unknown = replace(result, valid=np.zeros((2, 3), dtype=bool))
    assert repr(unknown) == "StereoResult(3x2, no match)"


def test_depth_is_always_finite():
    disparity = np.array([[0, np.nan, np.inf, 1e-38, -3]], np.float32)
    result = StereoResult(np.zeros((1, 5, 3), np.uint8), disparity, np.isfinite(disparity))
    np.testing.assert_array_equal(result.depth(Calibration(1000, 0.5)), np.zeros((1, 5)))
    far = replace(result, disparity=np.full((1, 5), 2, np.float32), valid=disparity >= 0)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert not far.depth(focal=1e308, baseline=0.1).any()  # no float32 can hold it


def test_saved_files_hold_the_disparity(result, tmp_path):
    paths = result.save(tmp_path / "new", "pair")
    assert {kind: path.name for kind, path in paths.items()} == {
        "png": "pair_disparity.png",
        "pfm": "pair_disparity.pfm",
        "npy": "pair_disparity.npy",
        "picture": "pair_picture.png",
    }
    assert sorted(path.name for path in (tmp_path / "new").iterdir()) == sorted(
        path.name for path in paths.values()
    )
    # KITTI's PNG: 256 levels per px, 0 is unknown: invalid, or too large for it (300).
    levels = cv2.imread(str(paths["png"]), cv2.IMREAD_UNCHANGED)
    assert levels.dtype == np.uint16
    assert levels.tolist() == [[1, 256, 640], [25664, 0, 0]]
    expected = np.where(result.valid, result.disparity, np.inf)
    np.testing.assert_array_equal(np.load(paths["npy"]), expected)
    assert np.load(paths["npy"]).dtype == np.float32
    disparity, known = read_disparity(paths["pfm"])
    np.testing.assert_array_equal(known, result.valid)
    np.testing.assert_array_equal(disparity[known], result.disparity[result.valid])


def test_picture_has_the_left_view_and_the_disparity(result, tmp_path):
    picture = cv2.imread(str(result.save(tmp_path, "pair")["picture"]))[..., ::-1]
    np.testing.assert_array_equal(picture[:, :3], result.left)
    colours = picture[:, -3:].astype(int)
    assert picture.shape[1] > 6
    assert colours[0, 0, 2] > colours[0, 0, 0]  # far is blue
    assert colours[1, 1, 0] > colours[1, 1, 2]  # near is red
    assert not colours[1, 2].any()  # unknown is black


def test_saved_confidence_and_check(result, tmp_path):
    confidence = np.array([[0, 0.5, 1], [0.25, 0.75, 0.1]], np.float32)
    occluded = np.array([[True, False, False], [False, True, False]])
    full = replace(
        result,
        confidence=confidence,
        right_disparity=2 * result.disparity,
        occluded=occluded,
    )
    paths = full.save(tmp_path, "pair")
    grey = cv2.imread(str(paths["confidence"]), cv2.IMREAD_UNCHANGED)
    assert grey.tolist() == [[0, 128, 255], [64, 191, 26]]
    np.testing.assert_array_equal(np.load(paths["confidence_npy"]), confidence)
    np.testing.assert_array_equal(np.load(paths["right_npy"]), 2 * result.disparity)
    levels = cv2.imread(str(paths["right_png"]), cv2.IMREAD_UNCHANGED)
    assert levels.tolist() == [[1, 512, 1280], [51328, 0, 4608]]
    mask = cv2.imread(str(paths["occluded"]), cv2.IMREAD_UNCHANGED)
    assert mask.tolist() == [[255, 0, 0], [0, 255, 0]]


def test_a_notebook_shows_the_picture(result):
    shown = cv2.imdecode(np.frombuffer(result._repr_png_(), np.uint8), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(shown[..., ::-1], result.picture())
    wide = StereoResult(
        np.zeros((30, 3000, 3), np.uint8),
        np.ones((30, 3000), np.float32),
        np.ones((30, 3000), bool),
    )
    shown = cv2.imdecode(np.frombuffer(wide._repr_png_(), np.uint8), cv2.IMREAD_UNCHANGED)
    assert shown.shape == (6, 1280, 3)
