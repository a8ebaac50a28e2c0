"""From scores at a quarter of the resolution to a disparity at full resolution, in closed form.

The paper upsamples (D, H/4, W/4) scores trilinearly to (4 D, H, W), half-pixel centres, and takes
the expectation of the disparity under their softmax. Between two neighbouring coarse disparities
the upsampled scores are linear in the disparity, so with a and b the eighth roots of the two
coarse terms exp(score), the four fine terms of the interval are

    a^7 b, a^5 b^3, a^3 b^5, a b^7,

whose sum is a b (a^2 + b^2)(a^4 + b^4) and whose first moment about the interval's centre is
a b (b^2 - a^2)(1.5 (a^4 + b^4) + 2 a^2 b^2). The two fine bins at either end repeat the outer
score. Hence (D, H, W) is enough, with one exponential per coarse score.
"""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor


def soft_argmax(scores: Tensor) -> Tensor:
    """Expected disparity of scores whose spatial upsampling is done.

    Equals linear upsampling of the scores by 4 along D (half-pixel centres), a softmax over the
    4 D fine disparities and the expectation over 0 .. 4 D - 1.

    Args:
        scores: (B, D, H, W), D coarse disparities 0, 4, 8 ... Higher is a better match.

    Returns:
        Disparity (B, H, W) in pixels.
    """
    planes = scores.shape[1]
    root = torch.exp((scores - scores.amax(dim=1, keepdim=True)) / 8)
    square = root * root
    fourth = square * square
    a2, b2 = square[:, :-1], square[:, 1:]
    a4_b4 = fourth[:, :-1] + fourth[:, 1:]
    product = root[:, :-1] * root[:, 1:]
    mass = product * (a2 + b2) * a4_b4
    moment = product * (b2 - a2) * (1.5 * a4_b4 + 2 * a2 * b2)
    centres = 4 * torch.arange(planes - 1, dtype=scores.dtype, device=scores.device) + 3.5
    first, last = 2 * fourth[:, 0].square(), 2 * fourth[:, -1].square()
    total = mass.sum(dim=1) + first + last
    weighted = (centres[:, None, None] * mass + moment).sum(dim=1)
    return (weighted + 0.5 * first + (4 * planes - 1.5) * last) / total


def regress_disparity(scores: Tensor) -> Tensor:
    """Disparity at full resolution from scores at a quarter of it.

    Args:
        scores: (B, D, H / 4, W / 4). Reduced precision is raised to float32 first.

    Returns:
        Disparity (B, H, W) in pixels, 0 <= d <= 4 D - 1.
    """
    if scores.dtype in (torch.float16, torch.bfloat16):
        scores = scores.float()
    return soft_argmax(F.interpolate(scores, scale_factor=4, mode="bilinear", align_corners=False))
