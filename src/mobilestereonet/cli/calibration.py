"""A stereo camera's geometry as options of a command."""

from __future__ import annotations

import sys
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from mobilestereonet.cli.early import UNITS, existing_file, one_of
from mobilestereonet.errors import InputError
from mobilestereonet.settings import parse_known_distance

if TYPE_CHECKING:
    from mobilestereonet.data.sample import Calibration
    from mobilestereonet.inference import StereoResult
    from mobilestereonet.inference.rectify import Rectifier


WAYS_TO_METRES = (
    "--rig FILE; or --focal PX (or --fov DEGREES) and --baseline METRES; or, with predict, "
    "--known COLUMN,ROW=METRES"
)
"""What gives a command its scale, for messages."""


@dataclass(frozen=True)
class RigFiles:
    """Options that name the files of a rig, and say what they do not tell."""

    rig: Annotated[
        list[Path] | None,
        typer.Option(
            "--rig",
            "--calib",
            help="Calibration of the cameras, of any kind: OpenCV, ROS camera_info, Kalibr, EuRoC, "
            "ZED, OAK, RealSense, KITTI, Middlebury ... Repeat if it is in two files, the left "
            "camera's first. Raw pictures are rectified.",
            callback=existing_file,
        ),
    ] = None
    numbers: Annotated[
        tuple[int, int] | None,
        typer.Option(
            "--cameras",
            help="Numbers of the left and the right camera in a file of several: 0 1 are KITTI's "
            "grey ones.",
        ),
    ] = None
    unit: Annotated[
        str | None,
        typer.Option(
            help="Unit of the lengths in the file: m, cm or mm. Default: that of its format.",
            callback=one_of(UNITS),
        ),
    ] = None
    fisheye: Annotated[
        bool | None,
        typer.Option(
            "--fisheye/--pinhole",
            help="What four distortion coefficients are, if the file does not tell.",
            show_default=False,
        ),
    ] = None
    rectified: Annotated[
        bool | None,
        typer.Option(
            "--rectified/--raw",
            help="What the pictures are, if the file tells about both.",
            show_default=False,
        ),
    ] = None
    resized: Annotated[
        bool,
        typer.Option("--resized", help="The pictures were resized after the calibration."),
    ] = False
    baseline: Annotated[
        float | None,
        typer.Option(
            metavar="<m>",
            help="Distance between the cameras in metres, with --focal, or where a file has none "
            "or an unusual one.",
        ),
    ] = None

    def read(self, *, whole: bool = False) -> Rectifier | None:
        """Read the files; None if there are none. What had to be assumed is told.

        Args:
            whole: Rectified pictures keep all pixels, with black beyond the borders.

        Raises:
            FileNotFoundError: If there is no such file.
            InputError: If a file or a value is bad.
        """
        given = {"--cameras": self.numbers, "--unit": self.unit, "--fisheye": self.fisheye}
        given |= {"--rectified": self.rectified, "--resized": self.resized or None}
        if not self.rig:
            if without := [name for name, value in given.items() if value is not None]:
                warnings.warn(
                    f"{', '.join(without)}: of a calibration, --rig FILE, and without effect here",
                    stacklevel=2,
                )
            return None
        from mobilestereonet.data.rig import Rig
        from mobilestereonet.inference.rectify import Rectifier

        rig = Rig.read(
            self.rig,
            unit=self.unit,
            baseline=self.baseline,
            cameras=self.numbers,
            fisheye=self.fisheye,
            rectified=self.rectified,
        )
        for note in rig.notes:
            print(f"msnet: {rig.name}: {note}", file=sys.stderr)
        return Rectifier(rig, whole=whole, resized=self.resized)


