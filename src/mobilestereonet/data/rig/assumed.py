"""Geometry of a pair from little: the field of view, or one known distance."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mobilestereonet.data.images import FloatMap, Mask
from mobilestereonet.data.rig.cameras import Size
from mobilestereonet.data.rig.rig import Rig
from mobilestereonet.data.sample import Calibration
from mobilestereonet.errors import InputError
from mobilestereonet.settings import parse_known_distance

MAX_FIELD_OF_VIEW_DEG = 170.0
"""Widest view of a rectified picture; wider ones are of fisheye lenses."""

DEFAULT_FIELD_OF_VIEW_DEG = 60.0
"""Horizontal view that is assumed where only a distance is known: that of many cameras."""

_KNOWN_RADIUS_PX = 2
"""How far from the known pixel disparities count."""

_ASSUMED = "square pixels, the principal point in the middle, rectified views"


def _assumed(doffs: float) -> str:
    """What is assumed of cameras that nobody has calibrated."""
    return _ASSUMED if doffs else f"{_ASSUMED}, doffs 0 (cameras that do not converge)"


@dataclass(frozen=True, eq=False)
class AssumedRig(Rig):
    """Geometry of rectified pictures of any size with one field of view.

    Attributes:
        field_of_view: Horizontal, in degrees.
        baseline: Distance between the cameras, in metres.
        doffs: Difference of the principal points, right minus left, in pixels.
    """

    field_of_view: float = 60.0
    baseline: float = 1.0
    doffs: float = 0.0

    @classmethod
    def of_field_of_view(cls, degrees: float, baseline: float, doffs: float = 0.0) -> AssumedRig:
        """Make a rig of a horizontal field of view.

        Raises:
            InputError: If a value is impossible.
        """
        Calibration(focal_of_view(degrees, 1), baseline, doffs)  # checks them
        return cls((), f"--fov {degrees:g}", (), degrees, baseline, doffs)

    @property
    def assumption(self) -> str:
        """What was assumed, in words."""
        return (
            f"assumed: {_assumed(self.doffs)}, {self.field_of_view:g} degrees wide, from cameras "
            f"{self.baseline:g} m apart"
        )

    def geometry(self, size: Size, *, rectified: bool | None = None) -> Calibration:
        """Calibration of pictures of a size."""
        focal = focal_of_view(self.field_of_view, size[0])
        return Calibration(focal, self.baseline, self.doffs, size=size)


def focal_of_view(degrees: float, width: int) -> float:
    """Focal length in px of a picture that is so many degrees wide.

    Raises:
        InputError: If the angle is impossible.
    """
    if not 0 < degrees <= MAX_FIELD_OF_VIEW_DEG:
        raise InputError(
            f"--fov {degrees:g}: a field of view is in degrees, above 0 and up to "
            f"{MAX_FIELD_OF_VIEW_DEG:g}"
        )
    return width / 2 / math.tan(math.radians(degrees) / 2)


@dataclass(frozen=True)
class KnownDistance:
    """The distance of what one pixel of the left view shows, which gives depth its scale.

    Attributes:
        column: Column of the pixel.
        row: Row of the pixel.
        metres: Its depth along the optical axis.
    """

    column: int
    row: int
    metres: float

    @classmethod
    def parse(cls, text: str) -> KnownDistance:
        """Read ``COLUMN,ROW=METRES``.

        Raises:
            InputError: If it is none.
        """
        return cls(*parse_known_distance(text))

    def check_size(self, width: int, height: int) -> None:
        """Check that the pixel is one of views of this size.

        Raises:
            InputError: If it is outside.
        """
        if not (self.column < width and self.row < height):
            raise InputError(
                f"--known: column {self.column}, row {self.row} is outside of the view of "
                f"{width}x{height}"
            )

    def calibration(
        self,
        disparity: FloatMap,
        valid: Mask,
        *,
        focal: float | None = None,
        field_of_view: float | None = None,
        doffs: float = 0.0,
    ) -> tuple[Calibration, str]:
        """Calibration in which the pixel has its distance, and what was assumed.

        Args:
            disparity: Disparity of the left view, (H, W), in px.
            valid: Where it is known, (H, W).
            focal: Focal length in px, if it is known; depth does not depend on it, points do.
            field_of_view: Horizontal field of view in degrees, if it is known.
            doffs: Difference of the principal points, right minus left, in pixels.

        Raises:
            InputError: If the pixel is outside, or has no disparity.
        """
        height, width = disparity.shape
        self.check_size(width, height)
        rows, columns = (
            slice(max(place - _KNOWN_RADIUS_PX, 0), place + _KNOWN_RADIUS_PX + 1)
            for place in (self.row, self.column)
        )
        near = disparity[rows, columns][valid[rows, columns]]
        shifted = float(np.median(near)) + doffs if near.size else 0.0
        if not shifted > 0:
            raise InputError(
                f"--known: nothing is matched at column {self.column}, row {self.row}: choose a "
                "pixel with texture"
            )
        told = field_of_view or DEFAULT_FIELD_OF_VIEW_DEG
        focal_px = focal_of_view(told, width) if focal is None else focal
        calibration = Calibration(focal_px, self.metres * shifted / focal_px, doffs)
        wide = f", {told:g} degrees wide" if focal is None and field_of_view is None else ""
        return calibration, (
            f"assumed: {_assumed(doffs)}{wide}; {self.metres:g} m at a disparity of "
            f"{shifted - doffs:.2f} px is --focal {focal_px:.6g} --baseline "
            f"{calibration.baseline:.6g}"
        )
