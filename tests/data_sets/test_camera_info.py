"""Rigs from ROS's camera_info messages."""

import numpy as np
import pytest

from mobilestereonet.data import Calibration
from mobilestereonet.data.rig import CameraPair, Rig
from mobilestereonet.errors import InputError

SIZE = (370, 250)


def info(shift=0.0, focal=500.0, **changes):
    """A message as names and values; its raw pictures are distorted."""
    camera = {
        "width": 370,
        "height": 250,
        "distortion_model": "plumb_bob",
        "D": [-0.1, 0.02, 0.0, 0.0, 0.0],
        "K": [480.0, 0.0, 182.0, 0.0, 480.0, 127.0, 0.0, 0.0, 1.0],
        "R": [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        "P": [focal, 0, 185.0, shift, 0.0, focal, 125.0, 0.0, 0.0, 0.0, 1.0, 0.0],
    }
    return camera | changes


def test_raw_and_rectified():
    rig = Rig.from_camera_info(info(), info(-60.0))
    raw = rig.geometry(SIZE)
    assert isinstance(raw, CameraPair)
    np.testing.assert_allclose(raw.translation, [-0.12, 0, 0])
    rectified = rig.geometry(SIZE, rectified=True)
    assert isinstance(rectified, Calibration)
    assert (rectified.focal, rectified.baseline) == (500, pytest.approx(0.12))
    with pytest.raises(InputError, match="of pictures of 370x250, these have 740x500"):
        rig.geometry((740, 500))
    assert rig.resized((740, 500)).geometry((740, 500), rectified=True).focal == 1000


def test_names_in_lower_case_and_a_baseline_in_the_left_camera():
    left, right = info(60.0), info(0.0)
    lower = [{name.lower(): value for name, value in one.items()} for one in (left, right)]
    for pair in ((left, right), lower):
        assert Rig.from_camera_info(*pair).geometry(SIZE, rectified=True).baseline == 0.12


def test_views_that_need_no_rectification():
    straight = {"K": [500.0, 0, 185, 0, 500, 125, 0, 0, 1], "D": [0.0] * 5}
    rig = Rig.from_camera_info(info(**straight), info(-60.0, **straight))
    assert isinstance(rig.geometry(SIZE), Calibration)
    assert len(rig.geometries) == 1


@pytest.mark.parametrize("unknown", ["K", "R"])
def test_matrices_that_are_zero_tell_nothing_of_raw_pictures(unknown):
    zero = {unknown: [0.0] * 9}
    for left, right in ((zero, {}), ({}, zero), (zero, zero)):
        rig = Rig.from_camera_info(info(**left), info(-60.0, **right))
        assert rig.geometries == (rig.calibration,)
        assert (rig.calibration.focal, rig.calibration.baseline) == (500, pytest.approx(0.12))


@pytest.mark.parametrize("fisheye", ["equidistant", "fisheye"])
def test_fisheye(fisheye):
    model = {"distortion_model": fisheye, "D": [0.1, 0.0, 0.0, 0.0]}
    raw = Rig.from_camera_info(info(**model), info(-60.0, **model)).geometry(SIZE)
    assert raw.left.fisheye and raw.right.fisheye


@pytest.mark.parametrize("scale", [1, 2])
def test_binning_with_matrices_of_the_sensor_or_of_the_picture(scale):
    """The sensor has 740x500; some drivers give K and P of the binned picture."""
    changes = {
        "width": 740,
        "height": 500,
        "binning_x": 2,
        "binning_y": 2,
        "K": [480.0 * scale, 0, 182.0 * scale, 0, 480.0 * scale, 127.0 * scale, 0, 0, 1],
    }
    left, right = info(), info()
    for one, shift in ((left, 0.0), (right, -60.0)):
        p = scale * np.array([[500, 0, 185, shift], [0, 500, 125, 0]])
        one |= changes | {"P": [*p.ravel().tolist(), 0, 0, 1, 0]}
    rectified = Rig.from_camera_info(left, right).geometry(SIZE, rectified=True)
    assert (rectified.focal, rectified.cx, rectified.baseline) == (500, 185, 0.12)


def test_a_region_of_interest_moves_the_principal_point():
    part = {"roi": {"x_offset": 20, "y_offset": 10, "width": 200, "height": 200}}
    rig = Rig.from_camera_info(info(**part), info(-60.0, **part))
    calibration = rig.geometry((200, 200), rectified=True)
    assert (calibration.cx, calibration.cy, calibration.focal) == (165, 115, 500)


@pytest.mark.parametrize(
    ("left", "right", "message"),
    [
        (info(), info(60.0), "baseline must be positive, got -0.12 m: are the cameras swapped"),
        (info(), info(), "no baseline: --baseline METRES"),
        (info(), info(-60000.0), r"120 m is implausible.*--unit cm \(1.2 m\) or --unit mm"),
        (info(), info(-0.06), r"0.00012 m is implausible"),
        (info(), info(-60.0, P=[0.0] * 12), "the last row of"),
        (info(), info(-60.0, R=[2.0, 0, 0, 0, 1, 0, 0, 0, 1]), "R is no rotation"),
        (info(), info(-60.0, R=[-1.0, 0, 0, 0, 1, 0, 0, 0, 1]), "a reflection"),
        (info(), info(-60.0, D=[0.1, 0.0, 0.0]), "has 0, 4, 5, 8, 12 or 14 .* got 3"),
        (info(), info(-60.0, distortion_model="mei"), "model mei cannot be rectified"),
        (info(), info(-60.0, K=[480.0, 0, 0, 0, 480, 0, 182, 127, 1]), "transposed"),
        (info(), info(-60.0, K=[480.0, 0, 900, 0, 480, 127, 0, 0, 1]), r"\(900, 127\) is outside"),
        (info(), info(-60.0, K=[3.6, 0, 182, 0, 3.6, 127, 0, 0, 1]), "pixels, not in millimetres"),
        (info(), info(-60.0, width=0.5), "whole numbers"),
        (info(focal=510.0), info(-60.0), "not rectified"),
    ],
)
def test_refused(left, right, message):
    with pytest.raises(InputError, match=rf"camera_info: .*{message}"):
        Rig.from_camera_info(left, right)


def test_the_user_tells_the_unit_and_the_baseline():
    millimetres = Rig.from_camera_info(info(), info(-60000.0), unit="mm")
    assert millimetres.geometry(SIZE, rectified=True).baseline == pytest.approx(0.12)
    told = Rig.from_camera_info(info(), info(), baseline=0.2).geometry(SIZE)
    np.testing.assert_allclose(told.translation, [-0.2, 0, 0])
    with pytest.raises(InputError, match=r"and --baseline says 0\.2 m"):
        Rig.from_camera_info(info(), info(-60.0), baseline=0.2)
    with pytest.raises(InputError, match="a unit is one of m, cm, mm, got 'inch'"):
        Rig.from_camera_info(info(), info(-60.0), unit="inch")
