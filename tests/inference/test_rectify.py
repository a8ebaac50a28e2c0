import cv2
import numpy as np
import pytest

from mobilestereonet.data import Rig
from mobilestereonet.data.rig import Camera, CameraPair
from mobilestereonet.errors import InputError
from mobilestereonet.inference import Rectifier, StereoMatcher, load_pair

SIZE = (320, 240)
CAMERA = np.array([[300.0, 0, 160], [0, 300, 120], [0, 0, 1]])
DISTORTION = np.array([-0.2, 0.05, 0.001, 0, 0])
ROTATION = cv2.Rodrigues(np.array([0.03, -0.05, 0.04]))[0]
TRANSLATION = np.array([-0.1, 0.004, 0.006])


def rig(**changes):
    cameras = {"left": Camera(CAMERA, DISTORTION), "right": Camera(CAMERA, 0.5 * DISTORTION)}
    pose = {"rotation": ROTATION, "translation": TRANSLATION, "size": SIZE}
    return Rig((CameraPair(**(cameras | pose | changes)),))


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
        left, right, calibration = Rectifier(rig(), whole=whole)(left, right)
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
    left, right, _ = Rectifier(rig())(view, view)
    assert left.dtype == right.dtype == dtype
    assert left.shape == view.shape
    # Cropped to what both know: no black border.
    assert min(left[2:-2, 2:-2].min(), right[2:-2, 2:-2].min()) > 150


def test_refused():
    view = np.zeros((SIZE[1], SIZE[0]), np.uint8)
    with pytest.raises(InputError, match=r"one shape, got \(240, 320\) and \(239, 320\)"):
        Rectifier(rig())(view, view[1:])
    with pytest.raises(InputError, match="of pictures of 640x480, these have 320x240"):
        Rectifier(rig(size=(640, 480)))(view, view)
    with pytest.raises(InputError, match=r"baseline must be positive.*swapped"):
        rig(translation=-TRANSLATION)
    with pytest.raises(InputError, match="one above the other"):
        rig(translation=TRANSLATION[[1, 0, 2]])


def fisheye_view(points, rotation, translation):
    """A picture with a bright dot at each point, as a fisheye camera of 170 degrees sees it."""
    camera = Camera(np.array([[100.0, 0, 160], [0, 100, 120], [0, 0, 1]]), LENS, fisheye=True)
    seen = (points @ rotation.T + translation)[:, None]
    places, _ = cv2.fisheye.projectPoints(
        seen, np.zeros(3), np.zeros(3), camera.matrix, camera.distortion
    )
    picture = np.zeros((SIZE[1], SIZE[0]), np.float32)
    rows, columns = np.mgrid[: SIZE[1], : SIZE[0]]
    for x, y in places.reshape(-1, 2):
        picture += np.exp(-((columns - x) ** 2 + (rows - y) ** 2) / 2)
    return camera, picture


LENS = np.array([-0.02, 0.004, 0.0, 0.0])


@pytest.mark.parametrize("whole", [False, True])
@pytest.mark.parametrize("angle", [0, 30, 45])
def test_fisheye_depth_is_right_far_from_the_axis_too(whole, angle):
    place = 2 * np.array([[np.sin(np.radians(angle)), 0.1, np.cos(np.radians(angle))]])
    camera, left = fisheye_view(place, np.eye(3), np.zeros(3))
    _, right = fisheye_view(place, ROTATION, TRANSLATION)
    fisheyes = {"left": camera, "right": camera}
    left, right, calibration = Rectifier(rig(**fisheyes), whole=whole)(left, right)
    ours, theirs = centre(left), centre(right)
    assert ours[1] == pytest.approx(theirs[1], abs=0.2)
    depth = calibration.focal * calibration.baseline / (ours[0] - theirs[0])
    x, y = (ours - (calibration.cx, calibration.cy)) * depth / calibration.focal
    # Large steps of the picture far from the axis, and a disparity of few pixels.
    assert np.linalg.norm([x, y, depth]) == pytest.approx(np.linalg.norm(place), rel=0.08)


def test_resized_pictures_give_the_same_depth():
    point = np.array([[0.1, 0.05, 1.2]])
    left = view_of(point, DISTORTION, np.eye(3), np.zeros(3))
    right = view_of(point, 0.5 * DISTORTION, ROTATION, TRANSLATION)
    half = [cv2.resize(view, (160, 120), interpolation=cv2.INTER_AREA) for view in (left, right)]
    with pytest.raises(InputError, match=r"these have 160x120.*--resized.*by 0\.5"):
        Rectifier(rig())(*half)
    with pytest.raises(InputError, match="160x100 cannot be resized ones of 320x240"):
        Rectifier(rig(), resized=True)(half[0][:100], half[1][:100])
    depths = []
    for rectifier, views in (
        (Rectifier(rig()), (left, right)),
        (Rectifier(rig(), resized=True), half),
    ):
        *views, calibration = rectifier(*views)
        x = [(view * np.arange(view.shape[1])).sum() / view.sum() for view in views]
        depths.append(calibration.focal * calibration.baseline / (x[0] - x[1]))
    assert depths[1] == pytest.approx(depths[0], rel=0.02)


def test_maps_are_computed_once(monkeypatch):
    made = []
    original = cv2.initUndistortRectifyMap
    monkeypatch.setattr(
        cv2, "initUndistortRectifyMap", lambda *a, **k: made.append(1) or original(*a, **k)
    )
    rectifier = Rectifier(rig())
    view = np.zeros((SIZE[1], SIZE[0]), np.uint8)
    for _ in range(3):
        rectifier(view, view)
    assert len(made) == 2


def test_a_matcher_rectifies_and_its_results_are_metric():
    noise = np.random.default_rng(0).integers(0, 256, (SIZE[1], SIZE[0], 3), dtype=np.uint8)
    pair = load_pair(noise, noise)
    rectifier = Rectifier(rig())
    ready = rectifier.pair(pair)
    expected, _, calibration = rectifier(noise, noise)
    assert ready.calibration == calibration
    np.testing.assert_allclose(ready.left_image, expected, atol=1)
    np.testing.assert_allclose(ready.left.permute(1, 2, 0) * 255, expected, atol=1)
    matcher = StereoMatcher.from_pretrained("sgbm", rig=rig())
    for result in (matcher(noise, noise), matcher.match(ready)):
        assert result.calibration == calibration
        np.testing.assert_array_equal(result.left, ready.left_image)
        np.testing.assert_array_equal(result.depth(), result.depth(calibration))
    with pytest.raises(InputError, match="of pictures of 320x240, these have 320x200"):
        matcher(noise[:200], noise[:200])
    with pytest.raises(InputError, match="depth needs a calibration"):
        StereoMatcher.from_pretrained("sgbm")(noise, noise).depth()