@dataclass(frozen=True)
class CalibrationOptions(RigFiles):
    """Options that give the geometry of a pair, as files or as numbers.

    Raises:
        InputError: If they contradict each other, or one lacks another.
    """

    focal: Annotated[
        float | None, typer.Option(metavar="<px>", help="Focal length in px, of square pixels.")
    ] = None
    doffs: Annotated[
        float,
        typer.Option(metavar="<px>", help="Principal points' difference, right minus left, in px."),
    ] = 0.0
    fov: Annotated[
        float | None,
        typer.Option(
            metavar="<degrees>", help="Horizontal field of view in degrees, in place of --focal."
        ),
    ] = None
    known: Annotated[
        str | None,
        typer.Option(
            metavar="<x,y=m>",
            help="Depth in metres of what a pixel of the left view shows (column,row=metres), in "
            "place of --baseline.",
        ),
    ] = None

    def __post_init__(self) -> None:
        if self.focal is not None and self.fov is not None:
            raise InputError("--focal and --fov are two ways to say one thing: leave one out")
        if self.rig:
            if self.focal is not None or self.fov is not None or self.doffs or self.known:
                raise InputError(
                    f"{self.rig[0]} has focal length, baseline and doffs: leave the options out, "
                    "--focal, --fov, --doffs and --known"
                )
            return
        if self.known is not None:
            parse_known_distance(self.known)
            if self.baseline is not None:
                raise InputError("--known is in place of --baseline: leave one of them out")
        elif self.given and self.baseline is None:
            focal = "--fov" if self.focal is None else "--focal"
            raise InputError(f"{focal} needs --baseline METRES, too (or --known COLUMN,ROW=METRES)")
        elif self.baseline is not None and not self.given:
            raise InputError("--baseline needs --focal or --fov, too")
        if not self.given and self.doffs:
            raise InputError(f"--doffs: a calibration needs {WAYS_TO_METRES}")

    @property
    def given(self) -> bool:
        """Whether there is a calibration."""
        return bool(self.rig or self.known) or self.focal is not None or self.fov is not None

    def check_size(self, width: int, height: int) -> None:
        """Check, before the work, that a known pixel is one of views of this size.

        Raises:
            InputError: If it is outside.
        """
        if self.known is not None:
            from mobilestereonet.data.rig.assumed import KnownDistance

            KnownDistance.parse(self.known).check_size(width, height)

    def scaled(self, result: StereoResult) -> Calibration | None:
        """The calibration that a known distance gives, which is told; None without one.

        Raises:
            InputError: If the pixel is outside of the view, or has no disparity.
        """
        if self.known is None:
            return None
        from mobilestereonet.data.rig.assumed import KnownDistance

        calibration, assumption = KnownDistance.parse(self.known).calibration(
            result.disparity,
            result.valid,
            focal=self.focal,
            field_of_view=self.fov,
            doffs=self.doffs,
        )
        print(f"msnet: {assumption}", file=sys.stderr)
        return calibration

    def read(self, *, whole: bool = False) -> Rectifier | None:
        """Read the geometry; None if there is none. What had to be assumed is told.

        Raises:
            FileNotFoundError: If there is no such file.
            InputError: If a file or a value is bad.
        """
        files = super().read(whole=whole)
        if self.baseline is None:
            return files
        from mobilestereonet.data.rig.told import MAX_BASELINE_M

        if self.baseline > MAX_BASELINE_M:
            say = f"is it in metres? {self.baseline:g} mm would be {self.baseline / 1000:g}"
            print(f"msnet: a baseline of {self.baseline:g} m: {say}", file=sys.stderr)
        if files is not None:
            return files
        from mobilestereonet.data import Calibration
        from mobilestereonet.data.rig import Rig
        from mobilestereonet.data.rig.assumed import AssumedRig
        from mobilestereonet.inference.rectify import Rectifier

        if self.focal is None:
            assert self.fov is not None
            assumed = AssumedRig.of_field_of_view(self.fov, self.baseline, self.doffs)
            print(f"msnet: {assumed.assumption}", file=sys.stderr)
            return Rectifier(assumed)
        calibration = Calibration(focal=self.focal, baseline=self.baseline, doffs=self.doffs)
        return Rectifier(Rig((calibration,), "the calibration"))
