"""Calibration of a rectified pair: read from any rig's files, written as calib.txt."""

from __future__ import annotations

from pathlib import Path

from mobilestereonet.atomic import write_atomically
from mobilestereonet.data.rig import Rig
from mobilestereonet.data.sample import Calibration


def read_calibration(
    path: str | Path,
    cameras: tuple[int, int] | None = None,
    *,
    left: str | Path | None = None,
    unit: str | None = None,
) -> Calibration:
    """Read the calibration of a rectified pair, in any of the formats of `Rig.read`.

    Args:
        path: The calibration file.
        cameras: Numbers of the left and the right camera, where a file has more than two: 2 and 3
            are KITTI's colour cameras, 0 and 1 the grey ones.
        left: The left camera's file, where ``path`` is the right one's: ROS's camera_info.
        unit: Unit of the file's lengths, "m", "cm" or "mm"; by default that of its format.

    Returns:
        The calibration, with the baseline in metres.

    Raises:
        FileNotFoundError: If there is no such file.
        InputError: If the file is of no such format, lacks a value, has an impossible one, or
            its cameras are not those of a rectified pair.
    """
    files = path if left is None else (left, path)
    return Rig.read(files, cameras=cameras, unit=unit, rectified=True).calibration


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
