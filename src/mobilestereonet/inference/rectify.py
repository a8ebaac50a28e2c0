"""Rectification: undistorted, rotated views of two calibrated cameras, whose rows match."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from mobilestereonet.data.calibration import from_projections
from mobilestereonet.data.camera_files import StereoRig
from mobilestereonet.data.sample import Calibration
from mobilestereonet.errors import InputError

Image = NDArray[Any]


def rectify_pair(
    left: Image, right: Image, rig: StereoRig, *, whole: bool = False
) -> tuple[Image, Image, Calibration]:
    """Rectify a pair: undistort and rotate both views so that matching points share a row.

    Args:
        left: Left view, (H, W) or (H, W, C), uint8, uint16 or float32.
        right: Right view, the same size.
        rig: The calibrated cameras.
        whole: True keeps all pixels of the views, with black beyond their borders; False crops to
            where both are known.

    Returns:
        Rectified left and right view, in the size and the dtype of the views, and the
        calibration of the rectified pair.

    Raises:
        InputError: If the sizes differ from each other or from the calibrated one, if the cameras
            are one above the other, or if the views are swapped.
    """
    height, width = left.shape[:2]
    if left.shape != right.shape:
        raise InputError(f"the two views must have one shape, got {left.shape} and {right.shape}")
    if rig.size not in (None, (width, height)):
        raise InputError(
            f"the cameras were calibrated at {'{}x{}'.format(*rig.size)}, the views have "
            f"{width}x{height} (width x height): calibrate at this size, or scale the views"
        )
    rotations, projections = _rectification(rig, (width, height), whole)
    calibration = from_projections(*projections, unit="m")
    cameras = (
        (left, rig.left, rig.left_distortion),
        (right, rig.right, rig.right_distortion),
    )
    views = []
    for (view, matrix, distortion), rotation, projection in zip(
        cameras, rotations, projections, strict=True
    ):
        maps = cv2.initUndistortRectifyMap(
            matrix, distortion, rotation, projection, (width, height), cv2.CV_32FC1
        )
        views.append(np.asarray(cv2.remap(view, *maps, interpolation=cv2.INTER_LINEAR)))
    return views[0], views[1], replace(calibration, size=(width, height))


def _rectification(
    rig: StereoRig, size: tuple[int, int], whole: bool
) -> tuple[tuple[Image, Image], tuple[Image, Image]]:
    """Rotations and projection matrices of the rectified views."""
    r1, r2, p1, p2, *_ = cv2.stereoRectify(
        rig.left,
        rig.left_distortion,
        rig.right,
        rig.right_distortion,
        size,
        rig.rotation,
        rig.translation[:, None],
        flags=cv2.CALIB_ZERO_DISPARITY,
        alpha=1 if whole else 0,
    )
    return (r1, r2), (p1, p2)
