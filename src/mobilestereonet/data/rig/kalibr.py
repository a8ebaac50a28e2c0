"""Kalibr's camchain and EuRoC's sensor.yaml: cameras by their poses."""

from __future__ import annotations

import re
from functools import reduce

from mobilestereonet.data.rig.cameras import Camera, Size
from mobilestereonet.data.rig.description import (
    Description,
    Pose,
    chosen_two,
    matrix_of_numbers,
    one_size,
    pair_of,
)
from mobilestereonet.data.rig.entries import Entries
from mobilestereonet.data.rig.lenses import camera_of
from mobilestereonet.data.rig.told import Told
from mobilestereonet.data.rig.values import listed, matrix_of, size_of
from mobilestereonet.errors import InputError

_CAMERA = re.compile(r"cam(\d+)")


def is_camchain(entries: Entries) -> bool:
    """Whether entries are a camchain of Kalibr."""
    return any(_CAMERA.fullmatch(name) and isinstance(entries[name], dict) for name in entries)


def is_sensor(entries: Entries) -> bool:
    """Whether entries are one camera of EuRoC's."""
    return "T_BS" in entries and "intrinsics" in entries


def read_camchain(entries: Entries, told: Told) -> Description:
    """Rig from Kalibr's camchain.

    Raises:
        InputError: If it does not tell which two cameras are meant, or a value is impossible.
    """
    chain = {
        int(match[1]): value
        for name, value in entries.items()
        if (match := _CAMERA.fullmatch(name)) and isinstance(value, dict)
    }
    first, second = told.cameras or chosen_two(sorted(chain), "cam")
    for number in (first, second):
        if number not in chain:
            raise InputError(f"no cam{number} in the file, only {listed(entries)}")
    low, high = sorted((first, second))
    steps = [
        Pose.of_matrix(matrix_of(chain.get(number, {}), "T_cn_cnm1", (4, 4)), "T_cn_cnm1")
        for number in range(low + 1, high + 1)
    ]
    pose = reduce(lambda before, step: step.after(before), steps)
    if first > second:
        pose = pose.inverse()
    cameras = [chain[number] for number in (first, second)]
    return _ordered(cameras, (f"cam{first}", f"cam{second}"), pose, told)


def read_sensors(
    first: Entries, second: Entries, names: tuple[str, str], told: Told
) -> Description:
    """Rig from the sensor.yaml of two cameras of EuRoC.

    Args:
        first: One camera's entries.
        second: The other one's.
        names: What messages call them.
        told: What the user says.

    Raises:
        InputError: If a value is missing or impossible.
    """
    poses = [Pose.of_matrix(matrix_of(one, "T_BS", (4, 4)), "T_BS") for one in (first, second)]
    return _ordered([first, second], names, poses[1].inverse().after(poses[0]), told)


def _ordered(cameras: list[Entries], names: tuple[str, str], pose: Pose, told: Told) -> Description:
    """The pair, its left camera first, unless the user says which one that is."""
    notes: tuple[str, ...] = ()
    if pose.is_to_the_left and told.cameras is None:
        cameras, pose = cameras[::-1], pose.inverse()
        notes = (f"{names[1]} is the left camera, {names[0]} the right one",)
    (left, left_size), (right, right_size) = (_camera(entries, told) for entries in cameras)
    size = one_size(left_size, right_size)
    return Description((pair_of(left, right, pose, told, size=size),), notes)


def _camera(entries: Entries, told: Told) -> tuple[Camera, Size | None]:
    model = str(entries.get("camera_model", "pinhole"))
    if model != "pinhole":
        raise InputError(
            f"pictures of the camera model {model} cannot be rectified here, those of pinhole can"
        )
    matrix = matrix_of_numbers(*matrix_of(entries, "intrinsics", (4,)))
    names = ("distortion_coeffs", "distortion_coefficients")
    size = size_of(*matrix_of(entries, "resolution", (2,))) if "resolution" in entries else None
    name = str(entries.get("distortion_model", ""))
    return camera_of(matrix, matrix_of(entries, names, (-1,)), name, told), size
