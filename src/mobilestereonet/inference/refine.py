"""Image-guided disparity refinement: fills occlusions, and moves edges to those of the views.

The networks decide at every fourth pixel, so edges come out some pixels off, and what one camera
alone sees is guesswork. Both can be corrected without learning anything: a pixel of low confidence
takes the disparity of the farther confident neighbour in its row, as semi-global matching fills
its gaps, and near edges each pixel chooses, among its own disparity and those of eight sparse
neighbours, the one of lowest cost: how far these nine disagree with it, weighted by confidence and
likeness in colour (a weighted median, as in Ma et al., "Constant Time Weighted Median Filtering for
Stereo Matching and Beyond", ICCV 2013, with differences cut off), and how badly the views match at
it.

Everything runs on the device of the disparity.
"""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor

from mobilestereonet.inference.subpixel import column_gradient, normalise_contrast, row_gradient

MIN_CONFIDENCE = 0.35
"""Confidence (0..1) from which a pixel keeps its disparity, and is a neighbour for others."""

OCCLUSION_SLACK_PX = 4
"""Pixels by which a gap of low confidence may be wider than what occlusion explains."""

NEIGHBOUR_STEPS_PX = (7, 7, 4, 2, 1)
"""Distances of a pixel's eight neighbours in rows and columns, one pass after the other."""

EDGE_STEP_PX = 3.0
"""Difference in disparity among 3 x 3 adjacent pixels above which they lie at an edge.

A pass whose neighbours are n px away looks at the pixels within n rows and columns of an edge.
"""

SAME_SURFACE_PX = 1.0
"""A pixel keeps its own disparity if the cheapest one differs by no more: its own is finer."""

COLOUR_SIGMA = 0.07
"""Standard deviation of the colour (RGB in 0..1) within one surface."""

OWN_WEIGHT = 0.9
"""Weight of a pixel's own disparity: with 1, a straight edge of one colour would be a draw."""

VOTE_LIMIT_PX = 4.0
"""Difference in disparity at which the cost of disagreeing with a neighbour is cut off."""

MATCHING_WEIGHT = 0.4
"""Weight of the matching cost against that of disagreeing with the neighbours, both in 0..1."""

FEATURE_LIMIT = 2.0
"""Features of the matching cost are cut off here: strong edges count no more than texture."""

OUTSIDE_COST = 0.5
"""Matching cost (0: alike) of a disparity whose match would lie outside of the right view."""

_CHUNK_CPU, _CHUNK_GPU = 1 << 15, 1 << 20
"""Edge pixels per step: on a CPU as many as keep their neighbours in its cache."""


def refine_disparity(disparity: Tensor, confidence: Tensor, left: Tensor, right: Tensor) -> Tensor:
    """Refine disparities where their confidence is low, and at their edges.

    Everywhere else they stay as they are.

    Args:
        disparity: Disparity of the left views in px, (B, H, W) float32.
        confidence: Its confidence in 0..1, (B, H, W), on the same device.
        left: Left views, (B, 3, H, W), RGB in 0..1, on the same device.
        right: Right views, likewise.

    Returns:
        Disparity in px, (B, H, W), on that device.
    """
    disparity = _fill_occlusions(disparity, confidence >= MIN_CONFIDENCE)
    weight = confidence.clamp(min=MIN_CONFIDENCE)
    features = [matching_features(normalise_contrast(views)) for views in (left, right)]
    for step in NEIGHBOUR_STEPS_PX:
        disparity = _align_edges(disparity, weight, left, features, step)
    return disparity


def matching_features(brightness: Tensor) -> Tensor:
    """Features of the matching cost: brightness and twice its gradient.

    Args:
        brightness: Brightness of normalised contrast, (B, 1, H, W).

    Returns:
        (B, 3, H, W): brightness, gradient along the rows and along the columns.
    """
    gradients = 2 * row_gradient(brightness), 2 * column_gradient(brightness)
    return torch.cat((brightness, *gradients), dim=1).clamp(-FEATURE_LIMIT, FEATURE_LIMIT)


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


