"""Calibration files, on texts as the public sets ship them."""

import cv2
import numpy as np
import pytest

from mobilestereonet.data import Calibration, read_calibration
from mobilestereonet.data.calibration import write_calibration
from mobilestereonet.errors import InputError

MIDDLEBURY = """cam0=[999.421 0 294.182; 0 999.421 252.932; 0 0 1]
cam1=[999.421 0 326.96; 0 999.421 252.932; 0 0 1]
doffs=32.778
baseline=193.001
width=741
height=497
ndisp=70
"""
# The first lines hold what other readers stumble on: a date, a name without a value.
KITTI_2015 = """calib_time: 09-Jan-2012 13:57:47
corner_dist: 9.950000e-02
S_02: 1.392000e+03 5.120000e+02
empty:
P_rect_00: 7.0e+02 0 6.0e+02 0 0 7.0e+02 1.8e+02 0 0 0 1 0
P_rect_01: 7.0e+02 0 6.0e+02 -3.78e+02 0 7.0e+02 1.8e+02 0 0 0 1 0
P_rect_02: 7.2e+02 0 6.1e+02 3.6e+01 0 7.2e+02 1.7e+02 2.1e-01 0 0 1 2.7e-03
P_rect_03: 7.2e+02 0 6.1e+02 -3.6e+02 0 7.2e+02 1.7e+02 2.1e+00 0 0 1 2.7e-03
S_rect_02: 1.242000e+03 3.750000e+02
"""


def calibration_of(tmp_path, text, **options):
    path = tmp_path / "calib.txt"
    path.write_bytes(text.encode())
    return read_calibration(path, **options)


@pytest.mark.parametrize("line_end", ["\n", "\r\n"])
def test_middlebury(tmp_path, line_end):
    result = calibration_of(tmp_path, MIDDLEBURY.replace("\n", line_end))
    assert result.focal == 999.421
    assert result.baseline == pytest.approx(0.193001)
    assert result.doffs == 32.778
    assert (result.cx, result.cy) == (294.182, 252.932)
    assert result.size == (741, 497)


def test_doffs_that_contradict_the_principal_points_are_refused(tmp_path):
    with pytest.raises(InputError, match=r"doffs is -32\.778 px, and .* differ by 32\.778 px"):
        calibration_of(tmp_path, MIDDLEBURY.replace("doffs=32.778", "doffs=-32.778"))


def test_middlebury_without_doffs_takes_the_principal_points(tmp_path):
    result = calibration_of(tmp_path, MIDDLEBURY.replace("doffs=32.778\n", ""))
    assert result.doffs == pytest.approx(32.778)


@pytest.mark.parametrize("line_end", ["\n", "\r\n"])
def test_kitti_colour_and_grey(tmp_path, line_end):
    text = KITTI_2015.replace("\n", line_end)
    colour = calibration_of(tmp_path, text)
    assert colour.focal == 720
    assert colour.baseline == pytest.approx(0.55)  # (36 + 360) / 720
    assert (colour.doffs, colour.cx, colour.cy) == (0, 610, 170)
    assert colour.size == (1242, 375)
    grey = calibration_of(tmp_path, text, cameras=(0, 1))
    assert grey.focal == 700
    assert grey.baseline == pytest.approx(0.54)
    assert grey.size is None


def test_kitti_per_frame_names(tmp_path):
    text = KITTI_2015.replace("P_rect_0", "P")
    assert calibration_of(tmp_path, text).baseline == pytest.approx(0.55)
    with pytest.raises(InputError, match=r"calib\.txt: no P4"):
        calibration_of(tmp_path, text, cameras=(0, 4))


