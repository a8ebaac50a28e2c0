"""The left-right check: what both views agree on."""

from __future__ import annotations

import numpy as np

from mobilestereonet.data.images import FloatMap, Mask

AGREEMENT = 1.0
"""Pixels by which the two views' disparities of one point may differ."""


def occluded_pixels(left: FloatMap, right: FloatMap) -> Mask:
    """Where the disparities of both views contradict each other.

    Those are the pixels that the right camera does not see, and wrong matches.

    Args:
        left: Disparity of the left view, (H, W), in px.
        right: Disparity of the right view, (H, W), in px: right pixel (x, y) matches left pixel
            (x + disparity, y).

    Returns:
        (H, W), True where the match lies beyond the right view's border, or the right view's
        disparity there differs by more than `AGREEMENT`.
    """
    width = left.shape[1]
    # What is not finite is sent beyond the border.
    column = np.arange(width) - np.where(np.isfinite(left), left, 2 * width)
    column = np.rint(column.clip(-1, width)).astype(int)
    there = np.take_along_axis(right, column.clip(0, width - 1), axis=1)
    agree = np.abs(left - there) <= AGREEMENT
    occluded: Mask = (column < 0) | (column >= width) | ~agree
    return occluded
