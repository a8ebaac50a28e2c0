"""How sure a network is of its disparity, from the distribution that it comes from."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor

from mobilestereonet.nets.disparity import Estimator, soft_argmax

WITHIN = 2
"""Pixels around the disparity in which the probability is counted."""


def match_confidence(scores: Tensor, estimator: Estimator = "mean") -> Tensor:
    """Probability, by the scores' softmax, that the disparity is within 2 px of the estimate.

    Computed at a quarter of the resolution and upsampled: on real pairs that sorts errors as well
    as at full resolution, and costs a sixteenth. Plain operators only.

    Args:
        scores: (B, D, H / 4, W / 4), D coarse disparities 0, 4, 8 ... Reduced precision is raised
            to float32 first.
        estimator: How the disparity was estimated, see `soft_argmax`.

    Returns:
        (B, H, W) in 0..1.
    """
    scores = scores.float()
    planes = scores.shape[1]
    # The network's own linear upsampling along D, as a 1x1 convolution: four dimensions suffice.
    upsample = F.interpolate(
        torch.eye(planes, device=scores.device)[None], scale_factor=4.0, mode="linear"
    )
    probability = F.conv2d(scores, upsample[0].t()[..., None, None]).softmax(dim=1)
    bins = torch.arange(4 * planes, dtype=scores.dtype, device=scores.device)[:, None, None]
    disparity = soft_argmax(scores, estimator).unsqueeze(1)
    within = (WITHIN + 0.5 - (bins - disparity).abs()).clamp(0, 1)
    confidence = (probability * within).sum(dim=1, keepdim=True)
    return F.interpolate(confidence, scale_factor=4.0, mode="bilinear").squeeze(1)