def test_other_camera_numbers(tmp_path):
    text = KITTI_2015.replace("P_rect_02", "P_rect_101").replace("P_rect_03", "P_rect_103")
    assert calibration_of(tmp_path, text, cameras=(101, 103)).baseline == pytest.approx(0.55)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("hello", "unknown calibration format"),
        ("", "neither cam0"),
        (MIDDLEBURY.replace("baseline=193.001", ""), "no baseline"),
        (MIDDLEBURY.replace("width=741", "width=0"), "width and height must be positive"),
        (MIDDLEBURY.replace("width=741", "width=inf"), "width and height must be whole"),
        (MIDDLEBURY.replace("193.001", "wide"), "baseline must hold 1 number"),
        (MIDDLEBURY.replace("; 0 0 1]", "]"), "cam0 must hold 3 x 3 numbers"),
        (MIDDLEBURY.replace("193.001", "0"), "no baseline: --baseline METRES"),
        (KITTI_2015.replace(" 2.7e-03", ""), "P_rect_02 must hold 3 x 4 numbers"),
        # Cameras in the wrong order have a negative baseline.
        (KITTI_2015.replace("3.6e+01", "-3.7e+02"), "baseline must be positive"),
    ],
)
def test_refused(tmp_path, text, message):
    with pytest.raises(InputError, match=rf"calib\.txt: .*{message}"):
        calibration_of(tmp_path, text)


def test_missing_file(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"none\.txt"):
        read_calibration(tmp_path / "none.txt")


# A pair whose right camera stands 0.12 m to the right, with another principal point.
FOCAL, BASELINE, LEFT_CX, RIGHT_CX, CY = 700.0, 0.12, 320.0, 332.0, 240.0
ROS = """image_width: 640
image_height: 480
camera_name: narrow_stereo/right
camera_matrix:
  rows: 3
  cols: 3
  data: [712.0, 0.0, 318.0, 0.0, 711.0, 243.0, 0.0, 0.0, 1.0]
distortion_model: plumb_bob
projection_matrix:
  rows: 3
  cols: 4
  data: [700.0, 0.0, {cx}, {shift}, 0.0, 700.0, 240.0, 0.0, 0.0, 0.0, 1.0, 0.0]
"""
ROS_RIGHT = ROS.format(cx=RIGHT_CX, shift=-FOCAL * BASELINE)
ROS_LEFT = ROS.format(cx=LEFT_CX, shift=0.0)


def test_ros_takes_the_right_camera_and_both(tmp_path):
    alone = calibration_of(tmp_path, ROS_RIGHT)
    assert (alone.focal, alone.cx, alone.cy, alone.doffs) == (FOCAL, RIGHT_CX, CY, 0)
    assert alone.baseline == pytest.approx(BASELINE)
    left = tmp_path / "left.yaml"
    left.write_text(ROS_LEFT)
    both = calibration_of(tmp_path, ROS_RIGHT, left=left)
    assert (both.cx, both.doffs) == (LEFT_CX, RIGHT_CX - LEFT_CX)
    assert both.size == (640, 480)
    assert both.baseline == pytest.approx(BASELINE)


def test_ros_message_as_it_is_printed(tmp_path):
    message = (
        "header:\n  seq: 1\nheight: 480\nwidth: 640\nD: [0.0, 0.0]\n"
        "K: [712.0, 0.0, 318.0, 0.0, 711.0, 243.0, 0.0, 0.0, 1.0]\n"
        "P: [700.0, 0.0, 332.0, -84.0, 0.0, 700.0, 240.0, 0.0, 0.0, 0.0, 1.0, 0.0]\n---\n"
    )
    unknown = message.replace("480", "0").replace("640", "0")
    assert calibration_of(tmp_path, unknown).size is None
    for text in (message, message.replace("P:", "p:"), message * 2):
        assert calibration_of(tmp_path, text).baseline == pytest.approx(0.12)
        assert calibration_of(tmp_path, text).size == (640, 480)


