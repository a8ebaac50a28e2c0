"""Disparity refinement of MC-CNN's stereo method (Sec. 4.3 and 4.4), step by step."""

from __future__ import annotations

import math

import torch
import torch.nn.functional as F
from torch import Tensor

CONSISTENT_PX = 1.1
"""Disparities of both views that differ by less are of one surface."""

OCCLUDED, MISMATCHED = 1, 2
"""Classes of outliers; 0 is none."""

DIRECTIONS = [
    (dx / 2, dy / 2) for dx in range(-2, 3) for dy in range(-2, 3) if max(abs(dx), abs(dy)) == 2
]
"""The 16 directions in which a mismatched pixel looks for others."""


def outliers(left: Tensor, right: Tensor, planes: int) -> Tensor:
    """Left-right check: classes (H, W) of the left view's disparities.

    Args:
        left: Disparity of the left view, (H, W) integers.
        right: Disparity of the right view, likewise.
        planes: Number of disparities.
    """
    columns = torch.arange(left.shape[1], device=left.device)
    partner = columns - left
    there = right.gather(1, partner.clamp_min(0))
    consistent = (partner >= 0) & ((left - there).abs() < CONSISTENT_PX)
    matches = torch.zeros_like(consistent)
    for d in range(min(planes, left.shape[1])):
        matches[:, d:] |= (d - right[:, : right.shape[1] - d]).abs() < CONSISTENT_PX
    classes = torch.where(matches & (partner >= 0), MISMATCHED, OCCLUDED)
    return classes.masked_fill(consistent, 0)


def fill_occluded(disparity: Tensor, classes: Tensor) -> Tensor:
    """Occluded pixels take the next good one to the left, or else to the right: (H, W)."""
    width = disparity.shape[1]
    columns = torch.arange(width, device=disparity.device)
    good = classes == 0
    before = torch.where(good, columns, -1).cummax(dim=1).values
    after = torch.where(good, columns, width).flip(1).cummin(dim=1).values.flip(1)
    source = torch.where(before >= 0, before, after)
    found = (classes == OCCLUDED) & (source < width)
    return torch.where(found, disparity.gather(1, source.clamp_max(width - 1)), disparity)


def fill_mismatched(disparity: Tensor, classes: Tensor) -> Tensor:
    """Mismatched pixels take the median of the next other pixels in 16 directions: (H, W)."""
    height, width = disparity.shape
    mismatched = classes == MISMATCHED
    y, x = mismatched.nonzero(as_tuple=True)
    candidates = torch.full((len(DIRECTIONS), len(x)), torch.inf, dtype=disparity.dtype)
    candidates = candidates.to(disparity.device)
    for candidate, (dx, dy) in zip(candidates, DIRECTIONS, strict=True):
        walking = torch.arange(len(x), device=x.device)
        for step in range(1, max(height, width)):
            column, row = _round(x[walking] + step * dx), _round(y[walking] + step * dy)
            inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
            walking, column, row = walking[inside], column[inside], row[inside]
            stops = ~mismatched[row, column]
            candidate[walking[stops]] = disparity[row[stops], column[stops]]
            walking = walking[~stops]
            if not len(walking):
                break
    filled = disparity.clone()
    values = _upper_median(candidates)
    filled[y, x] = torch.where(values.isfinite(), values, disparity[y, x])
    return filled


def _round(position: Tensor) -> Tensor:
    """Nearest integers, halves away from zero."""
    return (position.sign() * (position.abs() + 0.5).floor()).long()


def _upper_median(values: Tensor) -> Tensor:
    """Of the finite values along the first dimension: the one at place count // 2 in order."""
    count = values.isfinite().sum(dim=0, keepdim=True)
    place = (count // 2).clamp_max(len(values) - 1)
    return values.sort(dim=0).values.gather(0, place).squeeze(0)


def subpixel(disparity: Tensor, volume: Tensor) -> Tensor:
    """The lowest point of the parabola through a pixel's cost and its neighbours': (H, W).

    Args:
        disparity: (H, W), whole pixels.
        volume: (D, H, W).
    """
    last = len(volume) - 1
    place = disparity.long().clamp(1, last - 1).unsqueeze(0)
    below, here, above = (volume.gather(0, place + i).squeeze(0) for i in (-1, 0, 1))
    curvature = above + below - 2 * here
    fits = (curvature > 1e-5) & curvature.isfinite() & (disparity >= 1) & (disparity < last)
    shift = (above - below) / (2 * torch.where(fits, curvature, 1))
    return torch.where(fits, disparity - shift.clamp(-1, 1), disparity)


def median(disparity: Tensor, size: int = 5) -> Tensor:
    """Median of the pixels of a window that are inside the image: (H, W)."""
    side = size // 2
    padded = F.pad(disparity, (side,) * 4, value=torch.inf)
    windows = padded.unfold(0, size, 1).unfold(1, size, 1)
    return _upper_median(windows.reshape(*disparity.shape, -1).permute(2, 0, 1))


def bilateral(disparity: Tensor, sigma: float, threshold: float) -> Tensor:
    """Gaussian mean of the neighbours whose disparity differs by less than a threshold: (H, W).

    Args:
        disparity: (H, W).
        sigma: Standard deviation in pixels.
        threshold: In pixels of disparity.
    """
    height, width = disparity.shape
    radius = math.ceil(3 * sigma)
    padded = F.pad(disparity, (radius,) * 4, value=torch.inf)
    total, weights = torch.zeros_like(disparity), torch.zeros_like(disparity)
    for dy in range(-radius, radius + 1):
        for dx in range(-radius, radius + 1):
            weight = math.exp(-(dx**2 + dy**2) / (2 * sigma**2))
            top, start = dy + radius, dx + radius
            beside = padded[top : top + height, start : start + width]
            near = (beside - disparity).abs() < threshold
            total.add_(torch.where(near, beside, 0), alpha=weight)
            weights.add_(near, alpha=weight)
    return total / weights
