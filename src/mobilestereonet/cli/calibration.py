"""Calibration as options of a command."""

from __future__ import annotations

import sys
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeAlias

import typer

if TYPE_CHECKING:
    from mobilestereonet.data.sample import Calibration

Calib: TypeAlias = Annotated[
    Path | None,
    typer.Option(
        help="Calibration of the rectified pair: Middlebury / ETH3D calib.txt, KITTI, ROS "
        "camera_info of the right camera, or OpenCV (YAML, XML, JSON) with P1 and P2 or Q."
    ),
]
CalibLeft: TypeAlias = Annotated[
    Path | None, typer.Option(help="ROS camera_info of the left camera, if it differs.")
]
Unit: TypeAlias = Annotated[
    str | None, typer.Option(help="Unit of lengths in an OpenCV calibration: m or mm.")
]
Focal: TypeAlias = Annotated[
    float | None, typer.Option(help="Focal length in px, of square pixels.")
]
Baseline: TypeAlias = Annotated[
    float | None, typer.Option(help="Distance between the cameras in metres.")
]
Doffs: TypeAlias = Annotated[
    float, typer.Option(help="Principal points' difference, right minus left, in px.")
]


def calibration_from(
    calib: Path | None,
    calib_left: Path | None,
    unit: str | None,
    focal: float | None,
    baseline: float | None,
    doffs: float,
) -> Calibration | None:
    """Read the calibration that the options give; None if they give none.

    Raises:
        FileNotFoundError: If a file does not exist.
        InputError: If a file or a value is bad, or the options contradict each other.
    """
    from mobilestereonet.data import Calibration, read_calibration
    from mobilestereonet.data.camera_files import MAX_PLAUSIBLE_BASELINE_M
    from mobilestereonet.errors import InputError

    if unit is not None and calib is None:
        warnings.warn(
            "--unit is that of an OpenCV calibration, --calib FILE: it has no effect here",
            stacklevel=2,
        )
    numbers = [value is not None for value in (focal, baseline)]
    if calib is not None:
        if any(numbers) or doffs:
            raise InputError(f"{calib} has focal length, baseline and doffs: leave the options out")
        return read_calibration(calib, left=calib_left, unit=unit)
    if focal is not None and baseline is not None:
        if baseline > MAX_PLAUSIBLE_BASELINE_M:
            say = f"is it in metres? {baseline:g} mm would be {baseline / 1000:g}"
            print(f"msnet: a baseline of {baseline:g} m: {say}", file=sys.stderr)
        return Calibration(focal=focal, baseline=baseline, doffs=doffs)
    if any(numbers):
        given, other = ("focal", "baseline") if focal is not None else ("baseline", "focal")
        raise InputError(f"--{given} needs --{other}, too")
    if doffs or calib_left is not None:
        raise InputError("a calibration needs --calib FILE, or both --focal and --baseline")
    return None
