"""Training losses: sums over pixels, so that ranks and batches can be divided exactly."""

from __future__ import annotations

from collections.abc import Sequence

import torch
import torch.nn.functional as F
from torch import Tensor

PAPER_HEAD_WEIGHTS = (0.5, 0.5, 0.7, 1.0)
"""Weights of the four heads, first to last (the authors' release)."""

AGREEMENT = 8.0
"""Pixels by which a network and its teacher may differ and mean the same surface."""


def trained_pixels(disparity: Tensor, valid: Tensor, max_disparity: int) -> Tensor:
    """Pixels that the losses look at: (B, H, W) bool, ground truth 0 < d < max_disparity."""
    return valid & (disparity > 0) & (disparity < max_disparity)


def smooth_l1_sum(predictions: Sequence[Tensor], target: Tensor, mask: Tensor) -> Tensor:
    """The paper's loss: smooth L1 of every head, weighted, summed over the masked pixels.

    Args:
        predictions: Disparities (B, H, W) of the last n heads; the last n of the weights apply.
        target: Ground truth (B, H, W) in pixels.
        mask: Pixels that count, (B, H, W) bool.

    Returns:
        Sum over pixels and heads, a scalar.
    """
    total = target.new_zeros(())
    for weight, prediction in _weighted(predictions):
        loss = F.smooth_l1_loss(prediction, target, reduction="none")
        total = total + weight * torch.where(mask, loss, 0).sum()
    return total


def cross_entropy_sum(scores: Sequence[Tensor], target: Tensor, mask: Tensor) -> Tensor:
    """Cross entropy of the coarse scores against the ground truth's two neighbouring planes.

    It says at which disparity the match is, where the regression only says in which direction to
    go: matching is learnt several times sooner. (Not in the paper.)

    Args:
        scores: Matching scores (B, D, H / 4, W / 4) of the last n heads.
        target: Ground truth (B, H, W) in pixels at full resolution, sampled at every fourth pixel.
        mask: Pixels that count, (B, H, W) bool.

    Returns:
        Sum over coarse pixels and heads times 16, to weigh as a sum over full-resolution pixels.
    """
    target, mask = target[:, 2::4, 2::4], mask[:, 2::4, 2::4]
    total = target.new_zeros(())
    for weight, score in _weighted(scores):
        log_probability = F.log_softmax(score.float(), dim=1)
        last = score.shape[1] - 1
        # Coarse plane k lies at the fine disparity 4 k + 1.5.
        position = ((target - 1.5) / 4).clamp(0, last)
        below = position.floor().clamp(max=last - 1)
        share = position - below
        index = below.long().unsqueeze(1)
        low = log_probability.gather(1, index).squeeze(1)
        high = log_probability.gather(1, index + 1).squeeze(1)
        loss = -((1 - share) * low + share * high)
        total = total + weight * torch.where(mask, loss, 0).sum()
    return 16 * total


def distillation_sum(
    scores: Sequence[Tensor],
    disparity: Tensor,
    teacher_scores: Tensor,
    teacher_disparity: Tensor,
    weight: Tensor,
    *,
    cross_entropy: float,
) -> Tensor:
    """What a teacher says, as a loss like that of the ground truth.

    Its distribution over the coarse disparities for all heads (Kullback-Leibler divergence), and
    its disparity for the last one: smooth L1 where both agree within `AGREEMENT` px, for where
    they do not one of them sees another surface, and the distribution says which.

    Args:
        scores: Matching scores (B, D, H / 4, W / 4) of the last n heads.
        disparity: Disparity (B, H, W) of the last head in pixels.
        teacher_scores: The teacher's scores, like those of one head.
        teacher_disparity: The teacher's disparity (B, H, W) in pixels.
        weight: What a pixel counts, (B, H, W), such as the teacher's confidence.
        cross_entropy: Weight of the distribution beside the smooth L1.

    Returns:
        Sum over pixels and heads, a scalar.
    """
    target = teacher_scores.float().log_softmax(dim=1)
    coarse = weight[:, 2::4, 2::4]
    total = weight.new_zeros(())
    for head, score in _weighted(scores):
        found = score.float().log_softmax(dim=1)
        divergence = F.kl_div(found, target, reduction="none", log_target=True).sum(dim=1)
        total = total + head * (coarse * divergence).sum()
    difference = F.smooth_l1_loss(disparity, teacher_disparity, reduction="none")
    agree = (disparity - teacher_disparity).abs() < AGREEMENT
    return 16 * cross_entropy * total + (weight * torch.where(agree, difference, 0)).sum()


def _weighted(heads: Sequence[Tensor]) -> list[tuple[float, Tensor]]:
    weights = PAPER_HEAD_WEIGHTS[-len(heads) :]
    # Networks with more than three hourglasses: the first heads weigh as the paper's first.
    weights = (PAPER_HEAD_WEIGHTS[0],) * (len(heads) - len(weights)) + weights
    return list(zip(weights, heads, strict=True))
