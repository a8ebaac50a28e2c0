"""PatchMatch along the rows, and cost volumes of the few disparities that it finds.

PatchMatch: Barnes et al., 2009; its differentiable form: Duggal et al., "DeepPruner: Learning
Efficient Stereo Matching via Differentiable PatchMatch", ICCV 2019.
"""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor

ITERATIONS = 2
"""How often particles spread along the rows and then along the columns."""

SHARPNESS = 7.0
"""Factor of the mean product of two pixels' features in the softmax over three particles."""


def patch_match(left: Tensor, right: Tensor, low: Tensor, high: Tensor, offsets: Tensor) -> Tensor:
    """Likely disparities of each pixel, one in each of n equal parts of its range.

    Each part has a particle. In turn along the rows and along the columns, a particle becomes the
    mean of itself and its two neighbours' (of the same part), weighted by how well they match.
    Beyond the border particles lie at the start of their part.

    Args:
        left: Features of the left views, (B, C, H, W).
        right: Features of the right views, likewise.
        low: Lowest disparity of each pixel's range, (B, 1, H, W), in pixels of the features;
            rounded down.
        high: Highest one, likewise; rounded up.
        offsets: Where particles start within their part, 0 .. 1: (B, n, H, W), or (1, n, H, W) for
            all pairs alike.

    Returns:
        (B, n, H, W), in pixels of the features.
    """
    dtype = torch.promote_types(left.dtype, torch.float32)  # bfloat16 counts to 256
    left, right, low, high, offsets = (x.to(dtype) for x in (left, right, low, high, offsets))
    low, span = low.floor(), high.ceil() - low.floor()
    parts, columns = offsets.shape[1], torch.arange(left.shape[-1], device=left.device)
    starts = low + torch.arange(parts, device=left.device)[:, None, None] * span / parts
    disparity = starts
    for dimension in (-1, -2) * ITERATIONS:
        particles = _with_neighbours(offsets, dimension)
        disparities = particles * span / parts + starts
        scores = []
        for each in disparities:
            partner = (columns - each).clamp(0, left.shape[-1] - 1).long()
            scores.append((left.unsqueeze(2) * _at(right, partner)).mean(dim=1))
        weights = (SHARPNESS * torch.stack(scores)).softmax(dim=0)
        offsets = (weights * particles).sum(dim=0)
        disparity = (weights * disparities).sum(dim=0)
    return disparity


def candidate_volume(left: Tensor, right: Tensor, candidates: Tensor) -> Tensor:
    """Concatenation volume of given disparities.

    Args:
        left: Features of the left views, (B, C, H, W).
        right: Features of the right views, likewise.
        candidates: Whole disparities in pixels of the features, not negative: (B, n, H, W).

    Returns:
        (B, 2 C + 1, n, H, W): the left features; those of the right view at the columns that the
        candidates point to, zero where these are outside; and the candidates.
    """
    columns = torch.arange(left.shape[-1], device=left.device) - candidates.long()
    partners = _at(right, columns.clamp_min(0)) * (columns >= 0).unsqueeze(1)
    left = left.unsqueeze(2).expand_as(partners)
    return torch.cat((left, partners, candidates.to(left.dtype).unsqueeze(1)), dim=1)


def _with_neighbours(x: Tensor, dimension: int) -> Tensor:
    """(3, B, n, H, W): the value before along a dimension, -1 or -2, its own, the one after."""
    padded = F.pad(x, (1, 1) if dimension == -1 else (0, 0, 1, 1))
    return torch.stack([padded.narrow(dimension, k, x.shape[dimension]) for k in range(3)])


def _at(features: Tensor, columns: Tensor) -> Tensor:
    """Features (B, C, H, W) at columns (B, n, H, W) of their rows: (B, C, n, H, W)."""
    channels, parts = features.shape[1], columns.shape[1]
    features = features.unsqueeze(2).expand(-1, -1, parts, -1, -1)
    return features.gather(4, columns.unsqueeze(1).expand(-1, channels, -1, -1, -1))
