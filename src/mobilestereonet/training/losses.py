"""Training losses: sums over pixels, so that ranks and batches can be divided exactly."""

from __future__ import annotations

from collections.abc import Sequence

import torch
import torch.nn.functional as F
from torch import Tensor

from mobilestereonet.accelerate.cross_entropy import disparity_cross_entropy
from mobilestereonet.accelerate.soft_argmax import SCALE, upsample

AGREEMENT_PX = 8.0
"""Disparities of a network and its teacher that differ by less mean the same surface."""

NO_SCORE = -1e4
"""Score of a plane that has no probability."""

SURFACE_PX = 3.0
"""Disparities in a row's neighbourhood that differ by more belong to another surface."""

NEIGHBOURS_PX = 4
"""Pixels to either side of one that may belong to another surface."""

OWN_SHARE = 0.8
"""Share of a pixel's own surface where all of its neighbours belong to others."""


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


def fine_cross_entropy_sum(
    scores: Sequence[Tensor],
    weights: Sequence[float],
    centres: Tensor,
    shares: Tensor,
    *,
    full_heads: int,
) -> Tensor:
    """Cross entropy of the upsampled scores against narrow Laplacians, in closed form.

    `cross_entropy_sum` wants the two planes beside a disparity to share the probability in
    proportion, after which the expectation over upsampled scores is another disparity: answers
    lean towards some fractions. Here the lowest loss has the right expectation.

    Args:
        scores: Matching scores (B, D, H / 4, W / 4) per head.
        weights: Weight of each head.
        centres: Disparities (B, M, H, W) in px at full resolution, see `surfaces`.
        shares: Share of each of these, likewise.
        full_heads: Heads, counted from the last, whose scores are upsampled in height and width;
            the others' are compared with every fourth pixel.

    Returns:
        Sum over full-resolution pixels and heads; every fourth pixel counts as 16.
    """
    middle = slice(SCALE // 2, None, SCALE)
    coarse = centres[..., middle, middle], shares[..., middle, middle]
    total = shares.new_zeros(())
    for index, (weight, score) in enumerate(zip(weights, scores, strict=True)):
        score = score.to(centres.dtype)
        if index < len(scores) - full_heads:
            loss = SCALE**2 * disparity_cross_entropy(score, *coarse).sum()
        else:
            loss = disparity_cross_entropy(upsample(score), centres, shares).sum()
        total = total + weight * loss
    return total


def own_surface(disparity: Tensor, mask: Tensor) -> tuple[Tensor, Tensor]:
    """Each pixel's ground truth as the only mode of a distribution.

    Args:
        disparity: Ground truth (B, H, W) in px.
        mask: Pixels that count, (B, H, W) bool.

    Returns:
        Disparities and their shares, (B, 1, H, W) each; a share is 0 where a pixel does not count.
    """
    return torch.where(mask, disparity, 0).unsqueeze(1), mask.to(disparity.dtype).unsqueeze(1)


def surfaces(disparity: Tensor, mask: Tensor) -> tuple[Tensor, Tensor]:
    """Modes of the ground truth around each pixel: its own, a farther and a nearer surface.

    At edges a network cannot tell on which side a pixel lies, and a target of one mode makes it
    spread its probability over what lies between. A target of several tells which surfaces there
    are (Xu et al., "Adaptive Multi-Modal Cross-Entropy Loss for Stereo Matching", CVPR 2024, who
    cluster the 1 x 9 neighbourhood; here what is farther, and what is nearer, is one cluster each).

    Args:
        disparity: Ground truth (B, H, W) in px.
        mask: Pixels that count, (B, H, W) bool.

    Returns:
        Disparities and their shares, (B, 3, H, W) each, own, farther, nearer; a surface that is
        not there has no share, nor has a pixel that does not count.
    """
    own, counted = own_surface(disparity, mask)
    around = [
        F.pad(map_, (NEIGHBOURS_PX,) * 2).unfold(-1, 2 * NEIGHBOURS_PX + 1, 1)
        for map_ in (own, counted)
    ]
    rise = around[0] - own.unsqueeze(-1)  # (B, 1, H, W, 9)
    centres, shares = [own], []
    for other in (rise < -SURFACE_PX, rise > SURFACE_PX):
        there = other * around[1] * counted.unsqueeze(-1)
        pixels = there.sum(dim=-1)
        centres.append((there * around[0]).sum(dim=-1) / pixels.clamp_min(1))
        shares.append((1 - OWN_SHARE) / (2 * NEIGHBOURS_PX) * pixels)
    return torch.cat(centres, dim=1), torch.cat((counted - sum(shares), *shares), dim=1)


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
    searched: Tensor | None = None,
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
        searched: Planes that the network compared, (B, D, H / s, W / s) bool, on which the
            teacher's distribution is taken; None: all.

    Returns:
        Sum over pixels and heads, a scalar.
    """
    target = teacher_scores.float()
    if searched is not None:
        target = target.masked_fill(~searched, NO_SCORE)
    target = target.log_softmax(dim=1)
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
