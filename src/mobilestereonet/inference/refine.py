"""Image-guided disparity refinement: fills occlusions, and moves edges to those of the colours.

The networks decide at every fourth pixel, so edges come out some pixels off, and what one camera
alone sees is guesswork. Both can be corrected without learning anything: a pixel of low confidence
takes the disparity of the farther confident neighbour in its row, as semi-global matching fills
its gaps, and near edges each pixel takes the disparity that its neighbours of like colour agree on
(a weighted median, as in Ma et al., "Constant Time Weighted Median Filtering for Stereo Matching
and Beyond", ICCV 2013, over a few sparse neighbours).

Everything runs on the device of the disparity.
"""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor

MIN_CONFIDENCE = 0.35
"""Confidence (0..1) from which a pixel keeps its disparity, and is a neighbour for others."""

OCCLUSION_SLACK_PX = 4
"""Pixels by which a gap of low confidence may be wider than what occlusion explains."""

NEIGHBOUR_STEPS_PX = (7, 4, 2, 1)
"""Distances of the 3 x 3 neighbours that vote, one pass after the other."""

EDGE_STEP_PX = 3.0
"""Difference in disparity within the 3 x 3 neighbours above which a pixel lies near an edge."""

SAME_SURFACE_PX = 1.0
"""A pixel keeps its own disparity if the vote differs by no more: its own is the finer one."""

COLOUR_SIGMA = 0.1
"""Standard deviation of the colour (RGB in 0..1) within one surface."""

OWN_WEIGHT = 0.9
"""Weight of a pixel's own vote: with 1, a vote along a straight edge would end in a draw."""

VOTE_LIMIT_PX = 8.0
"""Difference in disparity at which the cost of disagreeing with a neighbour is cut off."""

_CHUNK_CPU, _CHUNK_GPU = 1 << 15, 1 << 20
"""Edge pixels per step: on a CPU as many as keep their neighbours in its cache."""


def refine_disparity(disparity: Tensor, confidence: Tensor, views: Tensor) -> Tensor:
    """Refine disparities where their confidence is low, and at their edges.

    Everywhere else they stay as they are.

    Args:
        disparity: Disparity in px, (B, H, W) float32.
        confidence: Its confidence in 0..1, (B, H, W), on the same device.
        views: The views that it belongs to, (B, 3, H, W), RGB in 0..1, on the same device.

    Returns:
        Disparity in px, (B, H, W), on that device.
    """
    disparity = _fill_occlusions(disparity, confidence >= MIN_CONFIDENCE)
    weight = confidence.clamp(min=MIN_CONFIDENCE)
    for step in NEIGHBOUR_STEPS_PX:
        disparity = _align_edges(disparity, weight, views, step)
    return disparity


def _fill_occlusions(disparity: Tensor, confident: Tensor) -> Tensor:
    """Fill gaps in each row with the farther of the two confident pixels beside them.

    Only gaps that occlusion explains are filled: left of a nearer surface an occlusion is as wide
    as the step in disparity, at the left border as wide as the disparity itself, elsewhere there
    is none. Wider gaps are pixels that are hard to match, not hidden ones.
    """
    width = disparity.shape[-1]
    column = torch.arange(width, device=disparity.device).expand_as(disparity)
    before = torch.where(confident, column, -1).cummax(-1).values
    after = torch.where(confident, column, width).flip(-1).cummin(-1).values.flip(-1)
    no_left, no_right = before < 0, after == width
    left = disparity.gather(-1, before.clamp(min=0))
    right = disparity.gather(-1, after.clamp(max=width - 1))
    farther = torch.where(no_left, right, torch.where(no_right, left, torch.minimum(left, right)))
    step = torch.where(no_right, 0, right - left.masked_fill(no_left, 0)).clamp(min=0)
    occluded = ~confident & (after - before - 1 <= step + OCCLUSION_SLACK_PX)
    return torch.where(occluded & ~(no_left & no_right), farther, disparity)


def _align_edges(disparity: Tensor, weight: Tensor, views: Tensor, step: int) -> Tensor:
    """Give pixels near edges the disparity that costs least among their 3 x 3 neighbours'."""
    height, width = disparity.shape[-2:]
    maps = torch.cat((views, disparity.unsqueeze(1), weight.unsqueeze(1)), dim=1)
    pixels = maps.movedim(1, -1).reshape(-1, maps.shape[1])  # (B H W, 5): RGB, disparity, weight
    refined = disparity.flatten().clone()
    chunk = _CHUNK_CPU if disparity.device.type == "cpu" else _CHUNK_GPU
    edges = _edge_pixels(disparity, step)
    for image, row, column in (part.unbind(1) for part in edges.split(chunk)):
        rows = [image * height + (row + y).clamp(0, height - 1) for y in (-step, 0, step)]
        columns = [(column + x).clamp(0, width - 1) for x in (-step, 0, step)]
        places = [y * width + x for y in rows for x in columns]
        around = torch.stack([pixels[place] for place in places])  # (9, pixels, 5)
        colours, candidates = around[..., :3], around[..., 3].contiguous()
        own_colour, own = colours[4], candidates[4]
        distance = (colours - own_colour).square().sum(-1)
        votes = torch.exp(distance / (-2 * COLOUR_SIGMA**2)) * around[..., 4]
        votes[4] *= OWN_WEIGHT
        best, lowest_cost = own, torch.full_like(own, torch.inf)
        for candidate in candidates:
            difference = (candidates - candidate).abs_().clamp_(max=VOTE_LIMIT_PX)
            cost = difference.mul_(votes).sum(0)
            best = torch.where(cost < lowest_cost, candidate, best)
            lowest_cost = torch.minimum(cost, lowest_cost)
        refined[places[4]] = torch.where((best - own).abs() > SAME_SURFACE_PX, best, own)
    return refined.view_as(disparity)


def _edge_pixels(disparity: Tensor, step: int) -> Tensor:
    """Image, row and column of each pixel near an edge, (N, 3)."""
    return torch.nonzero(_range_of_neighbours(disparity, step) > EDGE_STEP_PX)


def _range_of_neighbours(disparity: Tensor, step: int) -> Tensor:
    """Largest minus smallest disparity of each pixel's 3 x 3 neighbours."""
    largest = smallest = F.pad(disparity.unsqueeze(1), (step,) * 4, mode="replicate").squeeze(1)
    for dim in (-2, -1):
        length = disparity.shape[dim]
        high, low = (
            [m.narrow(dim, at, length) for at in (0, step, 2 * step)] for m in (largest, smallest)
        )
        largest = torch.maximum(torch.maximum(high[0], high[1]), high[2])
        smallest = torch.minimum(torch.minimum(low[0], low[1]), low[2])
    return largest - smallest
