"""Calibrations that a visitor has: numbers, a file, or the model of the camera."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from mobilestereonet.data.rig import AssumedRig, Rig
from mobilestereonet.data.rig.assumed import DEFAULT_FIELD_OF_VIEW_DEG, focal_of_view
from mobilestereonet.data.sample import Calibration
from mobilestereonet.errors import InputError

Size = tuple[int, int]


@dataclass(frozen=True)
class CameraModel:
    """Nominal geometry of a camera's rectified pictures, as its maker gives it.

    Attributes:
        focal: Focal length in px by the pictures' width and height in px.
        baseline: Distance of the cameras in metres.
    """

    focal: Mapping[Size, float]
    baseline: float

    def calibration(self, size: Size) -> Calibration:
        """Calibration of pictures of a width and height.

        A size that the camera does not have is taken for a resized one if those of its shape all
        show one field of view.

        Raises:
            InputError: If they do not, or there is none: such a picture was cut from another one.
        """
        width, height = size
        alike = {
            focal * width / own_width
            for (own_width, own_height), focal in self.focal.items()
            if math.isclose(width / height, own_width / own_height, rel_tol=_SAME_SHAPE)
        }
        focal = self.focal.get(size) or (alike.pop() if len(alike) == 1 else None)
        if focal is None:
            sizes = ", ".join(f"{own_width}x{own_height}" for own_width, own_height in self.focal)
            raise InputError(
                f"the maker's values are for {sizes}, and these pictures have {width}x{height}: "
                "choose a calibration file, or fill in the numbers"
            )
        return Calibration(focal, self.baseline, size=size)


_SAME_SHAPE = 0.01
"""Share by which a shape, width by height, may differ: 848 x 480 is as good as 16:9."""

ASSUMED = AssumedRig.of_field_of_view(DEFAULT_FIELD_OF_VIEW_DEG, 0.065)
"""For views of which nothing is known: the field of view of many telephones and webcams, and the
distance of a person's eyes."""

CAMERAS: Mapping[str, CameraModel] = {
    # Luxonis, "Configuring stereo depth": 882.5 px at 1280 x 800, 7.5 cm. 720 rows are cut.
    "OAK-D": CameraModel({(1280, 800): 882.5, (1280, 720): 882.5}, 0.075),
    # 2.12 mm lens, pixels of 2 um; 1280 and 672 wide ones join two and four of them.
    "ZED 2": CameraModel(
        {(1280, 720): 530, (2208, 1242): 1060, (1920, 1080): 1060, (672, 376): 265}, 0.12
    ),
    # D400 series data sheet: 87 degrees of horizontal view in 16:9 (cut in 4:3), 50 mm.
    "RealSense D435": CameraModel({(1280, 720): focal_of_view(87, 1280)}, 0.05),
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
        if self.guessed:
            return Rig((ASSUMED.geometry(size),), self.source)
        model = CAMERAS.get(self.source)
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
