"""`Rig`: the geometry of a stereo camera, from whatever describes it."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from mobilestereonet.data.rig.camera_info import pair_of_infos
from mobilestereonet.data.rig.cameras import CameraPair, Size
from mobilestereonet.data.rig.description import Geometry
from mobilestereonet.data.rig.doubts import doubts
from mobilestereonet.data.rig.formats import describe
from mobilestereonet.data.rig.rectified import check_views
from mobilestereonet.data.rig.told import Told
from mobilestereonet.data.sample import Calibration
from mobilestereonet.data.sizes import same_shape, wrong_size
from mobilestereonet.errors import InputError


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
    def read(
        cls,
        source: str | Path | Sequence[str | Path],
        *,
        unit: str | None = None,
        baseline: float | None = None,
        cameras: tuple[int, int] | None = None,
        fisheye: bool | None = None,
        rectified: bool | None = None,
    ) -> Rig:
        """Read whatever describes a stereo camera; its content tells what it is.

        - OpenCV: what `cv2.stereoCalibrate` or `cv2.stereoRectify` gives, as FileStorage (YAML,
          XML, JSON), plain YAML, JSON or ``.npz``, under the usual names;
        - ROS: the camera_info of both cameras, or of the right one; Kalibr's camchain; EuRoC's
          sensor.yaml of both cameras;
        - ZED's ``SN....conf``, the EEPROM of an OAK as JSON, RealSense's calibration table or
          intrinsics as JSON;
        - calibration files of Middlebury, ETH3D, KITTI, KITTI-360 and DrivingStereo.

        Args:
            source: The file, or the files of the left and the right camera, or of intrinsics and
                extrinsics.
            unit: Unit of the file's lengths, "m", "cm" or "mm"; by default that of its format, for
                OpenCV's metres.
            baseline: Distance between the cameras in metres, where the file has none or an
                implausible one.
            cameras: Numbers of the left and the right camera, where there are more than two: 0 and
                1 are KITTI's grey ones.
            fisheye: What four distortion coefficients are, where the file does not tell: of a
                fisheye lens (k1 k2 k3 k4), or of a pinhole one (k1 k2 p1 p2).
            rectified: Whether the pictures are rectified; None leaves it to the file.

        Returns:
            The rig.

        Raises:
            FileNotFoundError: If there is no such file.
            InputError: If a file is of no such format, lacks a value or has an impossible one.
        """
        paths = [Path(source)] if isinstance(source, str | Path) else [Path(p) for p in source]
        told = Told(unit, baseline, cameras, fisheye, rectified)
        found = describe(paths, told)
        name = ", ".join(map(str, paths))
        kinds = tuple(g for g in found.geometries if _is_kind(g, rectified))
        if not kinds:
            raise cls(found.geometries, name)._other_kind(rectified)
        return cls(kinds, name, (*found.notes, *_doubts(kinds)))

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
        """The geometry of pictures of a size; what is unusual in it becomes a warning.

        Args:
            size: Width and height of the pictures in px.
            rectified: Whether the pictures are rectified; None if nobody says, and those of a
                camera that tells both are taken for raw.

        Raises:
            InputError: If the rig is of pictures of other sizes, or of raw ones alone, or of
                rectified ones alone.
        """
        fitting = [geometry for geometry in self.geometries if _is_kind(geometry, rectified)]
        if not fitting:
            raise self._other_kind(rectified)
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

    @property
    def calibration(self) -> Calibration:
        """Calibration of rectified pictures.

        Raises:
            InputError: If the rig is of raw pictures alone, or of rectified ones of several sizes.
        """
        fitting = [g for g in self.geometries if isinstance(g, Calibration)]
        if not fitting:
            raise self._other_kind(True)
        if len(fitting) > 1:
            sizes = ", ".join("{}x{}".format(*g.size) for g in fitting if g.size)
            raise InputError(f"{self.name}: is of pictures of {sizes}: ask geometry() for one size")
        return fitting[0]

    def _other_kind(self, rectified: bool | None) -> InputError:
        if not rectified:
            return InputError(f"{self.name}: tells about rectified pictures alone, not raw ones")
        return InputError(
            f"{self.name}: tells about raw pictures alone, not rectified ones: give such pictures "
            "and this file to `msnet rectify`, or to `msnet predict --rig`"
        )

    def _checked(self, geometry: Geometry, size: Size) -> Geometry:
        try:
            if isinstance(geometry, CameraPair):
                geometry.check_size(size)
            else:
                check_views(geometry, size)
            unusual = list(doubts(geometry, size))
        except InputError as error:
            raise InputError(f"{self.name}: {error}") from None
        for doubt in unusual:
            warnings.warn(f"{self.name}: {doubt}", stacklevel=4)
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


def _is_kind(geometry: Geometry, rectified: bool | None) -> bool:
    return rectified is None or isinstance(geometry, Calibration) == rectified


def _doubts(geometries: Sequence[Geometry]) -> tuple[str, ...]:
    """What is said where a file tells about raw and rectified pictures of one size."""
    raw = {geometry.size for geometry in geometries if isinstance(geometry, CameraPair)}
    rectified = {geometry.size for geometry in geometries if isinstance(geometry, Calibration)}
    if not raw or not rectified or (None not in raw | rectified and raw.isdisjoint(rectified)):
        return ()
    first = "raw" if isinstance(geometries[0], CameraPair) else "rectified"
    other = "--rectified says that they are" if first == "raw" else "--raw says that they are not"
    return (f"the pictures are taken for {first} ones; {other}",)
