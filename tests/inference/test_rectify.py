import cv2
import numpy as np
import pytest

from mobilestereonet.data.camera_files import StereoRig
from mobilestereonet.errors import InputError
from mobilestereonet.inference.rectify import rectify_pair

SIZE = (320, 240)
CAMERA = np.array([[300.0, 0, 160], [0, 300, 120], [0, 0, 1]])
DISTORTION = np.array([-0.2, 0.05, 0.001, 0, 0])
ROTATION = cv2.Rodrigues(np.array([0.03, -0.05, 0.04]))[0]
TRANSLATION = np.array([-0.1, 0.004, 0.006])


def rig(**changes):
    cameras = {"left": CAMERA, "left_distortion": DISTORTION, "right": CAMERA}
    pose = {"right_distortion": 0.5 * DISTORTION, "rotation": ROTATION, "translation": TRANSLATION}
    return StereoRig(**(cameras | pose | {"size": SIZE} | changes))


def view_of(points, distortion, rotation, translation):
    """A picture with a bright dot at each point, as a camera sees it."""
    places, _ = cv2.projectPoints(
        points, cv2.Rodrigues(rotation)[0], translation[:, None], CAMERA, distortion
    )
    picture = np.zeros((SIZE[1], SIZE[0]), np.float32)
    rows, columns = np.mgrid[: SIZE[1], : SIZE[0]]
    for x, y in places.reshape(-1, 2):
        picture += np.exp(-((columns - x) ** 2 + (rows - y) ** 2) / 2)
    return picture


def centre(picture):
    rows, columns = np.mgrid[: SIZE[1], : SIZE[0]]
    return np.array([(picture * columns).sum(), (picture * rows).sum()]) / picture.sum()


@pytest.mark.parametrize("whole", [False, True])
def test_a_point_lands_in_one_row_and_its_depth_is_right(whole):
    for point in ([0.02, 0.03, 1.0], [-0.15, 0.1, 1.5], [0.2, -0.15, 1.2]):
        point = np.array([point])
        left = view_of(point, DISTORTION, np.eye(3), np.zeros(3))
        right = view_of(point, 0.5 * DISTORTION, ROTATION, TRANSLATION)
        left, right, calibration = rectify_pair(left, right, rig(), whole=whole)
        assert left.shape == right.shape == SIZE[::-1]
        ours, theirs = centre(left), centre(right)
        assert ours[1] == pytest.approx(theirs[1], abs=0.05)
        disparity = ours[0] - theirs[0]
        depth = calibration.focal * calibration.baseline / (disparity + calibration.doffs)
        x, y = (ours - (calibration.cx, calibration.cy)) * depth / calibration.focal
        # The rectified camera is turned, so the distance from its centre is what stays.
        assert np.linalg.norm([x, y, depth]) == pytest.approx(np.linalg.norm(point), rel=5e-3)
        assert calibration.baseline == pytest.approx(np.linalg.norm(TRANSLATION))


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_dtype_and_channels_stay(dtype):
    view = np.full((SIZE[1], SIZE[0], 3), 200, dtype)
    left, right, _ = rectify_pair(view, view, rig())
    assert left.dtype == right.dtype == dtype
    assert left.shape == view.shape
    # Cropped to what both know: no black border.
    assert min(left[2:-2, 2:-2].min(), right[2:-2, 2:-2].min()) > 150


def test_refused():
    view = np.zeros((SIZE[1], SIZE[0]), np.uint8)
    with pytest.raises(InputError, match=r"one shape, got \(240, 320\) and \(239, 320\)"):
        rectify_pair(view, view[1:], rig())
    with pytest.raises(InputError, match="calibrated at 640x480, the views have 320x240"):
        rectify_pair(view, view, rig(size=(640, 480)))
    with pytest.raises(InputError, match=r"baseline must be positive.*swapped"):
        rectify_pair(view, view, rig(translation=-TRANSLATION))
    with pytest.raises(InputError, match="one above the other"):
        rectify_pair(view, view, rig(translation=TRANSLATION[[1, 0, 2]]))
