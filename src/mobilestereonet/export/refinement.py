"""The refinement of `inference.refine` and `inference.subpixel` as part of an exported graph.

Those work on the pixels that need it, this on whole maps, with the same result up to rounding: in
plain operators, for one pair, and without a size of the image in the graph.
"""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from mobilestereonet.inference.refine import (
    COLOUR_SIGMA,
    EDGE_STEP_PX,
    MATCHING_WEIGHT,
    MIN_CONFIDENCE,
    NEIGHBOUR_STEPS_PX,
    OCCLUSION_SLACK_PX,
    OUTSIDE_COST,
    OWN_WEIGHT,
    SAME_SURFACE_PX,
    VOTE_LIMIT_PX,
    matching_features,
)
from mobilestereonet.inference.subpixel import (
    CONTRAST_WINDOW_PX,
    MAX_SHIFT_PX,
    PRIOR,
    SENSOR_NOISE,
    STEPS,
    STRIDE_PX,
    WINDOW_PX,
    row_gradient,
    weighted_products,
)
from mobilestereonet.nets.model import Prediction

MAX_WIDTH_PX = 8192
"""Width of the views up to which a gap in a row is filled from wherever it ends."""


class Refinement(nn.Module):
    """Refines the prediction for one pair of RGB views whose sides are multiples of 4."""

    def __init__(self) -> None:
        super().__init__()
        self.vote_weights: Tensor
        weights = torch.ones(9, 1, 1)
        weights[4] = OWN_WEIGHT
        self.register_buffer("vote_weights", weights)

    def forward(self, prediction: Prediction, left: Tensor, right: Tensor) -> Prediction:
        """See `refine_disparity` and `fit_subpixel`.

        Args:
            prediction: Disparity in px and confidence, (1, H, W) each.
            left: Left view, (1, 3, H, W), RGB in 0..1.
            right: Right view, likewise.
        """
        disparity, confidence = prediction
        assert confidence is not None
        columns = _columns(left[:, 0])
        disparity = _fill_occlusions(disparity, confidence >= MIN_CONFIDENCE, columns)
        weight = confidence.clamp(min=MIN_CONFIDENCE)
        brightness = _normalise_contrast(left), _normalise_contrast(right)
        features = matching_features(brightness[0]), matching_features(brightness[1])
        for step in NEIGHBOUR_STEPS_PX:
            disparity = self._align_edges(disparity, weight, left, features, columns, step)
        return Prediction(_fit_subpixel(disparity, *brightness, columns), confidence)

    def _align_edges(
        self,
        disparity: Tensor,
        weight: Tensor,
        view: Tensor,
        features: tuple[Tensor, Tensor],
        columns: Tensor,
        step: int,
    ) -> Tensor:
        maps = torch.cat((view, disparity.unsqueeze(1), weight.unsqueeze(1)), dim=1)
        maps = F.pad(maps, (step,) * 4, mode="replicate")
        spans = (slice(-2 * step), slice(step, -step), slice(2 * step, None))
        around = torch.cat([maps[:, :, rows, across] for rows in spans for across in spans])
        candidates = around[:, 3]  # (9, H, W)
        distance = (around[:, :3] - view).square().sum(dim=1)
        votes = torch.exp(distance / (-2 * COLOUR_SIGMA**2)) * around[:, 4] * self.vote_weights
        votes = votes / (VOTE_LIMIT_PX * votes.sum(dim=0))
        best = lowest_cost = disparity
        for index in range(9):
            candidate = candidates[index : index + 1]
            difference = (candidates - candidate).abs().clamp(max=VOTE_LIMIT_PX)
            mismatch = _mismatch(candidate, *features, columns)
            cost = (difference * votes).sum(dim=0, keepdim=True) + MATCHING_WEIGHT * mismatch
            if index:
                best = torch.where(cost < lowest_cost, candidate, best)
                lowest_cost = torch.minimum(cost, lowest_cost)
            else:
                best, lowest_cost = candidate, cost
        moves = (best - disparity).abs() > SAME_SURFACE_PX
        return torch.where(_near_edges(disparity, step) & moves, best, disparity)


def _mismatch(disparity: Tensor, left: Tensor, right: Tensor, columns: Tensor) -> Tensor:
    """Matching cost of a disparity (1, H, W) by features (1, 3, H, W) of both views."""
    last = columns[..., -1:]
    match = columns - disparity
    inside = (match >= 0) & (match <= last)
    nearest = torch.minimum(match.clamp(min=0), last).round().long().unsqueeze(1)
    matched = right.gather(-1, torch.cat((nearest, nearest, nearest), dim=1))
    return torch.where(inside, (matched - left).abs().mean(dim=1).clamp(max=1), OUTSIDE_COST)


