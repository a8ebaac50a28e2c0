"""What is unusual in a geometry is told, with the values; what is usual is not."""

import warnings

import cv2
import numpy as np
import pytest

from extras import SHARED, needs_shared
from mobilestereonet.data import Calibration, Rig, open_data_set
from mobilestereonet.data.rig import Camera, CameraPair
from mobilestereonet.data.rig.assumed import AssumedRig
from mobilestereonet.data.rig.doubts import doubts
from mobilestereonet.errors import InputError
from mobilestereonet.inference import Rectifier
from mobilestereonet.inference.geometry import depth_from_disparity

SIZE = (640, 480)


def pair(size=SIZE, right=None, distortion=(-0.3, 0.1, 0, 0, 0), fisheye=False, **values):
    """Two cameras, usual ones unless told otherwise."""

    def camera(fx=500.0, fy=500.0, cx=320.0, cy=240.0):
        matrix = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
        return Camera(matrix, np.array(distortion, float), fisheye)

    left = camera(**values)
    right = left if right is None else camera(**right)
    return CameraPair(left, right, np.eye(3), np.array([-0.1, 0, 0]), size)


def told(geometry, size=SIZE):
    return list(doubts(geometry, size))


@pytest.mark.parametrize(
    "geometry",
    [
        pair(),
        pair(fx=1000, fy=500),  # squeezed by 2
        pair(distortion=(-0.28, 0.07, 0, 0, -0.01), fx=320, fy=320),  # 90 degrees
        pair(distortion=(0.02, -0.004, 0.001, 0), fisheye=True, fx=180, fy=180),
        pair(size=None, cx=330, cy=236),
        Calibration(500, 0.1, cx=250, cy=240, size=SIZE),
        Calibration(500, 0.1),
        Calibration(1500, 0.1, cx=320, cy=240),
    ],
)
def test_what_is_usual_is_not_told(geometry):
    assert told(geometry) == []


@pytest.mark.parametrize(
    ("geometry", "words"),
    [
        (
            pair(fx=120, fy=120, distortion=()),
            "120 px gives pictures of 640 px a view of 139 degrees",
        ),
        (pair(fx=12000, fy=12000), "a view of 3.06 degrees: is it in pixels"),
        (pair(fx=500, fy=5000), "focal lengths are 500 and 5000 px"),
        (pair(cx=100), "principal point (100, 240) is far from the middle of pictures of 640x480"),
        (pair(right={"fx": 1500, "fy": 1500}), "is 500 px and the other one's 1500 px"),
        (pair(distortion=(-300, 0, 0, 0, 0)), "[-300.0, 0.0, 0.0, 0.0, 0.0] moves what is at the"),
        (pair(distortion=(0, 0, 0, 0, 1e300)), "of its distance from the middle"),
        (pair(distortion=(9, 0, 0, 0), fisheye=True), "in OpenCV's order"),
        (pair(size=None, cx=390, cy=290), "middle of pictures of about 780x580, these have 640x"),
        (Calibration(500, 0.1, cx=320, cy=-20, size=SIZE), "(320, -20) is far from the middle"),
        (Calibration(500, 0.1, cx=270, cy=200), "about 540x400, these have 640x480"),
    ],
)
def test_what_is_unusual_is_told(geometry, words):
    (text,) = {text.replace("right", "left") for text in told(geometry)}
    assert words in text
    with pytest.warns(UserWarning, match=r"made up: .*\?|made up: .*resized after"):
        Rig((geometry,), "made up").geometry(SIZE)


@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_a_calibration_without_a_size_is_of_pictures_around_its_principal_point(factor):
    size = (int(640 * factor), int(480 * factor))
    bare = Calibration(500, 0.1, cx=312, cy=236)
    disparity = np.full(size[::-1], 10, np.float32)
    with pytest.raises(InputError, match=r"of about 624x472, these have .*: give the calibration"):
        depth_from_disparity(disparity, disparity > 0, bare)
    with pytest.raises(InputError, match=r"outside of its pictures|write the size that it is of"):
        Rig((pair(size=None),), "rig").geometry(size)
    unknown = Calibration(500, 0.1)  # tells nothing
    assert depth_from_disparity(disparity, disparity > 0, unknown).max() == pytest.approx(5)


@pytest.mark.parametrize("factor", [0.85, 1.2])
def test_a_size_that_may_be_another_one_is_told(factor):
    size = (int(640 * factor), int(480 * factor))
    with pytest.warns(UserWarning, match="depth is wrong by as much if they were resized"):
        Calibration(500, 0.1, cx=320, cy=240).require_size(*size)


def test_a_view_that_no_picture_has_is_refused_and_can_be_confirmed():
    with pytest.raises(InputError, match=r"view of 165 degrees: .*--fisheye.*predict.*--fov DEG"):
        pair(fx=42, fy=42)
    assert AssumedRig.of_field_of_view(165, 0.1).geometry(SIZE).focal == pytest.approx(42, rel=0.01)
    with pytest.raises(InputError, match="view of 165 degrees"):
        Rig((Calibration(42, 0.1),), "rig").geometry(SIZE)
    assert pair(fx=42, fy=42, distortion=(0, 0, 0, 0), fisheye=True)


@needs_shared
@pytest.mark.parametrize("name", ["eth3d", "middeval3"])
def test_public_data_sets_are_usual(name):
    data = open_data_set(name, SHARED / "data" / name)
    for index in range(min(len(data), 3)):
        sample = data[index]
        assert sample.calibration is not None
        height, width = sample.left.shape[-2:]
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            Rig((sample.calibration,), name).geometry((width, height))


def test_rectified_cameras_are_usual():
    """What rectification gives to cameras that are turned against each other."""
    turned = cv2.Rodrigues(np.array([0.02, 0.1, 0.03]))[0]
    cameras = pair()
    raw = CameraPair(cameras.left, cameras.right, turned, np.array([-0.1, 0, 0]), SIZE)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        calibration = Rectifier(Rig((raw,))).calibration(SIZE)
        assert told(calibration) == []
