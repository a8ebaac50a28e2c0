"""Calibration files of public data sets: Middlebury, ETH3D, KITTI and those that follow them."""

from __future__ import annotations

import re

import numpy as np

from mobilestereonet.data.rig.camera_info import calibrated_pair, in_metres
from mobilestereonet.data.rig.cameras import Matrix, Size, checked_rotation
from mobilestereonet.data.rig.description import Description, Geometry, chosen_two
from mobilestereonet.data.rig.entries import Entries
from mobilestereonet.data.rig.lenses import camera_of
from mobilestereonet.data.rig.rectified import from_cameras, from_projections
from mobilestereonet.data.rig.told import Told
from mobilestereonet.data.rig.values import matrix_of, number_of, size_of
from mobilestereonet.errors import InputError

COLOUR_CAMERAS = (2, 3)
"""KITTI's; 0 and 1 are grey."""

_PROJECTION = re.compile(r"(P_rect_|P)(\d+)")

MAX_DOFFS_DIFFERENCE_PX = 2.0
"""Difference of a file's doffs from that of its principal points above which one is wrong."""


def is_middlebury(entries: Entries) -> bool:
    """Whether entries are lines of a Middlebury or ETH3D calib.txt."""
    return isinstance(entries.get("cam0"), str)


def is_kitti(entries: Entries) -> bool:
    """Whether entries are lines of a KITTI calibration."""
    return any(_PROJECTION.fullmatch(name) and isinstance(entries[name], str) for name in entries)


def read_middlebury(entries: Entries, told: Told) -> Description:
    """Rig from the calib.txt of Middlebury (2014, 2021, MiddEval3) or ETH3D, in millimetres.

    Raises:
        InputError: If a value is missing or impossible.
    """
    left = matrix_of(entries, "cam0", (3, 3))
    alone = "cam1" not in entries and "doffs" in entries
    right = left if alone else matrix_of(entries, "cam1", (3, 3))
    doffs = number_of(entries, "doffs") if "doffs" in entries else None
    size = None
    if {"width", "height"} <= entries.keys():
        size = size_of(*(number_of(entries, side) for side in ("width", "height")))
    length = 0.0 if told.baseline and "baseline" not in entries else number_of(entries, "baseline")
    baseline = told.metres(length, "mm")
    between = float(right[0, 2] - left[0, 2])
    if doffs is not None and not alone and abs(doffs - between) > MAX_DOFFS_DIFFERENCE_PX:
        raise InputError(
            f"doffs is {doffs:g} px, and the principal points, right less left, differ by "
            f"{between:g} px: correct the one that is wrong"
        )
    return Description((from_cameras(left, right, baseline, doffs, size),))


def read_kitti(entries: Entries, told: Told) -> Description:
    """Rig from projection matrices ``P_rect_02`` or ``P2``, as KITTI and its followers have them.

    By default the cameras are the colour ones, 2 and 3, or those that the file has: KITTI-360's 0
    and 1, DrivingStereo's 101 and 103.

    Raises:
        InputError: If the file does not tell which cameras are meant, or a value is impossible.
    """
    numbers = sorted({int(m[2]) for name in entries if (m := _PROJECTION.fullmatch(name))})
    cameras, notes = told.cameras, tuple[str, ...]()
    if cameras is None:
        cameras, notes = _chosen(numbers)
    for number in cameras:
        if number not in numbers:
            raise InputError(
                f"no P{number} or P_rect_{number:02d} in the file, only of the cameras "
                f"{', '.join(map(str, numbers))}: --cameras LEFT RIGHT names them"
            )
    projections = [
        matrix_of(entries, [f"P_rect_{number:02d}", f"P{number}"], (3, 4)) for number in cameras
    ]
    size = _size(entries, f"S_rect_{cameras[0]:02d}")
    rectified = from_projections(projections[0], projections[1], told, size=size)
    geometries: list[Geometry] = [rectified]
    if (
        not told.rectified
        and size is not None
        and all(_tells_raw(entries, number) for number in cameras)
    ):
        geometries.append(_raw(entries, cameras, projections, rectified.baseline, size, told))
    return Description(tuple(geometries), notes)


def _chosen(numbers: list[int]) -> tuple[tuple[int, int], tuple[str, ...]]:
    """The cameras that are meant if nobody says, and the note that others are there."""
    if set(COLOUR_CAMERAS) <= set(numbers):
        others = [number for number in numbers if number not in COLOUR_CAMERAS]
        note = "cameras 2 and 3, the colour ones; the grey ones are --cameras 0 1"
        return COLOUR_CAMERAS, (note,) if others else ()
    return chosen_two(numbers, "P"), ()


def _tells_raw(entries: Entries, number: int) -> bool:
    return {f"{name}_{number:02d}" for name in ("K", "D", "S", "R_rect")} <= entries.keys()


def _raw(
    entries: Entries,
    cameras: tuple[int, int],
    projections: list[Matrix],
    baseline: float,
    size: Size,
    told: Told,
) -> Geometry:
    """Geometry of the pictures before KITTI's rectification, which has another size."""
    lenses, rotations = [], []
    for number in cameras:
        matrix = matrix_of(entries, f"K_{number:02d}", (3, 3))
        if not matrix[2].any():  # KITTI-360's
            matrix = matrix + np.diag([0.0, 0, 1])
        distortion = matrix_of(entries, f"D_{number:02d}", (-1,))
        lenses.append(camera_of(matrix, distortion, "plumb_bob", told))
        name = f"R_rect_{number:02d}"
        rotations.append(checked_rotation(matrix_of(entries, name, (3, 3)), name))
    left, right = in_metres(projections[0], projections[1], baseline)
    raw_size = _size(entries, f"S_{cameras[0]:02d}")
    return calibrated_pair(lenses, rotations, (left, right), baseline, raw_size, size)


def _size(entries: Entries, name: str) -> Size | None:
    return size_of(*matrix_of(entries, name, (2,))) if name in entries else None
