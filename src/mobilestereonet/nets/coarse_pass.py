"""The scores of a pass at half of the size as guidance of the pass at full size.

What a network sees around a pixel does not grow with the picture. Inside of a large surface without
texture it must guess; in views of half the size the surface's borders are twice as near.
"""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor

_LEAST = -8.0
"""Logarithm of a probability from which on guidance is 0."""


def halve(views: Tensor) -> Tensor:
    """Views (B, 3, H, W), H and W even, at half of the size: means of 2 x 2 pixels."""
    return F.avg_pool2d(views, 2)


def guidance(scores: Tensor) -> Tensor:
    """How likely the coarse pass finds each disparity of the fine pass. Plain operators only.

    Args:
        scores: The coarse pass's scores, (B, D / 2, H / 8, W / 8); twice its disparities are those
            of the fine pass.

    Returns:
        (B, D, H / 4, W / 4), 1 where it is sure, falling with the logarithm of the probability to
        0 at e^-8 and below; in the type of the scores.
    """
    dtype = torch.promote_types(scores.dtype, torch.float32)
    likely = torch.log_softmax(scores.to(dtype), dim=1).clamp(min=_LEAST) / -_LEAST + 1
    likely = F.interpolate(likely, scale_factor=2, mode="bilinear", align_corners=False)
    # The same along the disparities, on four dimensions: even planes, odd planes, then in order.
    below = torch.cat((likely[:, :1], likely[:, :-1]), dim=1)
    above = torch.cat((likely[:, 1:], likely[:, -1:]), dim=1)
    planes = torch.cat((0.75 * likely + 0.25 * below, 0.75 * likely + 0.25 * above), dim=1)
    order = torch.arange(planes.shape[1], device=planes.device).reshape(2, -1).t().flatten()
    return planes.index_select(1, order).to(scores.dtype)
