"""Calibration files, on texts as the public sets ship them."""

import pytest

from mobilestereonet.data import read_calibration
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
    grey = calibration_of(tmp_path, text, cameras=(0, 1))
    assert grey.focal == 700
    assert grey.baseline == pytest.approx(0.54)


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
        ("hello", "neither cam0"),
        ("", "neither cam0"),
        (MIDDLEBURY.replace("baseline=193.001", ""), "no baseline"),
        (MIDDLEBURY.replace("193.001", "wide"), "baseline must hold 1 number"),
        (MIDDLEBURY.replace("; 0 0 1]", "]"), "cam0 must hold 9"),
        (MIDDLEBURY.replace("193.001", "0"), "baseline must be positive"),
        (KITTI_2015.replace(" 2.7e-03", ""), "P_rect_02 must hold 12"),
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