def test_both_focal_lengths_are_kept(tmp_path):
    middlebury = MIDDLEBURY.replace("0 999.421 2", "0 1010.5 2")
    kitti = KITTI_2015.replace("7.2e+02 1.7e+02", "7.3e+02 1.7e+02")
    ros = ROS_RIGHT.replace("700.0, 240.0", "710.0, 240.0")
    for text, focals in ((middlebury, (999.421, 1010.5)), (kitti, (720, 730)), (ros, (700, 710))):
        result = calibration_of(tmp_path, text)
        assert result.focal_lengths == focals
    # What a writer rounds away is no difference.
    almost = calibration_of(tmp_path, MIDDLEBURY.replace("0 999.421 2", "0 999.42100001 2"))
    assert almost.focal_y is None
    projection = np.array([[700.0, 0, 320, 0], [0, 710, 240, 0], [0, 0, 1, 0]])
    right = projection.copy()
    right[0, 3] = -700 * BASELINE
    opencv_file(tmp_path / "stereo.yml", P1=projection, P2=right)
    assert read_calibration(tmp_path / "stereo.yml").focal_lengths == (700, 710)
    # The same camera as Q, whose rows for x and y may have factors of their own.
    q = np.diag([1.0, 700 / 710, 0, 0])
    q[0, 3], q[1, 3], q[2, 3], q[3, 2] = -320, -240 * 700 / 710, 700, 1 / BASELINE
    opencv_file(tmp_path / "stereo.yml", P1=None, P2=None, Q=q)
    result = read_calibration(tmp_path / "stereo.yml")
    assert result.focal_lengths == pytest.approx((700, 710))
    assert (result.cx, result.cy, result.baseline) == pytest.approx((320, 240, BASELINE))
    # A file written from it has them, too.
    write_calibration(tmp_path / "calib.txt", result, (640, 480))
    assert read_calibration(tmp_path / "calib.txt").focal_lengths == pytest.approx((700, 710))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (MIDDLEBURY.replace("cam1=[999.421", "cam1=[990.0"), "999.421 px .left. and 990 px"),
        (KITTI_2015.replace("P_rect_03: 7.2e+02", "P_rect_03: 7.3e+02"), "horizontal focal"),
        (KITTI_2015.replace("-3.6e+02 0 7.2e+02", "-3.6e+02 0 7.3e+02"), "vertical focal"),
        (MIDDLEBURY.replace("252.932; 0 0 1]\nd", "262.932; 0 0 1]\nd"), "rows 252.932"),
    ],
)
def test_views_that_are_not_rectified_are_refused(tmp_path, text, message):
    with pytest.raises(InputError, match=rf"calib\.txt: .*{message}.*not rectified"):
        calibration_of(tmp_path, text)


def opencv_file(path, unit=1.0, **values):
    """Write with OpenCV's own writer what OpenCV's own rectification gives."""
    intrinsics = np.array([[FOCAL, 0, LEFT_CX], [0, FOCAL, CY], [0, 0, 1]])
    other = intrinsics.copy()
    other[0, 2] = RIGHT_CX
    translation = np.array([[-BASELINE * unit], [0], [0]])
    flags = {"flags": 0, "alpha": -1}
    _, _, p1, p2, q, *_ = cv2.stereoRectify(
        intrinsics, np.zeros(5), other, np.zeros(5), (640, 480), np.eye(3), translation, **flags
    )
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for name, value in ({"P1": p1, "P2": p2, "Q": q} | values).items():
        if value is not None:
            storage.write(name, value)
    storage.release()
    # What OpenCV itself makes of a disparity of 20 px in the middle of the picture.
    return cv2.reprojectImageTo3D(np.full((480, 640), 20, np.float32), q)[240, 320] / unit


@pytest.mark.parametrize("left_out", [{"Q": None}, {"P1": None, "P2": None}])
@pytest.mark.parametrize("unit", [None, "m", "mm"])
@pytest.mark.parametrize("ending", ["yml", "xml", "json"])
def test_opencv(tmp_path, left_out, unit, ending):
    path = tmp_path / f"extrinsics.{ending}"
    x, y, z = opencv_file(path, unit=1000 if unit == "mm" else 1, **left_out)
    result = read_calibration(path, unit=unit)
    depth = result.focal * result.baseline / (20 + result.doffs)
    assert depth == pytest.approx(z, rel=1e-5)
    assert (320 - result.cx) / result.focal * depth == pytest.approx(x, abs=1e-5)
    assert (240 - result.cy) / result.focal * depth == pytest.approx(y, abs=1e-5)
    assert result.baseline == pytest.approx(BASELINE)
    assert result.doffs != 0