def _near_edges(disparity: Tensor, step: int) -> Tensor:
    """Whether pixels lie within so many rows and columns of a step in disparity."""
    maps = torch.cat((disparity, -disparity)).unsqueeze(0)
    span = F.max_pool2d(maps, 3, 1, 1).sum(dim=1)
    edges = (span > EDGE_STEP_PX).to(disparity.dtype)
    return F.max_pool2d(edges, 2 * step + 1, 1, step) > 0


def _fill_occlusions(disparity: Tensor, confident: Tensor, column: Tensor) -> Tensor:
    width = column[..., -1:] + 1
    before = _running_max(torch.where(confident, column, -1.0))
    after = -_running_max(torch.where(confident, -column, -width).flip(-1), lowest=-1e9).flip(-1)
    no_left, no_right = before < 0, after >= width
    left = disparity.gather(-1, before.clamp(min=0).long())
    right = disparity.gather(-1, torch.minimum(after, width - 1).long())
    farther = torch.where(no_left, right, torch.where(no_right, left, torch.minimum(left, right)))
    step = torch.where(no_right, 0.0, right - torch.where(no_left, 0.0, left)).clamp(min=0)
    occluded = ~confident & (after - before - 1 <= step + OCCLUSION_SLACK_PX)
    return torch.where(occluded & ~(no_left & no_right), farther, disparity)


def _columns(like: Tensor) -> Tensor:
    """The number of each pixel's column, in a map (1, H, W).

    Computed from the map's values: ones of its shape would be a constant of the graph.
    """
    return (like * 0 + 1).cumsum(dim=-1) - 1


def _running_max(values: Tensor, lowest: float = -1.0) -> Tensor:
    """The largest value up to each one in its row."""
    step = 1
    while step < MAX_WIDTH_PX:
        values = torch.maximum(values, F.pad(values, (step, 0), value=lowest)[..., :-step])
        step *= 2
    return values


def _fit_subpixel(disparity: Tensor, left: Tensor, right: Tensor, columns: Tensor) -> Tensor:
    left_gradient = row_gradient(left)
    right_maps = torch.cat((right, row_gradient(right)), dim=1)
    shift = columns * 0
    for _ in range(STEPS):
        position = columns - disparity - shift
        inside = ((position >= 0) & (position <= columns[..., -1:])).unsqueeze(1)
        warped = _sample(right_maps, position.unsqueeze(1), columns[..., -1:].unsqueeze(1))
        sums = F.avg_pool2d(
            weighted_products(left, left_gradient, warped, inside, shift),
            *(WINDOW_PX, STRIDE_PX, (WINDOW_PX - STRIDE_PX) // 2),
            count_include_pad=False,
        )
        shift = sums[:, :1] / (sums[:, 1:] + PRIOR)
        shift = F.interpolate(shift, scale_factor=float(STRIDE_PX), mode="bilinear").squeeze(1)
        shift = shift.clamp(-MAX_SHIFT_PX, MAX_SHIFT_PX)
    return (disparity + shift).clamp(min=0)


def _normalise_contrast(view: Tensor) -> Tensor:
    grey = view.mean(dim=1, keepdim=True)
    moments = torch.cat((grey, grey.square()), dim=1)
    moments = F.pad(moments, (CONTRAST_WINDOW_PX // 2,) * 4, mode="replicate")
    mean, square = F.avg_pool2d(moments, CONTRAST_WINDOW_PX, 1).split(1, dim=1)
    variance = (square - mean.square()).clamp(min=0)
    normalised: Tensor = (grey - mean) / (variance + SENSOR_NOISE**2).sqrt()
    return normalised


def _sample(maps: Tensor, position: Tensor, last: Tensor) -> Tensor:
    """Maps (1, 2, H, W) at other columns of each row, (1, 1, H, W), between 0 and the last."""
    position = torch.minimum(position.clamp(min=0), last)
    low = position.floor()
    between = position - low
    high = torch.minimum(low + 1, last)
    at_low, at_high = (
        maps.gather(-1, torch.cat((index, index), dim=1)) for index in (low.long(), high.long())
    )
    return at_low + between * (at_high - at_low)