def _align_edges(
    disparity: Tensor, weight: Tensor, view: Tensor, features: list[Tensor], step: int
) -> Tensor:
    """Give pixels near edges the disparity that costs least among their 3 x 3 neighbours'."""
    height, width = disparity.shape[-2:]
    pixels = _in_a_row(torch.cat((view, disparity.unsqueeze(1), weight.unsqueeze(1)), dim=1))
    left_features, right_features = map(_in_a_row, features)
    refined = disparity.flatten().clone()
    chunk = _CHUNK_CPU if disparity.device.type == "cpu" else _CHUNK_GPU
    edges = _edge_pixels(disparity, step)
    for image, row, column in (part.unbind(1) for part in edges.split(chunk)):
        rows = [image * height + (row + y).clamp(0, height - 1) for y in (-step, 0, step)]
        columns = [(column + x).clamp(0, width - 1) for x in (-step, 0, step)]
        places = [y * width + x for y in rows for x in columns]
        around = torch.stack([_at(pixels, place) for place in places])  # (9, 5, N)
        colours, candidates = around[:, :3], around[:, 3].contiguous()
        own_colour, own = colours[4], candidates[4]
        distance = (colours - own_colour).square().sum(1)
        votes = torch.exp(distance / (-2 * COLOUR_SIGMA**2)) * around[:, 4]
        votes[4] *= OWN_WEIGHT
        votes /= VOTE_LIMIT_PX * votes.sum(0)
        own_features = _at(left_features, places[4])
        best, lowest_cost = own, torch.full_like(own, torch.inf)
        for candidate in candidates:
            difference = (candidates - candidate).abs_().clamp_(max=VOTE_LIMIT_PX)
            cost = difference.mul_(votes).sum(0)
            match = column - candidate
            inside = (match >= 0) & (match <= width - 1)
            nearest = match.nan_to_num_().clamp_(0, width - 1).round_().long()
            matched = _at(right_features, rows[1] * width + nearest)
            mismatch = matched.sub_(own_features).abs_().mean(0)
            cost += MATCHING_WEIGHT * torch.where(inside, mismatch.clamp_(max=1), OUTSIDE_COST)
            best = torch.where(cost < lowest_cost, candidate, best)
            lowest_cost = torch.minimum(cost, lowest_cost)
        refined[places[4]] = torch.where((best - own).abs() > SAME_SURFACE_PX, best, own)
    return refined.view_as(disparity)


def _in_a_row(maps: Tensor) -> Tensor:
    """Maps (B, C, H, W) with all pixels in a row, (C, B H W)."""
    return maps.transpose(0, 1).flatten(1)


def _at(pixels: Tensor, places: Tensor) -> Tensor:
    """Values (C, N) of some pixels among (C, B H W)."""
    return pixels.gather(1, places.expand(len(pixels), -1))


def _edge_pixels(disparity: Tensor, step: int) -> Tensor:
    """Image, row and column of each pixel near an edge, (N, 3)."""
    return torch.nonzero(_dilated(_range_of_neighbours(disparity) > EDGE_STEP_PX, step))


def _range_of_neighbours(disparity: Tensor) -> Tensor:
    """Largest minus smallest disparity of each pixel's 3 x 3 neighbours."""
    largest = smallest = F.pad(disparity.unsqueeze(1), (1,) * 4, mode="replicate").squeeze(1)
    for dim in (-2, -1):
        length = disparity.shape[dim]
        high, low = ([m.narrow(dim, at, length) for at in range(3)] for m in (largest, smallest))
        largest = torch.maximum(torch.maximum(high[0], high[1]), high[2])
        smallest = torch.minimum(torch.minimum(low[0], low[1]), low[2])
    return largest - smallest


def _dilated(mask: Tensor, reach: int) -> Tensor:
    """Pixels (B, H, W) within so many rows and columns of those of a mask."""
    mask, side = F.pad(mask, (reach,) * 4), 2 * reach + 1
    for dim in (-2, -1):
        covered = 1  # pixels in a row that each value stands for
        while covered < side:
            move = min(covered, side - covered)
            length = mask.shape[dim] - move
            mask = mask.narrow(dim, 0, length) | mask.narrow(dim, move, length)
            covered += move
    return mask
