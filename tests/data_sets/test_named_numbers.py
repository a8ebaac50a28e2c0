"""Cameras as named numbers: which distortion coefficients are whose."""

import json

import numpy as np
import pytest

from mobilestereonet.data import Calibration, Rig
from mobilestereonet.data.rig import CameraPair
from mobilestereonet.errors import InputError

SIZE = (752, 480)
MATRIX = {"fx": 460.0, "fy": 459.0, "cx": 367.0, "cy": 248.0}
LENS = {"k1": -0.3, "k2": 0.07, "p1": 1e-4, "p2": -2e-5}
KINDS = {"model": "equidistant", "k1": 0.1, "k2": 0.02, "k3": 0.003, "k4": 0.0004}
VINS = """%YAML:1.0
---
model_type: PINHOLE
image_width: 752
image_height: 480
distortion_parameters:
   k1: -0.3
   k2: 0.07
   p1: 1.0e-04
   p2: -2.0e-05
projection_parameters:
   fx: 460.0
   fy: 459.0
   cx: 367.0
   cy: 248.0
"""


def read(tmp_path, entries, **told):
    path = tmp_path / "cameras.json"
    path.write_text(json.dumps(entries))
    return Rig.read(path, **told).geometry(SIZE)


def both(camera):
    return {"left": camera, "right": camera, "baseline": 0.12}


@pytest.mark.parametrize(
    ("camera", "told", "expected"),
    [
        (MATRIX | LENS, {}, [-0.3, 0.07, 1e-4, -2e-5, 0]),
        (MATRIX | {"k1": -0.3}, {}, [-0.3, 0, 0, 0, 0]),
        (MATRIX | LENS | {"k3": 0.5}, {}, [-0.3, 0.07, 1e-4, -2e-5, 0.5]),
        (MATRIX | LENS | {"k6": 0.6}, {}, [-0.3, 0.07, 1e-4, -2e-5, 0, 0, 0, 0.6]),
        (MATRIX | {"distortion": LENS}, {}, [-0.3, 0.07, 1e-4, -2e-5, 0]),
        ({"intrinsics": MATRIX, "distortion": LENS}, {}, [-0.3, 0.07, 1e-4, -2e-5, 0]),
        ({"K": MATRIX, "dist_coeffs": [-0.3, 0, 0, 0, 0]}, {}, [-0.3, 0, 0, 0, 0]),
        (MATRIX | {"distortion_params": [-0.3, 0, 0, 0, 0]}, {}, [-0.3, 0, 0, 0, 0]),
        (MATRIX | KINDS, {}, [0.1, 0.02, 0.003, 0.0004]),
        (MATRIX | KINDS | {"model": ""}, {"fisheye": True}, [0.1, 0.02, 0.003, 0.0004]),
        (
            MATRIX | KINDS | {"model": ""},
            {"fisheye": False},
            [0.1, 0.02, 0, 0, 0.003, 0.0004, 0, 0],
        ),
    ],
)
def test_coefficients_of_both_cameras(tmp_path, camera, told, expected):
    pair = read(tmp_path, both(camera), **told)
    assert isinstance(pair, CameraPair)
    for each in (pair.left, pair.right):
        np.testing.assert_allclose(each.distortion, expected)
        assert each.fisheye == (len(expected) == 4)


def test_lenses_that_bend_nothing(tmp_path):
    for zero in ({}, dict.fromkeys(LENS, 0), {"distortion": [0] * 5}, {"distortion": "none"}):
        assert isinstance(read(tmp_path, both(MATRIX | zero)), Calibration)
        assert isinstance(read(tmp_path, {"camera": MATRIX | zero}, baseline=0.12), Calibration)


@pytest.mark.parametrize(
    ("entries", "message"),
    [
        (
            both(MATRIX) | {"distortion": {"left": LENS, "right": LENS}},
            "left_k1 belongs to",
        ),
        (both(MATRIX) | {"distortion_left": [0.1, 0, 0, 0, 0]}, "distortion_left belongs to no"),
        (both(MATRIX) | LENS, "k1 belongs to no camera: write"),
        (both(MATRIX | LENS | {"coeffs": [0.1, 0, 0, 0, 0]}), "which distortion coefficients"),
        (both(MATRIX | LENS | {"model": "fisheye"}), "not p1, p2"),
        (both(MATRIX | {"k1": "wide"}), "k1 must be a number, got 'wide'"),
        (both(MATRIX | KINDS | {"model": ""}), "--fisheye .*--pinhole"),
        ({"camera": MATRIX | LENS, "baseline": 0.12}, "one camera alone, whose lens distorts"),
    ],
)
def test_coefficients_that_are_not_used_are_refused(tmp_path, entries, message):
    with pytest.raises(InputError, match=message):
        read(tmp_path, entries)


def test_one_camera_of_vins_fusion(tmp_path):
    path = tmp_path / "cam0.yaml"
    path.write_text(VINS)
    with pytest.raises(InputError, match="one camera alone, whose lens distorts"):
        Rig.read(path, baseline=0.11)
    path.write_text(VINS.replace("-0.3", "0").replace("0.07", "0").replace("1.0e", "0.0e"))
    with pytest.raises(InputError, match="one camera alone, whose lens distorts"):
        Rig.read(path, baseline=0.11)  # p2 alone
    path.write_text(VINS.partition("distortion")[0] + VINS[VINS.index("projection") :])
    calibration = Rig.read(path, baseline=0.11).geometry(SIZE)
    assert (calibration.focal, calibration.size) == (460, SIZE)


def test_two_files_of_one_camera_each_are_not_merged(tmp_path):
    straight = VINS.partition("distortion")[0] + VINS[VINS.index("projection") :]
    paths = [tmp_path / "cam0.yaml", tmp_path / "cam1.yaml"]
    paths[0].write_text(straight)
    paths[1].write_text(straight.replace("367.0", "377.0"))
    with pytest.raises(InputError, match="none how the two stand to each other"):
        Rig.read(paths, baseline=0.11)
