"""OpenCV's semi-global block matching, the classical baseline, as an inference engine."""

from __future__ import annotations

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from mobilestereonet.data.images import to_picture
from mobilestereonet.errors import InputError, check_multiple
from mobilestereonet.nets.model import RGB, Prediction

_BLOCK_PX = 5


class StereoSGBM:
    """Semi-global matching (Hirschmueller, 2008) as OpenCV has it, made dense.

    Both views are padded on the left by the disparity range, so that the left border gets a
    match, too. Pixels without one are filled along the row with the smaller neighbour, which is
    the one farther away.

    Args:
        max_disparity: Disparities searched, in pixels, a multiple of 16.

    Raises:
        InputError: If it is not.
    """

    name = "sgbm"
    precision = "int16"
    device = torch.device("cpu")
    threads = None
    preprocessing = RGB
    size_multiple = 1
    min_side = 1
    has_confidence = False

    def __init__(self, max_disparity: int = 192) -> None:
        check_multiple("sgbm: max_disparity", max_disparity, 16)
        self.max_disparity = max_disparity

    def __call__(self, left: Tensor, right: Tensor, confidence: bool = False) -> Prediction:
        """Match a batch of pairs, RGB in 0..1, see `Engine`; there is no confidence."""
        if left.shape != right.shape or left.ndim != 4 or left.shape[1] != 3:
            raise InputError(
                "sgbm takes two views of shape (B, 3, H, W), got "
                f"{tuple(left.shape)} and {tuple(right.shape)}"
            )
        maps = [self._match(to_picture(a), to_picture(b)) for a, b in zip(left, right, strict=True)]
        return Prediction(torch.from_numpy(np.stack(maps)))

    def _match(self, left: NDArray[np.uint8], right: NDArray[np.uint8]) -> NDArray[np.float32]:
        padded = [
            cv2.copyMakeBorder(view, 0, 0, self.max_disparity, 0, cv2.BORDER_REPLICATE)
            for view in (left, right)
        ]
        fixed = self._matcher().compute(*padded)[:, self.max_disparity :]
        # OpenCV gives sixteenths of a pixel, and negative values where it found no match.
        return _fill_rows((fixed / 16).astype(np.float32))

    def _matcher(self) -> cv2.StereoSGBM:
        # Made anew for each pair: OpenCV's object keeps buffers and is not safe to share.
        return cv2.StereoSGBM.create(
            minDisparity=0,
            numDisparities=self.max_disparity,
            blockSize=_BLOCK_PX,
            P1=8 * 3 * _BLOCK_PX**2,
            P2=32 * 3 * _BLOCK_PX**2,
            disp12MaxDiff=1,
            preFilterCap=63,
            uniquenessRatio=10,
            speckleWindowSize=100,
            speckleRange=2,
            mode=cv2.StereoSGBM_MODE_SGBM_3WAY,
        )


def _fill_rows(disparity: NDArray[np.float32]) -> NDArray[np.float32]:
    """Fill negative values along the row with the smaller of the two nearest known values.

    A row without any known value becomes 0.
    """
    known = disparity >= 0
    columns = np.arange(disparity.shape[1])
    before = np.maximum.accumulate(np.where(known, columns, -1), axis=1)
    after = np.where(known, columns, disparity.shape[1])[:, ::-1]
    after = np.minimum.accumulate(after, axis=1)[:, ::-1]
    # A column of inf at the end stands for "none"; index -1 reaches it as well.
    bordered = np.pad(np.where(known, disparity, np.inf), ((0, 0), (0, 1)), constant_values=np.inf)
    nearest = np.minimum(
        np.take_along_axis(bordered, before, axis=1), np.take_along_axis(bordered, after, axis=1)
    )
    return np.where(np.isinf(nearest), 0, nearest).astype(np.float32)
