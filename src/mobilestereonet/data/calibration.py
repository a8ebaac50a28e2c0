"""Calibration of a rectified pair, from files of the public data sets, of ROS and of OpenCV."""

from __future__ import annotations

import math
import re
import warnings
from pathlib import Path
from typing import Any

import numpy as np

from mobilestereonet.atomic import write_atomically
from mobilestereonet.data.camera_files import (
    Matrix,
    baseline_in_metres,
    is_opencv_file,
    matrix_of,
    read_camera_file,
)
from mobilestereonet.data.files import read_bytes
from mobilestereonet.data.sample import Calibration
from mobilestereonet.errors import InputError

MAX_FOCAL_DIFFERENCE = 1e-3
"""Largest relative difference between the focal lengths of two rectified views."""

MAX_ROW_DIFFERENCE_PX = 1.0
"""Largest difference between the principal points' rows of two rectified views."""

_SAME_FOCAL = 1e-6  # relative: what a writer rounds away
_ROS_PROJECTION = ("projection_matrix", "P", "p")  # a file, a printed message


def read_calibration(
    path: str | Path,
    cameras: tuple[int, int] = (2, 3),
    *,
    left: str | Path | None = None,
    unit: str | None = None,
) -> Calibration:
    """Read the calibration of a rectified pair, in any of several formats.

    The format is recognised by the content:

    - ``calib.txt`` of Middlebury (2014, 2021, MiddEval3) and ETH3D, with
      ``cam0=[fx 0 cx; 0 fy cy; 0 0 1]`` and the baseline in millimetres;
    - KITTI's projection matrices: ``P_rect_02`` and ``P_rect_03`` of ``calib_cam_to_cam.txt``,
      ``P2`` and ``P3`` of the files per frame and per sequence;
    - ROS's camera_info of the right camera as YAML, with ``projection_matrix`` (or ``P``);
    - what `cv2.stereoRectify` gives, in a file of OpenCV's FileStorage (YAML, XML or JSON):
      ``P1`` and ``P2``, or ``Q``.

    Args:
        path: The calibration file.
        cameras: Numbers of the left and the right camera in a KITTI file: 2 and 3 are the colour
            cameras, 0 and 1 the grey ones.
        left: For ROS only: the left camera's file, if its principal point is another one.
        unit: Unit of an OpenCV file, "m" or "mm": the one of the calibration board's squares.
            Metres if left out, and an implausible baseline is an error then.

    Returns:
        The calibration, with the baseline in metres.

    Raises:
        FileNotFoundError: If there is no such file.
        InputError: If the file is of no such format, lacks a value, has an impossible one, or
            its cameras are not those of a rectified pair.
    """
    text = read_bytes(path).decode("utf-8", errors="replace")
    entries: dict[str, Any] = dict(
        re.findall(r"^[ \t]*(\w+)[ \t]*[=:](.*)$", text, flags=re.MULTILINE)
    )
    if is_opencv_file(text) or not entries.keys().isdisjoint(_ROS_PROJECTION):
        entries = read_camera_file(path)
    of_opencv = is_opencv_file(text) and entries.keys().isdisjoint({"cam0", *_ROS_PROJECTION})
    if unit is not None and not of_opencv:
        warnings.warn(
            f"{path}: its format has a unit of its own: the unit {unit} has no effect", stacklevel=2
        )
    other = None if left is None else read_camera_file(left)
    try:
        if "cam0" in entries:
            return _middlebury(entries)
        if not entries.keys().isdisjoint(_ROS_PROJECTION):
            return _ros(entries, other)
        if is_opencv_file(text):
            return _opencv(entries, unit)
        if any(re.fullmatch(r"P(_rect_)?\d+", key) for key in entries):
            return _kitti(entries, cameras)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    raise InputError(
        f"{path}: unknown calibration format: found neither cam0=[...] (Middlebury, ETH3D) "
        "nor P_rect_02: or P2: (KITTI) nor projection_matrix: (ROS) nor P1:, P2: or Q: (OpenCV)"
    )


