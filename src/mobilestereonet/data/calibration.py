"""Calibration files: of the public data sets, of ROS and of OpenCV."""

from __future__ import annotations

import re
from pathlib import Path

from mobilestereonet.atomic import write_atomically
from mobilestereonet.data.camera_yaml import (
    from_camera_info,
    from_opencv,
    is_camera_info,
    read_camera_yaml,
    view_size,
)
from mobilestereonet.data.files import read_bytes
from mobilestereonet.data.sample import Calibration
from mobilestereonet.errors import InputError


def read_calibration(
    path: str | Path,
    cameras: tuple[int, int] = (2, 3),
    *,
    left: str | Path | None = None,
    unit: str | None = None,
) -> Calibration:
    """Read the geometry of a rectified pair; the format is told by the content.

    Understood are:

    - ``calib.txt`` of Middlebury (2014, 2021, MiddEval3) and ETH3D, with
      ``cam0=[f 0 cx; 0 f cy; 0 0 1]`` and the baseline in millimetres;
    - KITTI's projection matrices: ``P_rect_02`` and ``P_rect_03`` of ``calib_cam_to_cam.txt``,
      ``P2`` and ``P3`` of the files per frame and per sequence;
    - ROS's camera_info of the right camera as YAML, with ``projection_matrix`` (or ``P``);
    - what `cv2.stereoRectify` gives, in FileStorage YAML: ``P1`` and ``P2``, or ``Q``.

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
        InputError: If the file is of no such format, lacks a value, or has an impossible one.
    """
    text = read_bytes(path).decode("utf-8", errors="replace")
    entries = dict(re.findall(r"^[ \t]*(\w+)[ \t]*[=:](.*)$", text, flags=re.MULTILINE))
    is_yaml = text.startswith("%YAML") or "!!opencv-matrix" in text or is_camera_info(entries)
    document = read_camera_yaml(path) if is_yaml else {}
    other = read_camera_yaml(left) if left is not None else None
    try:
        if "cam0" in entries:
            return _middlebury(entries)
        if is_camera_info(document):
            return from_camera_info(document, other)
        if is_yaml:
            return from_opencv(document, unit)
        if any(re.fullmatch(r"P(_rect_)?\d+", key) for key in entries):
            return _kitti(entries, cameras)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    raise InputError(
        f"{path}: unknown calibration format: found neither cam0=[...] (Middlebury, ETH3D) "
        "nor P_rect_02: or P2: (KITTI) nor projection_matrix: (ROS) nor P1:, P2: or Q: (OpenCV)"
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
        size=_size(entries, "width", "height"),
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
        size=_size(entries, f"S_rect_{cameras[0]:02d}"),
    )


def _size(entries: dict[str, str], *names: str) -> tuple[int, int] | None:
    """Width and height, where the file tells them."""
    if not set(names) <= entries.keys():
        return None
    width, height = (n for name in names for n in _numbers(entries, name, 2 // len(names)))
    return view_size(width, height)


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


def write_calibration(path: str | Path, calibration: Calibration, size: tuple[int, int]) -> None:
    """Write the geometry of a rectified pair as Middlebury's ``calib.txt``, atomically.

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
    focal, doffs = calibration.focal, calibration.doffs
    text = (
        f"cam0=[{focal!r} 0 {cx!r}; 0 {focal!r} {cy!r}; 0 0 1]\n"
        f"cam1=[{focal!r} 0 {cx + doffs!r}; 0 {focal!r} {cy!r}; 0 0 1]\n"
        f"doffs={doffs!r}\n"
        f"baseline={1000 * calibration.baseline!r}\n"
        f"width={width}\n"
        f"height={height}\n"
    )
    write_atomically(path, lambda temporary: temporary.write_text(text))
