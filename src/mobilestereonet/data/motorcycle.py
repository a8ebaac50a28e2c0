"""Middlebury's Motorcycle, the real pair that scikit-image's wheel contains."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from mobilestereonet.data.images import cover_and_crop, image_to_tensor
from mobilestereonet.data.sample import Calibration, StereoSample
from mobilestereonet.errors import needs_extra

CALIBRATION = Calibration(
    focal=994.978, baseline=0.193001, doffs=31.086, cx=311.193, cy=254.877, size=(741, 500)
)
"""The pair's geometry at its size, as scikit-image's documentation gives it."""


def motorcycle() -> StereoSample:
    """Middlebury 2014's Motorcycle, 500 x 741, with ground truth and calibration.

    It is in scikit-image's own wheel.

    Raises:
        InputError: If scikit-image (the extra demo) is not installed.
    """
    with needs_extra("demo"):
        from skimage.data import stereo_motorcycle
    left, right, truth = stereo_motorcycle()  # type: ignore[no-untyped-call]
    valid = np.isfinite(truth)
    return StereoSample(
        left=image_to_tensor(left),
        right=image_to_tensor(right),
        disparity=torch.from_numpy(np.where(valid, truth, 0).astype(np.float32)),
        valid=torch.from_numpy(valid),
        calibration=CALIBRATION,
        name="motorcycle",
    )


def motorcycle_views(size: tuple[int, int]) -> tuple[Tensor, Tensor]:
    """Views of the Motorcycle at any size, for timing and for comparing engines.

    Args:
        size: Height and width. The views are scaled until they cover it, then cropped.

    Returns:
        Left and right view, (1, 3, height, width) each, RGB in 0..1.
    """
    sample = motorcycle()
    return cover_and_crop(sample.left, size), cover_and_crop(sample.right, size)
