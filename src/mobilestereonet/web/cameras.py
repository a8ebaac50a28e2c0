"""Calibrations that a visitor has: numbers, a file, or the model of the camera."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from mobilestereonet.data.rig import Rig
from mobilestereonet.data.sample import Calibration
from mobilestereonet.errors import InputError

Size = tuple[int, int]


@dataclass(frozen=True)
class CameraModel:
    """Nominal geometry of a camera's rectified pictures, as its maker gives it.

    Attributes:
        focal: Focal length in px by the pictures' width in px.
        baseline: Distance of the cameras in metres.
    """

    focal: Mapping[int, float]
    baseline: float

    def calibration(self, size: Size) -> Calibration:
        """Calibration of pictures of a width and height.

        A width that the camera does not have is taken for a resized one of the first.
        """
        width, focal = next(iter(self.focal.items()))
        focal = self.focal.get(size[0], focal * size[0] / width)
        return Calibration(focal, self.baseline, size=size)


def focal_of_view(width: int, degrees: float) -> float:
    """Focal length in px of pictures of a width and a horizontal field of view."""
    return width / 2 / math.tan(math.radians(degrees) / 2)


ASSUMED = CameraModel({1000: focal_of_view(1000, 60)}, 0.065)
"""For views of which nothing is known: the field of view of many telephones and webcams, and the
distance of a person's eyes."""

CAMERAS: Mapping[str, CameraModel] = {
    # Luxonis, "Configuring stereo depth": 882.5 px at 1280 x 800, 7.5 cm.
    "OAK-D": CameraModel({1280: 882.5}, 0.075),
    # 2.12 mm lens, pixels of 2 um; 1280 and 672 wide ones join two and four of them.
    "ZED 2": CameraModel({1280: 530, 2208: 1060, 1920: 1060, 672: 265}, 0.12),
    # D400 series data sheet: 87 degrees of horizontal view, 50 mm.
    "RealSense D435": CameraModel({1280: focal_of_view(1280, 87)}, 0.05),
}
FILE, NUMBERS, UNKNOWN = "Calibration file", "Focal length and baseline", "I don't know"
"""Answers to where the calibration comes from, beside the names of `CAMERAS`."""


@dataclass(frozen=True)
class Geometry:
    """What the visitor says about the cameras and the points; None where a field is empty.

    Attributes:
        source: `FILE`, `NUMBERS`, `UNKNOWN` or one of `CAMERAS`; None asks for no metres.
        file: The calibration file, if there is one.
        focal: Focal length in px, of the pictures as they were uploaded.
        baseline: Distance of the cameras in metres.
        doffs: Difference of the principal points in px.
        max_depth: Farther points are left out, in metres.
        min_confidence: Less confident ones are left out.
    """

    source: str | None = None
    file: Path | None = None
    focal: float | None = None
    baseline: float | None = None
    doffs: float | None = None
    max_depth: float | None = None
    min_confidence: float = 0.0

    @property
    def guessed(self) -> bool:
        """Whether nobody knows the scale."""
        return self.source == UNKNOWN

    def rig(self, size: Size) -> Rig | None:
        """The cameras of pictures of a width and height; None if no metres are asked for.

        Raises:
            InputError: If a number is impossible or missing, or the file is missing or bad.
        """
        if self.source is None:
            return None
        if self.source == FILE:
            return self._from_file()
        if self.source == NUMBERS:
            return Rig((replace(self._from_numbers(), size=size),), "the calibration")
        model = ASSUMED if self.guessed else CAMERAS.get(self.source)
        if model is None:
            raise InputError(f"there is no camera {self.source!r}: choose another one")
        return Rig((model.calibration(size),), self.source)

    def _from_file(self) -> Rig:
        if self.file is None:
            raise InputError("there is no calibration file (any more): choose one")
        name = "the calibration file"
        try:
            return replace(Rig.read(self.file), name=name)
        except (InputError, OSError) as error:
            # Where the server keeps its files is nobody's business.
            raise InputError(str(error).replace(str(self.file), name)) from None

    def _from_numbers(self) -> Calibration:
        # An empty field of the page may come as 0.
        if not self.focal or not self.baseline:
            name = "baseline" if self.focal else "focal length"
            raise InputError(f"the {name} is 0 or missing: fill in both")
        return Calibration(self.focal, self.baseline, self.doffs or 0.0)
