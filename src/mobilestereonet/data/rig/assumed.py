"""Geometry of a pair from little: the field of view, or one known distance."""

from __future__ import annotations

import math
from dataclasses import dataclass

from mobilestereonet.data.rig.cameras import Size
from mobilestereonet.data.rig.rig import Rig
from mobilestereonet.data.sample import Calibration
from mobilestereonet.errors import InputError

MAX_FIELD_OF_VIEW_DEG = 170.0
"""Widest view of a rectified picture; wider ones are of fisheye lenses."""

_ASSUMED = "square pixels, the principal point in the middle, rectified views"


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
        if not 0 < degrees <= MAX_FIELD_OF_VIEW_DEG:
            raise InputError(
                f"--fov {degrees:g}: a field of view is in degrees, above 0 and up to "
                f"{MAX_FIELD_OF_VIEW_DEG:g}"
            )
        Calibration(focal=1.0, baseline=baseline, doffs=doffs)  # checks them
        return cls((), f"--fov {degrees:g}", (), degrees, baseline, doffs)

    @property
    def assumption(self) -> str:
        """What was assumed, in words."""
        return (
            f"assumed: {_ASSUMED}, {self.field_of_view:g} degrees wide, from cameras "
            f"{self.baseline:g} m apart"
        )

    def geometry(self, size: Size, *, rectified: bool | None = None) -> Calibration:
        """Calibration of pictures of a size."""
        focal = size[0] / 2 / math.tan(math.radians(self.field_of_view) / 2)
        return Calibration(focal, self.baseline, self.doffs, size=size)
