"""Calibration as options of a command."""

from __future__ import annotations

import sys
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from mobilestereonet.cli.early import UNITS, existing_file, one_of
from mobilestereonet.errors import InputError

if TYPE_CHECKING:
    from mobilestereonet.data.sample import Calibration


@dataclass(frozen=True)
class CalibrationOptions:
    """Options that give the calibration of a rectified pair, as a file or as numbers.

    Raises:
        InputError: If they contradict each other, or one lacks another.
    """

    calib: Annotated[
        Path | None,
        typer.Option(
            help="Calibration of the rectified pair: Middlebury / ETH3D calib.txt, KITTI, ROS "
            "camera_info of the right camera, or OpenCV (YAML, XML, JSON) with P1 and P2 or Q.",
            callback=existing_file,
        ),
    ] = None
    calib_left: Annotated[
        Path | None,
        typer.Option(
            help="ROS camera_info of the left camera, if it differs.", callback=existing_file
        ),
    ] = None
    unit: Annotated[
        str | None,
        typer.Option(
            help="Unit of lengths in an OpenCV calibration: m or mm.", callback=one_of(UNITS)
        ),
    ] = None
    focal: Annotated[float | None, typer.Option(help="Focal length in px, of square pixels.")] = (
        None
    )
    baseline: Annotated[
        float | None, typer.Option(help="Distance between the cameras in metres.")
    ] = None
    doffs: Annotated[
        float, typer.Option(help="Principal points' difference, right minus left, in px.")
    ] = 0.0

    def __post_init__(self) -> None:
        numbers = {"focal": self.focal, "baseline": self.baseline}
        given = [name for name, value in numbers.items() if value is not None]
        if self.calib is not None and (given or self.doffs):
            raise InputError(
                f"{self.calib} has focal length, baseline and doffs: leave the options out"
            )
        if len(given) == 1:
            (missing,) = numbers.keys() - given
            raise InputError(f"--{given[0]} needs --{missing}, too")
        if not self.given and (self.doffs or self.calib_left is not None):
            raise InputError("a calibration needs --calib FILE, or both --focal and --baseline")

    @property
    def given(self) -> bool:
        """Whether there is a calibration."""
        return self.calib is not None or self.focal is not None

    def read(self) -> Calibration | None:
        """Read the calibration; None if there is none.

        Raises:
            InputError: If a file or a value is bad.
        """
        from mobilestereonet.data import Calibration, read_calibration
        from mobilestereonet.data.camera_files import MAX_PLAUSIBLE_BASELINE_M

        if self.unit is not None and self.calib is None:
            warnings.warn(
                "--unit is that of an OpenCV calibration, --calib FILE: it has no effect here",
                stacklevel=2,
            )
        if self.calib is not None:
            return read_calibration(self.calib, left=self.calib_left, unit=self.unit)
        if self.focal is None or self.baseline is None:
            return None
        if self.baseline > MAX_PLAUSIBLE_BASELINE_M:
            say = f"is it in metres? {self.baseline:g} mm would be {self.baseline / 1000:g}"
            print(f"msnet: a baseline of {self.baseline:g} m: {say}", file=sys.stderr)
        return Calibration(focal=self.focal, baseline=self.baseline, doffs=self.doffs)
