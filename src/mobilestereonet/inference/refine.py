"""Refinement by the picture: occluded pixels from their background, edges from the colours.

The networks decide at every fourth pixel, so edges come out some pixels off, and what one camera
alone sees is guesswork. Both can be mended without learning anything: what is unsure takes the
disparity of the farther sure neighbour, as semi-global matching fills its gaps, and near edges
each pixel takes the disparity that its neighbours of like colour agree on (a weighted median, as
in Ma et al., "Constant Time Weighted Median Filtering for Stereo Matching and Beyond", ICCV 2013,
over a few sparse neighbours).
"""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor

SURE = 0.35
"""Confidence from which a pixel keeps its disparity, and is a neighbour for others."""

SLACK = 4
"""Pixels by which an unsure gap may be wider than what occlusion hides."""

STEPS = (7, 4, 2, 1)
"""Distances in px of the 3 x 3 neighbours, one pass after the other."""

EDGE = 3.0
"""Pixels by which the neighbours' disparities differ at an edge."""

SAME = 1.0
"""Pixels within which two disparities are of one surface: a pixel's own is the finer one then."""

COLOUR = 0.1
"""Standard deviation of the colour (RGB in 0..1) within one surface."""

OWN_VOTE = 0.9
"""What a pixel's own vote counts: along a straight edge it would end in a draw with its side."""

OUTLIER = 8.0
"""Pixels beyond which a neighbour's disparity is just another one."""


def refine_disparity(disparity: Tensor, confidence: Tensor, views: Tensor) -> Tensor:
    """Refine disparities where they are unsure, and at their edges.

    Everywhere else they stay as they are.

    Args:
        disparity: Disparity in px, (B, H, W) float32.
        confidence: Its confidence in 0..1, (B, H, W), see `mobilestereonet.nets.confidence`.
        views: The views that it belongs to, (B, 3, H, W), RGB in 0..1.

    Returns:
        Disparity in px, (B, H, W).
    """
    disparity = _from_background(disparity, confidence >= SURE)
    weight = confidence.clamp(min=SURE)
    for step in STEPS:
        disparity = _by_colour(disparity, weight, views, step)
    return disparity


def _from_background(disparity: Tensor, sure: Tensor) -> Tensor:
    """Give unsure pixels the farther of the two nearest sure ones of their row.

    Where occlusion explains the gap between those: left of a nearer surface it is as wide as the
    step in disparity, at the left border as the disparity itself, elsewhere it is none. What is
    unsure over more pixels is hard to match.
    """
    width = disparity.shape[-1]
    column = torch.arange(width, device=disparity.device).expand_as(disparity)
    before = torch.where(sure, column, -1).cummax(-1).values
    after = torch.where(sure, column, width).flip(-1).cummin(-1).values.flip(-1)
    no_left, no_right = before < 0, after == width
    left = disparity.gather(-1, before.clamp(min=0))
    right = disparity.gather(-1, after.clamp(max=width - 1))
    farther = torch.where(no_left, right, torch.where(no_right, left, torch.minimum(left, right)))
    step = torch.where(no_right, 0, right - left.masked_fill(no_left, 0)).clamp(min=0)
    occluded = ~sure & (after - before - 1 <= step + SLACK)
    return torch.where(occluded & ~(no_left & no_right), farther, disparity)


def _by_colour(disparity: Tensor, weight: Tensor, views: Tensor, step: int) -> Tensor:
    """Give pixels at edges the disparity that costs least among their 3 x 3 neighbours'."""
    height, width = disparity.shape[-2:]
    maps = torch.cat((views, disparity.unsqueeze(1), weight.unsqueeze(1)), dim=1)
    pixels = maps.movedim(1, -1).reshape(-1, maps.shape[1])
    refined = disparity.flatten().clone()
    edges = torch.nonzero(_relief(disparity, step) > EDGE)
    for image, row, column in (some.unbind(1) for some in edges.split(_CACHED)):
        rows = [image * height + (row + y).clamp(0, height - 1) for y in (-step, 0, step)]
        columns = [(column + x).clamp(0, width - 1) for x in (-step, 0, step)]
        places = [y * width + x for y in rows for x in columns]
        around = torch.stack([pixels[place] for place in places])  # (9, pixels, 5)
        colours, candidates = around[..., :3], around[..., 3].contiguous()
        own, before = colours[4], candidates[4]
        unlike = (colours - own).square().sum(-1)
        votes = torch.exp(unlike / (-2 * COLOUR**2)) * around[..., 4]
        votes[4] *= OWN_VOTE
        best, least = before, torch.full_like(before, torch.inf)
        for one in candidates:
            cost = (candidates - one).abs_().clamp_(max=OUTLIER).mul_(votes).sum(0)
            best = torch.where(cost < least, one, best)
            least = torch.minimum(cost, least)
        refined[places[4]] = torch.where((best - before).abs() > SAME, best, before)
    return refined.view_as(disparity)


_CACHED = 1 << 15
"""Pixels whose neighbours stay in the processor's cache."""


def _relief(disparity: Tensor, step: int) -> Tensor:
    """By how much each pixel's 3 x 3 neighbours differ."""
    most = least = F.pad(disparity.unsqueeze(1), (step,) * 4, mode="replicate").squeeze(1)
    for dim in (-2, -1):
        length = disparity.shape[dim]
        high, low = (
            [m.narrow(dim, at, length) for at in (0, step, 2 * step)] for m in (most, least)
        )
        most = torch.maximum(torch.maximum(high[0], high[1]), high[2])
        least = torch.minimum(torch.minimum(low[0], low[1]), low[2])
    return most - least
