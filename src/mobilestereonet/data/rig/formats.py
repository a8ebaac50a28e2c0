"""Which format a calibration file is of, by its content."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from mobilestereonet.data.rig.camera_info import PROJECTION, is_camera_info, pair_of_infos
from mobilestereonet.data.rig.data_sets import is_kitti, is_middlebury, read_kitti, read_middlebury
from mobilestereonet.data.rig.description import Description
from mobilestereonet.data.rig.devices import (
    is_oak,
    is_realsense_table,
    is_zed,
    read_oak,
    read_realsense_table,
    read_zed,
)
from mobilestereonet.data.rig.entries import Entries, read_entries
from mobilestereonet.data.rig.kalibr import is_camchain, is_sensor, read_camchain, read_sensors
from mobilestereonet.data.rig.named_numbers import find_intrinsics, read_intrinsics
from mobilestereonet.data.rig.opencv import find_names, read_opencv
from mobilestereonet.data.rig.orb_slam import is_orb_slam3, read_orb_slam3
from mobilestereonet.data.rig.told import Told
from mobilestereonet.data.rig.values import matrix_of
from mobilestereonet.errors import InputError

_FORMATS: tuple[tuple[Callable[[Entries], bool], Callable[[Entries, Told], Description]], ...] = (
    (is_middlebury, read_middlebury),
    (is_kitti, read_kitti),
    (is_camchain, read_camchain),
    (is_zed, read_zed),
    (is_oak, read_oak),
    (is_realsense_table, read_realsense_table),
    (is_orb_slam3, read_orb_slam3),
    (is_camera_info, lambda entries, told: Description(pair_of_infos(None, entries, told))),
    (lambda entries: bool(find_intrinsics(entries)), read_intrinsics),
    (lambda entries: bool(find_names(entries)), read_opencv),
)
"""Calibration formats of a single file: test and reader of each; the first match counts."""


def describe(paths: Sequence[Path], told: Told) -> Description:
    """Read the files of a rig.

    Raises:
        FileNotFoundError: If there is no such file.
        InputError: If they are of no known format, or a value is missing or impossible.
    """
    if not paths:
        raise InputError("a rig needs a file")
    files = [read_entries(path) for path in paths]
    try:
        return _describe(files, [str(path) for path in paths], told)
    except InputError as error:
        raise InputError(f"{', '.join(map(str, paths))}: {error}") from None


def _describe(files: list[Entries], names: list[str], told: Told) -> Description:
    if len(files) == 2 and all(map(is_camera_info, files)):
        return _infos(files, names, told)
    if len(files) == 2 and all(map(is_sensor, files)):
        return read_sensors(files[0], files[1], (names[0], names[1]), told)
    if any(is_sensor(entries) for entries in files):
        raise InputError("it is of one camera: give both files, --rig LEFT --rig RIGHT")
    merged: Entries = {}
    for entries in files:
        twice = find_intrinsics(merged).keys() & find_intrinsics(entries).keys()
        if twice:
            raise InputError(
                "each file tells about one camera, and none how the two stand to each other: "
                "write both into one file as left: and right:, with extrinsics: or baseline:"
            )
        merged |= entries
    for recognised, read in _FORMATS:
        if recognised(merged):
            return read(merged, told)
    raise InputError(
        "unknown calibration format: found neither cam0=[...] (Middlebury, ETH3D) nor P_rect_02: "
        "or P2: (KITTI), projection_matrix: (ROS), cam0: (Kalibr), T_BS: (EuRoC), [LEFT_CAM_HD] "
        "(ZED), cameraData (OAK), fx and ppx (RealSense), Camera1.fx (ORB-SLAM3), nor names of "
        "OpenCV's results such as "
        "K1 D1 K2 D2 R T, P1 P2 or Q"
    )


def _infos(files: list[Entries], names: list[str], told: Told) -> Description:
    """Two files of camera_info; the left one's P has the larger offset, whichever was first."""
    offsets = [float(matrix_of(entries, PROJECTION, (3, 4))[0, 3]) for entries in files]
    notes: tuple[str, ...] = ()
    if offsets[0] < offsets[1]:
        files, names = files[::-1], names[::-1]
        notes = (f"{names[0]} is of the left camera, {names[1]} of the right one",)
    return Description(pair_of_infos(files[0], files[1], told), notes)
