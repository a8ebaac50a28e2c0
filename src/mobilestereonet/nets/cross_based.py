"""Cross-based aggregation and semi-global matching, as in MC-CNN's stereo method (Sec. 4).

Volumes are (D, H, W), lower is better, infinite where a pixel has no partner in the other view: at
disparity d it is at column x + ``side`` d, side -1 in the left view's volume and 1 in the right's.
In the latter the release takes arms and steps of the *left* view for the reference, too; so do
these functions, to which both views are given in the same order for both volumes.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor, nn

OUTSIDE = 10.0
"""Intensity step at a partner outside the image, in standard deviations of the image."""


class Arms(NamedTuple):
    """Cross of each pixel: coordinates of the first pixel beyond each arm, (H, W) integers."""

    left: Tensor
    right: Tensor
    up: Tensor
    down: Tensor


def cross_arms(image: Tensor, length: int, intensity: float) -> Arms:
    """Arms of a cross at each pixel (Sec. 4.1).

    Args:
        image: Intensities (H, W).
        length: Arms reach less far than this, in pixels, but always to the next pixel.
        intensity: Arms hold pixels that differ by less than this from the centre.
    """
    rows, columns = (torch.arange(size, device=image.device) for size in image.shape)

    def reach(image: Tensor) -> Tensor:
        """Distance along the rows of the first pixel to the right that is not in the arm."""
        found = torch.ones_like(image, dtype=torch.long)
        within = torch.ones_like(image, dtype=torch.bool)
        for step in range(1, min(max(length, 2), image.shape[1] + 1)):
            beside = F.pad(image[:, step:], (0, step), value=torch.nan)
            near = (beside - image).abs() < (torch.inf if step == 1 else intensity)
            within &= near
            found += within
        return found

    return Arms(
        columns - reach(image.flip(1)).flip(1),
        columns + reach(image),
        rows[:, None] - reach(image.T.flip(1)).flip(1).T,
        rows[:, None] + reach(image.T).T,
    )


def aggregate(volume: Tensor, arms: Arms, partner: Arms, side: int) -> Tensor:
    """Cross-based cost aggregation, one round: means over the crosses that both views allow.

    A cross's region has the rows between a pixel's vertical arms, and of each the columns between
    the horizontal arms of its pixel in the same column.

    Args:
        volume: (D, H, W).
        arms: Arms of the left view.
        partner: Arms of the right view.
        side: Of the volume, see the module.
    """
    aggregated = volume.clone()
    width = volume.shape[-1]
    for d in range(min(len(volume), width)):
        # Columns with a partner, as an image of its own.
        first, other = (d, 0) if side < 0 else (0, d)
        own = [_columns(arm, first, width - d) for arm in arms]
        its = [_columns(arm, other, width - d) for arm in partner]
        left = torch.maximum(own[0] - first, its[0] - other)
        right = torch.minimum(own[1] - first, its[1] - other)
        up, down = torch.maximum(own[2], its[2]), torch.minimum(own[3], its[3])
        costs = _columns(volume[d], first, width - d).double()  # sums over whole rows
        sums = _between(costs, left, right, dim=1)
        total = _between(sums, up, down, dim=0)
        pixels = _between((right - left - 1).double(), up, down, dim=0)
        _columns(aggregated[d], first, width - d).copy_(total / pixels)
    return aggregated


def _columns(image: Tensor, first: int, count: int) -> Tensor:
    return image[:, first : first + count]


def _between(values: Tensor, start: Tensor, end: Tensor, dim: int) -> Tensor:
    """Sums over start < i < end along a dimension."""
    before = (0, 0, 1, 0) if dim == 0 else (1, 0)
    sums = F.pad(values.cumsum(dim), before)
    return sums.gather(dim, end) - sums.gather(dim, start + 1)


class Penalties(NamedTuple):
    """Penalties of semi-global matching (Sec. 4.2).

    Attributes:
        p1: For a change of the disparity by one.
        p2: For a larger change.
        q1: Divisor of both where one of the views has an intensity step.
        q2: Further divisor where both have.
        alpha: Divisor of p1 in the vertical passes, where the disparity grows downwards.
        step: Intensity difference of a step.
    """

    p1: float
    p2: float
    q1: float
    q2: float
    alpha: float
    step: float


def semi_global_matching(
    volume: Tensor, left: Tensor, right: Tensor, side: int, penalties: Penalties
) -> Tensor:
    """Mean of the matching costs along four directions (Sec. 4.2).

    Args:
        volume: (D, H, W).
        left: Intensities of the left view, (H, W).
        right: Intensities of the right view, likewise.
        side: Of the volume, see the module.
        penalties: Penalties.
    """
    p1, alpha = penalties.p1, penalties.alpha
    costs = volume.permute(1, 2, 0).contiguous()  # disparities side by side
    total = torch.zeros_like(costs)
    for dim in (0, 1):
        for backwards in (False, True):
            classes = step_classes(left, dim, backwards, penalties.step)[..., None]
            partner = step_classes(right, dim, backwards, penalties.step)
            steps = _at_partner(partner, len(volume), side)
            below = p1 / alpha if dim == 0 and not backwards else p1
            above = p1 / alpha if dim == 0 and backwards else p1
            _add_pass(total, costs, classes, steps, dim, backwards, (below, above), penalties)
    return (total / 4).permute(2, 0, 1).contiguous()


class SemiGlobalMatching(nn.Module):
    """`semi_global_matching` as a layer.

    Args:
        penalties: Penalties.
    """

    def __init__(self, penalties: Penalties) -> None:
        super().__init__()
        self.penalties = penalties

    def forward(self, volume: Tensor, left: Tensor, right: Tensor, side: int) -> Tensor:
        """See `semi_global_matching`."""
        return semi_global_matching(volume, left, right, side, self.penalties)


def step_classes(image: Tensor, dim: int, backwards: bool, step: float) -> Tensor:
    """0 for a smaller step from the predecessor, 1 for one as large, 2 for a larger: (H, W)."""
    steps = image.diff(dim=dim).abs()
    outside = torch.full_like(image.narrow(dim, 0, 1), OUTSIDE)
    parts = (steps, outside) if backwards else (outside, steps)
    steps = torch.cat(parts, dim=dim)
    return (steps >= step).to(torch.uint8) + (steps > step).to(torch.uint8)


def _at_partner(classes: Tensor, planes: int, side: int) -> Tensor:
    """Classes at the partner of every pixel at every disparity, (H, W, D); 2 outside."""
    if side < 0:
        return _at_partner(classes.flip(1), planes, 1).flip(1)
    return F.pad(classes, (0, planes - 1), value=2).unfold(1, planes, 1)


def _add_pass(
    total: Tensor,
    costs: Tensor,
    classes: Tensor,
    partner: Tensor,
    dim: int,
    backwards: bool,
    changes: tuple[float, float],
    penalties: Penalties,
) -> None:
    """Add the costs of one direction to ``total``, (H, W, D); ``changes`` from d - 1 and d + 1."""
    one = 1 / penalties.q1
    factors = costs.new_tensor([1, one, one, one, one / penalties.q2])
    order = range(costs.shape[dim])
    before = None
    for i in reversed(order) if backwards else order:
        value = costs.select(dim, i)
        if before is not None:
            both = classes.select(dim, i) + partner.select(dim, i)
            factor = factors[both.int()]
            lowest = before.amin(dim=1, keepdim=True)
            change = torch.minimum(
                before, torch.addcmul(lowest, factor, factor.new_tensor(penalties.p2))
            )
            torch.minimum(
                change[:, 1:], before[:, :-1] + changes[0] * factor[:, 1:], out=change[:, 1:]
            )
            torch.minimum(
                change[:, :-1], before[:, 1:] + changes[1] * factor[:, :-1], out=change[:, :-1]
            )
            value = value + change - lowest
        total.select(dim, i).add_(value)
        before = value
