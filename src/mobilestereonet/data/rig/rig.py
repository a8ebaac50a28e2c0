"""`Rig`: the geometry of a stereo camera, from whatever describes it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

from mobilestereonet.data.rig.camera_info import pair_of_infos
from mobilestereonet.data.rig.cameras import CameraPair, Size, same_shape, wrong_size
from mobilestereonet.data.rig.rectified import check_views
from mobilestereonet.data.rig.told import Told
from mobilestereonet.data.sample import Calibration
from mobilestereonet.errors import InputError

Geometry: TypeAlias = CameraPair | Calibration
"""Of raw pictures, or of rectified ones."""


@dataclass(frozen=True, eq=False)
class Rig:
    """Geometry of a stereo camera, for all kinds and sizes of pictures that its description tells.

    Attributes:
        geometries: Of raw pictures (`CameraPair`) and of rectified ones (`Calibration`), in order
            of precedence.
        name: What messages call it: its file.
        notes: What was assumed, in words for the user.
    """

    geometries: tuple[Geometry, ...]
    name: str = "rig"
    notes: tuple[str, ...] = ()

    @classmethod
    def from_camera_info(
        cls,
        left: Mapping[str, Any],
        right: Mapping[str, Any],
        *,
        unit: str | None = None,
        baseline: float | None = None,
        name: str = "camera_info",
    ) -> Rig:
        """Make a rig of the two camera_info messages of a ROS stereo camera.

        Args:
            left: The left camera's message as names and values: ``width``, ``height``,
                ``distortion_model``, ``D``, ``K``, ``R``, ``P`` (or in lower case), ``binning_x``,
                ``binning_y`` and ``roi``, itself names and values.
            right: The right camera's.
            unit: Unit of the baseline in ``P``: "m", "cm" or "mm"; metres if left out.
            baseline: Distance between the cameras in metres, if the messages have none.
            name: What messages call the rig.

        Returns:
            The rig, of raw pictures (``image_raw``) and of rectified ones (``image_rect``).

        Raises:
            InputError: If a value is missing or impossible, or the cameras are swapped.
        """
        told = Told(unit=unit, baseline=baseline)
        try:
            return cls(pair_of_infos(dict(left), dict(right), told), name)
        except InputError as error:
            raise InputError(f"{name}: {error}") from None

    def geometry(self, size: Size, *, rectified: bool | None = None) -> Geometry:
        """The geometry of pictures of a size.

        Args:
            size: Width and height of the pictures in px.
            rectified: Whether the pictures are rectified; None if nobody says, and those of a
                camera that tells both are taken for raw.

        Raises:
            InputError: If the rig is of pictures of other sizes, or of raw ones alone, or of
                rectified ones alone.
        """
        kind = {True: Calibration, False: CameraPair, None: CameraPair | Calibration}[rectified]
        fitting = [geometry for geometry in self.geometries if isinstance(geometry, kind)]
        if not fitting:
            what, other = ("rectified", "raw") if rectified else ("raw", "rectified")
            raise InputError(f"{self.name}: tells about {other} pictures alone, not {what} ones")
        for geometry in fitting:
            if geometry.size in (None, size):
                return self._checked(geometry, size)
        sizes = sorted({geometry.size for geometry in fitting if geometry.size})
        if len(sizes) == 1:
            raise InputError(f"{self.name}: {wrong_size(sizes[0], size, 'it is of pictures of')}")
        known = ", ".join(f"{width}x{height}" for width, height in sizes)
        raise InputError(
            f"{self.name}: it is of pictures of {known}, these have {size[0]}x{size[1]} (width x "
            "height): give the calibration of these"
        )

    def _checked(self, geometry: Geometry, size: Size) -> Geometry:
        try:
            if isinstance(geometry, CameraPair):
                geometry.check_size(size)
            else:
                check_views(geometry, size)
        except InputError as error:
            raise InputError(f"{self.name}: {error}") from None
        return geometry

    def resized(self, size: Size) -> Rig:
        """The rig of pictures that were resized to a width and a height.

        Raises:
            InputError: If no geometry's own size has this shape, or it tells none.
        """
        fitting = [g for g in self.geometries if g.size is not None and same_shape(g.size, size)]
        if not fitting:
            own = ", ".join("{}x{}".format(*g.size) for g in self.geometries if g.size)
            raise InputError(
                f"{self.name}: pictures of {size[0]}x{size[1]} cannot be resized ones of "
                f"{own or 'a rig that tells no size'}"
            )
        return replace(self, geometries=tuple(geometry.resized(size) for geometry in fitting))
