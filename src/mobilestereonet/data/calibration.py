"""Calibration files of the public data sets."""

from __future__ import annotations

import re
from pathlib import Path

from mobilestereonet.data.files import read_bytes
from mobilestereonet.data.sample import Calibration
from mobilestereonet.errors import InputError


def read_calibration(path: str | Path, cameras: tuple[int, int] = (2, 3)) -> Calibration:
    """Read the geometry of a rectified pair; the format is told by the content.

    Understood are ``calib.txt`` of Middlebury (2014, 2021, MiddEval3) and ETH3D, with
    ``cam0=[f 0 cx; 0 f cy; 0 0 1]`` and the baseline in millimetres, and KITTI's projection
    matrices: ``P_rect_02`` and ``P_rect_03`` of ``calib_cam_to_cam.txt``, ``P2`` and ``P3`` of the
    files per frame and per sequence.

    Args:
        path: The calibration file.
        cameras: Numbers of the left and the right camera in a KITTI file: 2 and 3 are the colour
            cameras, 0 and 1 the grey ones.

    Returns:
        The calibration, with the baseline in metres.

    Raises:
        FileNotFoundError: If there is no such file.
        InputError: If the file is of neither format, or lacks a value.
    """
    text = read_bytes(path).decode("utf-8", errors="replace")
    entries = dict(re.findall(r"^[ \t]*(\w+)[ \t]*[=:](.*)$", text, flags=re.MULTILINE))
    try:
        if "cam0" in entries:
            return _middlebury(entries)
        if any(re.fullmatch(r"P(_rect_)?\d+", key) for key in entries):
            return _kitti(entries, cameras)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    raise InputError(
        f"{path}: unknown calibration format: found neither cam0=[...] (Middlebury, ETH3D) "
        "nor P_rect_02: or P2: (KITTI)"
    )


def _middlebury(entries: dict[str, str]) -> Calibration:
    left = _numbers(entries, "cam0", 9)
    if "doffs" in entries:
        doffs = _numbers(entries, "doffs", 1)[0]
    else:
        doffs = _numbers(entries, "cam1", 9)[2] - left[2]
    return Calibration(
        focal=left[0],
        baseline=_numbers(entries, "baseline", 1)[0] / 1000,
        doffs=doffs,
        cx=left[2],
        cy=left[5],
    )


def _kitti(entries: dict[str, str], cameras: tuple[int, int]) -> Calibration:
    matrices = []
    for camera in cameras:
        names = (f"P_rect_{camera:02d}", f"P{camera}")
        name = names[0] if names[0] in entries else names[1]
        matrices.append(_numbers(entries, name, 12))
    left, right = matrices
    return Calibration(
        focal=left[0],
        # Entry (0, 3) is minus the focal length times the camera's place along the baseline.
        baseline=(left[3] - right[3]) / left[0] if left[0] else 0.0,
        doffs=right[2] - left[2],
        cx=left[2],
        cy=left[6],
    )


def _numbers(entries: dict[str, str], name: str, count: int) -> list[float]:
    if name not in entries:
        raise InputError(f"no {name} in the calibration, only {', '.join(entries)}")
    try:
        values = [float(word) for word in re.sub(r"[\[\];]", " ", entries[name]).split()]
    except ValueError:
        values = []
    if len(values) != count:
        raise InputError(f"{name} must hold {count} number(s), got {entries[name].strip()!r}")
    return values
