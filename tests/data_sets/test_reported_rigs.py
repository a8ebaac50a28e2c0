"""Situations that people reported publicly; their inputs are in the shared folder."""

import pytest

from extras import SHARED, needs_shared
from mobilestereonet.data import Rig
from mobilestereonet.errors import InputError

BUGS = SHARED / "bugs"
SIZE = (370, 250)

RIGHT = {
    "millimetres": ("ros-millimetres/right.yaml", {"unit": "mm"}),
    "baseline in the left camera": (
        ("oak-left-baseline/left.yaml", "oak-left-baseline/right.yaml"),
        {},
    ),
    "corners": ("filestorage-channels/corners.yml", {}),
    "JSON of OpenCV": ("filestorage-channels/stereo.json", {}),
    "camchain": ("kalibr-taken-for-middlebury/camchain.yaml", {}),
    "plain P1 and P2": ("kalibr-taken-for-middlebury/projections.yaml", {}),
    "plain Q": ("plain-yaml-q/q.yaml", {}),
    "plain JSON": ("plain-yaml-q/projections.json", {}),
    "KITTI-360": ("kitti-other-cameras/perspective.txt", {}),
    "DrivingStereo": ("drivingstereo-cameras/calib.txt", {}),
    "grey": ("drivingstereo-cameras/grey.txt", {"cameras": (0, 1)}),
    "byte-order mark": ("bom/calib.txt", {}),
    "ROS's own files": (
        ("ros-yaml-rectify/left.yaml", "ros-yaml-rectify/right.yaml"),
        {"rectified": True},
    ),
    "binning": ("ros-binning/standard.yaml", {}),
    "binning of matrices": ("ros-binning/scaled_p.yaml", {}),
}

REFUSED = {
    "millimetres": ("ros-millimetres/right.yaml", "120 m is implausible.*--unit mm"),
    "fisheye": ("fisheye-rig/rig.yml", "--fisheye .*--pinhole"),
    "transposed": ("rig-not-cameras/rig.yml", "transposed, as MATLAB has it"),
    "three coefficients": ("distortion-count/rig.yml", "got 3"),
    "half of an OAK": ("oak-left-baseline/right.yaml", "give both"),
    "size": ("opencv-size-ignored/stereo.yml", "of pictures of 740x500, these have 370x250"),
}


def paths(names):
    return [BUGS / name for name in ([names] if isinstance(names, str) else names)]


@needs_shared
@pytest.mark.parametrize("case", RIGHT)
def test_depth_is_right(case):
    names, options = RIGHT[case]
    calibration = Rig.read(paths(names), **options).geometry(SIZE)
    assert calibration.focal * calibration.baseline == pytest.approx(60, rel=1e-6)
    assert (calibration.cx, calibration.cy, calibration.doffs) == (185, 125, 0)


@needs_shared
@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_be_right_is_refused(case):
    names, message = REFUSED[case]
    with pytest.raises(InputError, match=message):
        Rig.read(paths(names)).geometry(SIZE)
