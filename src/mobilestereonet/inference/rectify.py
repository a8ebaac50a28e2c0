"""Rectification: undistorted, rotated views of two calibrated cameras, whose rows match."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from mobilestereonet.data.images import to_picture
from mobilestereonet.data.rig import Camera, CameraPair, Rig
from mobilestereonet.data.rig.cameras import Matrix, Rectification, Size
from mobilestereonet.data.rig.rectified import from_cameras
from mobilestereonet.data.sample import Calibration, StereoSample
from mobilestereonet.errors import InputError
from mobilestereonet.inference.fisheye import fisheye_rectification
from mobilestereonet.inference.pair import StereoPair

Image = NDArray[Any]


class _Maps(NamedTuple):
    """Where the pixels of the rectified views come from, and their calibration."""

    left: tuple[Image, Image]
    right: tuple[Image, Image]
    calibration: Calibration


class Rectifier:
    """Rectifies the raw pairs of a rig; its maps are computed once per size.

    Pairs of which the rig says that they are rectified pass as they are.

    Attributes:
        rig: The rig.
        whole: Whether all pixels of the views are kept, with black beyond their borders.
        resized: Whether the views may be resized ones of the rig's pictures.
    """

    def __init__(self, rig: Rig, *, whole: bool = False, resized: bool = False) -> None:
        """Make a rectifier.

        Args:
            rig: The rig.
            whole: True keeps all pixels of the views, with black beyond their borders; False crops
                to where both are known, or takes the rectification that the rig's file tells.
            resized: True takes views of another size for resized ones; False refuses them.
        """
        self.rig = rig
        self.whole = whole
        self.resized = resized
        self._maps: dict[Size, _Maps | Calibration] = {}

    @property
    def rectifies(self) -> bool:
        """Whether the rig tells about raw pictures."""
        return any(isinstance(geometry, CameraPair) for geometry in self.rig.geometries)

    def __call__(self, left: Image, right: Image) -> tuple[Image, Image, Calibration]:
        """Rectify a pair: undistort and rotate both views so that matching points share a row.

        Args:
            left: Left view, (H, W) or (H, W, C), uint8, uint16 or float32.
            right: Right view, the same size.

        Returns:
            Rectified left and right view, in the dtype of the views, and the calibration of the
            rectified pair.

        Raises:
            InputError: If the sizes differ from each other or from the rig's.
        """
        if left.shape != right.shape:
            raise InputError(
                f"the two views must have one shape, got {left.shape} and {right.shape}"
            )
        maps = self._maps_of((left.shape[1], left.shape[0]))
        if isinstance(maps, Calibration):
            return left, right, maps
        left, right = (
            np.asarray(cv2.remap(view, *where, interpolation=cv2.INTER_LINEAR))
            for view, where in ((left, maps.left), (right, maps.right))
        )
        return left, right, maps.calibration

    def pair(self, pair: StereoPair) -> StereoPair:
        """Rectify a pair that `load_pair` has read; the result has its calibration.

        Raises:
            InputError: If the rig is of pictures of other sizes.
        """
        maps = self._maps_of((pair.width, pair.height))
        if isinstance(maps, Calibration):
            return replace(pair, calibration=maps)
        left, right = _remapped(pair.left, maps.left), _remapped(pair.right, maps.right)
        return replace(
            pair,
            left=left,
            right=right,
            left_image=to_picture(left),
            right_image=to_picture(right),
            calibration=maps.calibration,
        )

    def sample(self, sample: StereoSample) -> StereoSample:
        """Rectify the views of a sample, whose ground truth is that of the rectified left view.

        Raises:
            InputError: If the rig is of pictures of other sizes, the sample tells that its views
                are rectified, or the ground truth has another size than the rectified views.
        """
        maps = self._maps_of((sample.left.shape[-1], sample.left.shape[-2]))
        if isinstance(maps, Calibration):
            return replace(sample, calibration=maps)
        if sample.calibration is not None:
            raise InputError(
                f"{sample.name}: its views are rectified already, as its data set tells, and the "
                "rig is of raw ones: leave --rig out"
            )
        left, right = _remapped(sample.left, maps.left), _remapped(sample.right, maps.right)
        if sample.disparity is not None and sample.disparity.shape != left.shape[-2:]:
            sizes = [f"{view.shape[-1]}x{view.shape[-2]}" for view in (sample.disparity, left)]
            raise InputError(
                f"{sample.name}: the ground truth has {sizes[0]}, the rectified views {sizes[1]}: "
                "it must be that of the rectified left view"
            )
        return replace(sample, left=left, right=right, calibration=maps.calibration)

    def calibration(self, size: Size) -> Calibration:
        """Calibration of the rectified views of pictures of a width and height.

        Raises:
            InputError: If the rig is of other sizes.
        """
        maps = self._maps_of(size)
        return maps if isinstance(maps, Calibration) else maps.calibration

    def _maps_of(self, size: Size) -> _Maps | Calibration:
        if size not in self._maps:
            rig = self.rig.resized(size) if self.resized else self.rig
            geometry = rig.geometry(size)
            if isinstance(geometry, CameraPair):
                self._maps[size] = _maps(geometry, size, self.whole)
            else:
                self._maps[size] = replace(geometry, size=size)
        return self._maps[size]


def _maps(pair: CameraPair, size: Size, whole: bool) -> _Maps:
    rectification = pair.rectification
    if rectification is None or whole:
        rectification = rectify(pair, size, whole=whole)
    out = rectification.size or size
    left, right = rectification.projections
    baseline = float(np.linalg.norm(pair.translation))
    calibration = from_cameras(left, right, baseline, size=out)
    maps = [
        _distortion_maps(camera, rotation, projection, out)
        for camera, rotation, projection in zip(
            (pair.left, pair.right),
            rectification.rotations,
            rectification.projections,
            strict=True,
        )
    ]
    return _Maps(maps[0], maps[1], calibration)


def rectify(pair: CameraPair, size: Size, *, whole: bool = False) -> Rectification:
    """Compute how two cameras are rectified (Bouguet's algorithm, `cv2.stereoRectify`).

    Args:
        pair: The cameras.
        size: Width and height of their pictures, in px, and of the rectified ones.
        whole: True keeps all pixels of the pictures; False crops to where both are known.

    Raises:
        InputError: If the cameras cannot be rectified.
    """
    no_distortion = np.zeros(5)
    r1, r2, p1, p2, *_ = cv2.stereoRectify(
        pair.left.matrix,
        no_distortion if pair.left.fisheye else pair.left.distortion,
        pair.right.matrix,
        no_distortion if pair.right.fisheye else pair.right.distortion,
        size,
        pair.rotation,
        pair.translation[:, None],
        flags=cv2.CALIB_ZERO_DISPARITY,
        alpha=1 if whole else 0,
    )
    rotations = np.asarray(r1, np.float64), np.asarray(r2, np.float64)
    if pair.left.fisheye:  # the rotations do not depend on the lens
        return fisheye_rectification(pair, size, rotations, whole=whole)
    projections = np.asarray(p1, np.float64), np.asarray(p2, np.float64)
    if not (np.isfinite(projections).all() and projections[1][0, 3] < 0):
        raise InputError(
            "these two cameras cannot be rectified: do they look in different directions, or are "
            "distortion coefficients of another model?"
        )
    return Rectification(rotations, projections)


def _distortion_maps(
    camera: Camera, rotation: Matrix, projection: Matrix, size: Size
) -> tuple[Image, Image]:
    module = cv2.fisheye if camera.fisheye else cv2
    x, y = module.initUndistortRectifyMap(
        camera.matrix, camera.distortion, rotation, projection[:, :3], size, cv2.CV_32FC1
    )
    return np.asarray(x), np.asarray(y)


def _remapped(view: Tensor, where: tuple[Image, Image]) -> Tensor:
    """A view (3, H, W) whose pixels come from other places."""
    rows = np.asarray(cv2.remap(_rows(view), *where, interpolation=cv2.INTER_LINEAR))
    return torch.from_numpy(rows).permute(2, 0, 1).contiguous().to(view.device)


def _rows(view: Tensor) -> Image:
    """A view (3, H, W) as (H, W, 3)."""
    return np.ascontiguousarray(view.permute(1, 2, 0).cpu().numpy())
