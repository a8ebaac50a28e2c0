"""Places of a pair that lose their contrast, to teach the fine pass to believe the coarse one.

Inside of a large surface without texture only the coarse pass can be right, and few crops show one
that large. Here the coarse pass sees the pair as it is, the fine one with such a place in it.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

_SIDES = (0.25, 0.75)
"""Least and largest side of a place, as shares of the view's."""

_CONTRAST = 0.1
"""The most that is left of the contrast."""

_RAMP = 32
"""Pixels around a place over which the contrast comes back: a place has no edges."""


def fade(
    left: Tensor,
    right: Tensor,
    disparity: Tensor,
    known: Tensor,
    share: float,
    generator: np.random.Generator,
) -> tuple[Tensor, Tensor]:
    """Views in some of which one place, a rectangle, has nearly one colour.

    In the right view it reaches as far as the matches of the left one's pixels.

    Args:
        left: Left views (B, 3, H, W).
        right: Right views, likewise.
        disparity: Ground truth (B, H, W) in pixels.
        known: Where it counts (B, H, W), boolean.
        share: How many of the pairs have such a place, 0..1.
        generator: Draws them.
    """
    batch, _, height, width = left.shape
    drawn = torch.from_numpy(generator.random((6, batch, 1, 1), dtype=np.float32))
    chosen, contrast, tall, wide, middle_y, middle_x = drawn.to(left.device)
    contrast = torch.where(chosen < share, _CONTRAST * contrast, 1)
    least, largest = _SIDES
    half_height = height * (least + (largest - least) * tall) / 2
    half_width = width * (least + (largest - least) * wide) / 2
    y = torch.arange(height, device=left.device)[:, None]
    x = torch.arange(width, device=left.device)
    above = (y - height * middle_y).abs() - half_height
    first, last = width * middle_x - half_width, width * middle_x + half_width
    inside = known & (above <= 0) & (x >= first) & (x <= last)
    nearest = torch.where(inside, disparity, 0).amax((1, 2), keepdim=True)
    farthest = torch.where(inside, disparity, nearest).amin((1, 2), keepdim=True)

    def faded(view: Tensor, first: Tensor, last: Tensor) -> Tensor:
        outside = torch.maximum(above, torch.maximum(first - x, x - last))
        kept = (contrast + (1 - contrast) * (outside / _RAMP).clamp(0, 1)).unsqueeze(1)
        lost = 1 - kept
        colour = (view * lost).sum((2, 3), keepdim=True) / lost.sum((2, 3), keepdim=True).clamp(1)
        return torch.lerp(colour, view, kept)

    return faded(left, first, last), faded(right, first - nearest, last - farthest)
