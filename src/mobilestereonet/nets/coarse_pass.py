"""A half-resolution pass guides the full-resolution pass (not in the paper).

A network's receptive field does not grow with the image. Inside a large surface without texture it
must guess; at half resolution the surface's borders are twice as near.
"""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor, nn

MIN_LOG_PROBABILITY = -8.0
"""Logarithm of a probability at which, and below which, guidance is 0."""


def halve(views: Tensor) -> Tensor:
    """Views (B, 3, H, W), H and W even, at half resolution: means of 2 x 2 pixels."""
    return F.avg_pool2d(views, 2)


def scaled_log_probability(scores: Tensor) -> Tensor:
    """Log-softmax of scores (B, D, H, W), mapped from -8 and below .. 0 to 0 .. 1; float32."""
    dtype = torch.promote_types(scores.dtype, torch.float32)
    logarithm = torch.log_softmax(scores.to(dtype), dim=1)
    return 1 - logarithm.clamp(min=MIN_LOG_PROBABILITY) / MIN_LOG_PROBABILITY


def guidance_from_scores(scores: Tensor) -> Tensor:
    """Log-probabilities of the coarse pass, upsampled to the planes and pixels of the fine pass.

    Args:
        scores: Scores of the coarse pass, (B, D / 2, H / 8, W / 8): half as many planes cover the
            same range, since disparities halve with the resolution.

    Returns:
        (B, D, H / 4, W / 4), interpolated between 1 (probability 1) and 0 (e^-8 and below), in the
        dtype of the scores.
    """
    likely = scaled_log_probability(scores).unsqueeze(1)
    fine = F.interpolate(likely, scale_factor=2, mode="trilinear", align_corners=False)
    return fine.squeeze(1).to(scores.dtype)


class Guide(nn.Conv3d):
    """Adds a 3x3x3 convolution of the guidance, initialised with zeros, to a volume.

    It is a convolution itself, so that its parameter is called ``guide.weight`` in weights files.
    """

    def __init__(self, width: int) -> None:
        super().__init__(1, width, 3, padding=1, bias=False)
        nn.init.zeros_(self.weight)

    def forward(self, x: Tensor, guidance: Tensor) -> Tensor:  # type: ignore[override]
        """(B, width, D, H, W) and guidance (B, D, H, W) -> (B, width, D, H, W)."""
        return x + super().forward(guidance.unsqueeze(1))
