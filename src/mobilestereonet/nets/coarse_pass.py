"""The scores of a pass at half of the size as guidance of the pass at full size.

What a network sees around a pixel does not grow with the picture. Inside of a large surface without
texture it must guess; in views of half the size the surface's borders are twice as near. (Not in
the paper.)
"""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor, nn

MIN_LOG_PROBABILITY = -8.0
"""Logarithm of a probability at which, and below which, guidance is 0."""


def halve(views: Tensor) -> Tensor:
    """Views (B, 3, H, W), H and W even, at half of the size: means of 2 x 2 pixels."""
    return F.avg_pool2d(views, 2)


def log_likelihood(scores: Tensor) -> Tensor:
    """Logarithm of the softmax over scores (B, D, H, W), from 0 (at e^-8 and below) to 1."""
    dtype = torch.promote_types(scores.dtype, torch.float32)
    logarithm = torch.log_softmax(scores.to(dtype), dim=1)
    return logarithm.clamp(min=MIN_LOG_PROBABILITY) / -MIN_LOG_PROBABILITY + 1


def guidance_from_scores(scores: Tensor) -> Tensor:
    """How likely the coarse pass finds each disparity of the fine pass.

    Args:
        scores: The coarse pass's scores, (B, D / 2, H / 8, W / 8); twice its disparities are those
            of the fine pass.

    Returns:
        (B, D, H / 4, W / 4), 1 where it is sure, falling with the logarithm of the probability to
        0 at e^-8 and below; in the type of the scores.
    """
    likely = log_likelihood(scores).unsqueeze(1)
    fine = F.interpolate(likely, scale_factor=2, mode="trilinear", align_corners=False)
    return fine.squeeze(1).to(scores.dtype)


class Guide(nn.Conv3d):
    """Adds a 3x3x3 convolution of the guidance, zero at first, to the encoder's input."""

    def __init__(self, width: int) -> None:
        super().__init__(1, width, 3, padding=1, bias=False)
        nn.init.zeros_(self.weight)

    def forward(self, x: Tensor, guidance: Tensor) -> Tensor:  # type: ignore[override]
        """(B, width, D, H, W) and guidance (B, D, H, W) -> (B, width, D, H, W)."""
        return x + super().forward(guidance.unsqueeze(1))
