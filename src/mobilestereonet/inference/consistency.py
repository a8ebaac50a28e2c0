"""Left-right consistency check: marks pixels on whose disparity the two views disagree."""

from __future__ import annotations

import torch
from torch import Tensor

MAX_DISAGREEMENT_PX = 1.0
"""Largest difference between both views' disparities of one point that still is agreement."""


def occluded_pixels(left: Tensor, right: Tensor) -> Tensor:
    """Mask of the left pixels whose disparity the right view's contradicts.

    Those are the pixels that the right camera does not see, and wrong matches.

    Args:
        left: Disparity of the left view, (..., H, W), in px.
        right: Disparity of the right view, (..., H, W), in px: right pixel (x, y) matches left
            pixel (x + disparity, y).

    Returns:
        (..., H, W) bool, True where the match lies beyond the right view's border, or the right
        view's disparity there differs by more than `MAX_DISAGREEMENT_PX`.
    """
    width = left.shape[-1]
    # What is not finite is sent beyond the border.
    shift = torch.where(left.isfinite(), left, 2 * width)
    column = (torch.arange(width, device=left.device) - shift).clamp(-1, width).round().long()
    matched = right.gather(-1, column.clamp(0, width - 1))
    agree = (left - matched).abs() <= MAX_DISAGREEMENT_PX
    return (column < 0) | (column >= width) | ~agree