def test_opencv_without_a_header(tmp_path):
    opencv_file(tmp_path / "stereo.yml")
    header, _, body = (tmp_path / "stereo.yml").read_text().partition("---\n")
    assert header.startswith("%YAML")
    for text in (body, "---\n" + body, "%YAML:1.0\n" + body):
        assert calibration_of(tmp_path, text) == read_calibration(tmp_path / "stereo.yml")


def test_opencv_refused(tmp_path):
    path = tmp_path / "stereo.yml"
    opencv_file(path, unit=1000)
    with pytest.raises(InputError, match=r"stereo\.yml: a baseline of 120 m is implausible"):
        read_calibration(path)
    opencv_file(path, P1=None, Q=None)
    with pytest.raises(InputError, match="neither P1 and P2 nor Q"):
        read_calibration(path)
    opencv_file(path, P2=np.eye(3))
    with pytest.raises(InputError, match="P2 must hold 3 x 4 numbers"):
        read_calibration(path)
    opencv_file(path, P1=None, Q=np.eye(4) * [1, 1, 0, 1])
    with pytest.raises(InputError, match="Q has no baseline"):
        read_calibration(path)
    above = np.array([[700.0, 0, 320, 0], [0, 700, 240, -84], [0, 0, 1, 0]])
    opencv_file(path, P2=above)
    with pytest.raises(InputError, match="one above the other"):
        read_calibration(path)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (ROS_LEFT, "left camera's file"),
        (ROS_RIGHT.replace("1.0, 0.0]", "1.0]"), "projection_matrix must hold 3 x 4 numbers"),
        (ROS_RIGHT.replace("-84.0", "84.0"), "baseline must be positive.*-0.12.*swapped"),
        (ROS_RIGHT.replace("data: [700.0", "data: [-700.0"), "fx must be positive"),
        (ROS_RIGHT + "  - [", "not a calibration file"),
        ("- a\n- b:\n  P: 1\n", "unknown calibration format: it has no names"),
        ("%YAML:1.0\n---\njust a word\n", "unknown calibration format"),
        ("%YAML:1.0\n---\nQ: !!opencv-matrix\n  rows: 4\n", "Q must hold 4 x 4 numbers"),
        (
            '<?xml version="1.0"?>\n<opencv_storage><Q>1</P></opencv_storage>',
            "not a calibration file",
        ),
        ('{"Q": [1, 2', "not a calibration file"),
    ],
)
def test_refused_yaml(tmp_path, text, message):
    with pytest.raises(InputError, match=rf"calib\.txt: .*{message}"):
        calibration_of(tmp_path, text)


@pytest.mark.parametrize(
    "values",
    [
        {"focal": 0.0},
        {"focal_y": -1.0},
        {"baseline": -1.0},
        {"baseline": np.nan},
        {"doffs": np.inf},
    ],
)
def test_impossible_values_are_named(values):
    with pytest.raises(InputError, match=f"{next(iter(values))} must be"):
        Calibration(**({"focal": 1.0, "baseline": 1.0} | values))


def test_another_size_is_told_with_the_way_out():
    calibration = Calibration(focal=500, baseline=0.1, size=(640, 480))
    calibration.require_size(640, 480)
    with pytest.raises(
        InputError, match=r"--resized .* by 0\.5, and in Python \.resized\(\(320, 2"
    ):
        calibration.require_size(320, 240)
    calibration.resized((320, 240)).require_size(320, 240)
    with pytest.raises(InputError, match=r"640x480, these have 480x640 .*: write the width first"):
        calibration.require_size(480, 640)