def from_projections(
    left: Matrix, right: Matrix, unit: str | None = None, size: tuple[int, int] | None = None
) -> Calibration:
    """Calibration of a rectified pair from its projection matrices.

    Args:
        left: Projection matrix of the left view, (3, 4). Entry (0, 3) is minus the focal length
            times the camera's place along the baseline.
        right: That of the right view.
        unit: Unit of the baseline; metres if left out, and it must be plausible then.
        size: Width and height of the views, if known.

    Raises:
        InputError: If the cameras are one above the other, their views are not rectified, or a
            value is impossible.
    """
    if abs(right[1, 3] - left[1, 3]) > abs(right[0, 3] - left[0, 3]):
        raise InputError("the cameras are one above the other: only pairs side by side are matched")
    baseline = (left[0, 3] - right[0, 3]) / left[0, 0] if left[0, 0] else 0.0
    doffs = right[0, 2] - left[0, 2]
    return _rectified(left, right, baseline_in_metres(float(baseline), unit), doffs, size)


def _rectified(
    left: Matrix, right: Matrix, baseline: float, doffs: float, size: tuple[int, int] | None
) -> Calibration:
    """Calibration from camera or projection matrices, checked to be those of a rectified pair."""
    for axis, name in ((0, "horizontal"), (1, "vertical")):
        focals = float(left[axis, axis]), float(right[axis, axis])
        if not math.isclose(*focals, rel_tol=MAX_FOCAL_DIFFERENCE):
            raise InputError(
                f"the {name} focal lengths are {focals[0]:g} px (left) and {focals[1]:g} px "
                "(right): such views are not rectified"
            )
    rows = float(left[1, 2]), float(right[1, 2])
    if abs(rows[0] - rows[1]) > MAX_ROW_DIFFERENCE_PX:
        raise InputError(
            f"the principal points are in rows {rows[0]:g} (left) and {rows[1]:g} (right): such "
            "views are not rectified"
        )
    return Calibration(
        focal=float(left[0, 0]),
        baseline=baseline,
        doffs=float(doffs),
        cx=float(left[0, 2]),
        cy=float(left[1, 2]),
        size=size,
        focal_y=_focal_y(left[0, 0], left[1, 1]),
    )


def _focal_y(fx: float, fy: float) -> float | None:
    return None if math.isclose(fx, fy, rel_tol=_SAME_FOCAL) else float(fy)


def _middlebury(entries: dict[str, str]) -> Calibration:
    left = _numbers(entries, "cam0", 3, 3)
    alone = "cam1" not in entries and "doffs" in entries
    right = left if alone else _numbers(entries, "cam1", 3, 3)
    doffs = _numbers(entries, "doffs", 1)[0] if "doffs" in entries else right[0, 2] - left[0, 2]
    baseline = _numbers(entries, "baseline", 1)[0] / 1000
    return _rectified(left, right, baseline, doffs, _size(entries, "width", "height"))


def _kitti(entries: dict[str, str], cameras: tuple[int, int]) -> Calibration:
    names = [(f"P_rect_{camera:02d}", f"P{camera}") for camera in cameras]
    left, right = (_numbers(entries, a if a in entries else b, 3, 4) for a, b in names)
    size = _size(entries, f"S_rect_{cameras[0]:02d}")
    return from_projections(left, right, "m", size)


def _ros(entries: dict[str, Any], left: dict[str, Any] | None) -> Calibration:
    """Calibration from the right camera's camera_info, whose projection holds the baseline.

    Without the left camera's file both views have the right one's principal point, as
    `cv2.stereoRectify` sees to by default.
    """
    right_matrix = matrix_of(entries, _ROS_PROJECTION, (3, 4))
    if right_matrix[0, 3] == 0:
        raise InputError(
            "its projection matrix has no baseline: it is the left camera's file; give the right "
            "camera's"
        )
    if left is None:
        left_matrix = right_matrix * [1, 1, 1, 0]
    else:
        left_matrix = matrix_of(left, _ROS_PROJECTION, (3, 4))
    size = None
    for names in (("image_width", "image_height"), ("width", "height")):  # a file, a message
        if size is None and set(names) <= entries.keys():
            width, height = (float(matrix_of(entries, [name], (1,))[0]) for name in names)
            size = _whole(width, height) if width or height else None
    return from_projections(left_matrix, right_matrix, "m", size)


