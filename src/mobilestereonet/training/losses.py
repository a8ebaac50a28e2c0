"""Training losses: sums over pixels, so that ranks and batches can be divided exactly."""

from __future__ import annotations

from collections.abc import Sequence

import torch
import torch.nn.functional as F
from torch import Tensor

AGREEMENT_PX = 8.0
"""Disparities of a network and its teacher that differ by less mean the same surface."""


def cross_entropy_sum(
    scores: Sequence[Tensor],
    weights: Sequence[float],
    target: Tensor,
    mask: Tensor,
    *,
    scale: int = 4,
) -> Tensor:
    """Cross entropy of the coarse scores against the ground truth's two neighbouring planes.

    It says at which disparity the match is, where the regression only says in which direction to
    go: matching is learnt several times sooner. (Not in the paper.)

    Args:
        scores: Matching scores (B, D, H / s, W / s) per head.
        weights: Weight of each head.
        target: Ground truth (B, H, W) in pixels at full resolution, sampled at every s-th pixel.
        mask: Pixels that count, (B, H, W) bool.
        scale: Pixels from one coarse plane to the next, and of one coarse pixel, s.

    Returns:
        Sum over coarse pixels and heads times s^2, to weigh as a sum over full-resolution pixels.
    """
    middle = slice(scale // 2, None, scale)
    target, mask = target[:, middle, middle], mask[:, middle, middle]
    total = target.new_zeros(())
    for weight, score in zip(weights, scores, strict=True):
        log_probability = F.log_softmax(score.float(), dim=1)
        last = score.shape[1] - 1
        # Coarse plane k lies at the fine disparity s k + (s - 1) / 2: of 4, 4 k + 1.5.
        position = ((target - (scale - 1) / 2) / scale).clamp(0, last)
        below = position.floor().clamp(max=last - 1)
        share = position - below
        index = below.long().unsqueeze(1)
        low = log_probability.gather(1, index).squeeze(1)
        high = log_probability.gather(1, index + 1).squeeze(1)
        loss = -((1 - share) * low + share * high)
        total = total + weight * torch.where(mask, loss, 0).sum()
    return scale**2 * total


def distillation_sum(
    scores: Sequence[Tensor],
    weights: Sequence[float],
    disparity: Tensor,
    teacher_scores: Tensor,
    teacher_disparity: Tensor,
    confidence: Tensor,
    *,
    cross_entropy: float,
    scale: int = 4,
) -> Tensor:
    """What a teacher says, as a loss like that of the ground truth.

    Its distribution over the coarse disparities for all heads (Kullback-Leibler divergence), and
    its disparity for the last one: smooth L1 where both agree within `AGREEMENT_PX`, for where
    they do not one of them sees another surface, and the distribution says which.

    Args:
        scores: Matching scores (B, D, H / s, W / s) per head.
        weights: Weight of each head.
        disparity: Disparity (B, H, W) of the last head in pixels.
        teacher_scores: The teacher's scores, like those of one head.
        teacher_disparity: The teacher's disparity (B, H, W) in pixels.
        confidence: What a pixel counts, (B, H, W), such as the teacher's confidence.
        cross_entropy: Weight of the distribution beside the smooth L1.
        scale: Pixels from one coarse plane to the next, and of one coarse pixel, s.

    Returns:
        Sum over pixels and heads, a scalar.
    """
    target = teacher_scores.float().log_softmax(dim=1)
    coarse = confidence[:, scale // 2 :: scale, scale // 2 :: scale]
    total = confidence.new_zeros(())
    for weight, score in zip(weights, scores, strict=True):
        found = score.float().log_softmax(dim=1)
        divergence = F.kl_div(found, target, reduction="none", log_target=True).sum(dim=1)
        total = total + weight * (coarse * divergence).sum()
    difference = F.smooth_l1_loss(disparity, teacher_disparity, reduction="none")
    agree = (disparity - teacher_disparity).abs() < AGREEMENT_PX
    full = (confidence * torch.where(agree, difference, 0)).sum()
    return scale**2 * cross_entropy * total + full