def _opencv(entries: dict[str, Any], unit: str | None) -> Calibration:
    """Calibration from what `cv2.stereoRectify` gave: P1 and P2, or Q."""
    if {"P1", "P2"} <= entries.keys():
        left, right = (matrix_of(entries, [name], (3, 4)) for name in ("P1", "P2"))
        return from_projections(left, right, unit)
    if "Q" not in entries:
        raise InputError(
            f"neither P1 and P2 nor Q of a rectified pair in the file, only {', '.join(entries)}; "
            "`msnet rectify` takes what is not rectified yet"
        )
    q = matrix_of(entries, ["Q"], (4, 4))
    if 0 in (q[3, 2], q[0, 0], q[1, 1]):
        raise InputError("Q has no baseline or no focal length: (3, 2), (0, 0) or (1, 1) is 0")
    # Q (x, y, d, 1) = (X, Y, Z, W). OpenCV writes 1, 1 and f; fx = f / Q00 and fy = f / Q11 hold
    # for any Q, and Q = [1 0 0 -cx; 0 1 0 -cy; 0 0 0 f; 0 0 1/B (cx' - cx)/B] follows.
    return Calibration(
        focal=float(q[2, 3] / q[0, 0]),
        baseline=baseline_in_metres(float(q[0, 0] / q[3, 2]), unit),
        doffs=float(q[3, 3] / q[3, 2]),
        cx=float(-q[0, 3] / q[0, 0]),
        cy=float(-q[1, 3] / q[1, 1]),
        focal_y=_focal_y(q[2, 3] / q[0, 0], q[2, 3] / q[1, 1]),
    )


def _size(entries: dict[str, str], *names: str) -> tuple[int, int] | None:
    """Width and height, if the file has them."""
    if not set(names) <= entries.keys():
        return None
    width, height = (float(n) for name in names for n in _numbers(entries, name, 2 // len(names)))
    return _whole(width, height)


def _whole(width: float, height: float) -> tuple[int, int]:
    """Width and height as whole numbers; `Calibration` refuses what is not positive."""
    if not math.isfinite(width + height):
        raise InputError(f"width and height must be finite, got {width} and {height}")
    return round(width), round(height)


def _numbers(entries: dict[str, str], name: str, *shape: int) -> Matrix:
    if name not in entries:
        raise InputError(f"no {name} in the calibration, only {', '.join(entries)}")
    try:
        words = re.sub(r"[\[\];]", " ", entries[name]).split()
        return np.array([float(word) for word in words]).reshape(shape)
    except ValueError:
        raise InputError(
            f"{name} must hold {math.prod(shape)} number(s), got {entries[name].strip()!r}"
        ) from None


def write_calibration(path: str | Path, calibration: Calibration, size: tuple[int, int]) -> None:
    """Write the calibration of a rectified pair as Middlebury's ``calib.txt``, atomically.

    Args:
        path: The file to write.
        calibration: The geometry; the principal point is the middle of the picture if unknown.
        size: Width and height of the views, in px.

    Raises:
        InputError: If the calibration is known to be of another size.
    """
    width, height = size
    calibration.require_size(width, height)
    cx, cy = calibration.principal_point(width, height)
    (fx, fy), doffs = calibration.focal_lengths, calibration.doffs
    text = (
        f"cam0=[{fx!r} 0 {cx!r}; 0 {fy!r} {cy!r}; 0 0 1]\n"
        f"cam1=[{fx!r} 0 {cx + doffs!r}; 0 {fy!r} {cy!r}; 0 0 1]\n"
        f"doffs={doffs!r}\n"
        f"baseline={1000 * calibration.baseline!r}\n"
        f"width={width}\n"
        f"height={height}\n"
    )
    write_atomically(path, lambda temporary: temporary.write_text(text))
