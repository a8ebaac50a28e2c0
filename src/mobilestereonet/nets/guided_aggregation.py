"""The two layers of GA-Net: semi-global and local guided aggregation (Zhang et al., CVPR 2019)."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor, nn

DIRECTIONS = ("down", "up", "right", "left")
"""Directions of the semi-global aggregation, in the order of the guidance's channels."""

WINDOW = 5
"""Side of the local aggregation's window, in pixels."""

DEPTH = 3
"""Disparities in the local aggregation's window."""


class SemiGlobalAggregation(nn.Module):
    """SGA (Sec. 3.1): aggregation along four directions, by weights that a guidance gives."""

    def forward(self, cost: Tensor, guidance: Tensor) -> Tensor:
        """Aggregate a cost volume.

        Args:
            cost: (B, C, D, H, W).
            guidance: Weights (B, 20 C, H, W), as `direction_weights` takes them.

        Returns:
            The largest of the four directions for each element, (B, C, D, H, W).
        """
        weights = direction_weights(guidance, cost.shape[1])
        down, up, right, left = (
            aggregate(cost, each, name) for name, each in zip(DIRECTIONS, weights, strict=True)
        )
        return torch.maximum(torch.maximum(down, up), torch.maximum(right, left))


def direction_weights(guidance: Tensor, channels: int) -> list[Tensor]:
    """Weights of each direction, divided by the sum of their absolute values.

    Args:
        guidance: (B, 20 C, H, W): per direction and channel of the cost volume five weights.
        channels: C.

    Returns:
        (B, C, 5, H, W) for each of `DIRECTIONS`.
    """
    weights = guidance.unflatten(1, (len(DIRECTIONS), channels, 5))
    return [F.normalize(each, p=1, dim=2) for each in weights.unbind(1)]


def aggregate(cost: Tensor, weights: Tensor, direction: str) -> Tensor:
    """Aggregate along one direction (Eq. 5).

    A(p, d) = w0 C(p, d) + w1 A(q, d) + w2 A(q, d - 1) + w3 A(q, d + 1) + w4 max A(q, .), where q
    is the pixel before p. C(p, d) takes the place of what does not exist: all terms of A in the
    first row or column, w2's at the first disparity and w3's at the last.

    Args:
        cost: C, (B, C, D, H, W).
        weights: (B, C, 5, H, W); all disparities share them.
        direction: "down" has the row above as q, "up" the row below, "right" the column on the
            left, "left" the column on the right.

    Returns:
        A, (B, C, D, H, W).
    """
    dim = -2 if direction in ("down", "up") else -1
    lines = list(zip(cost.unbind(dim), weights.unbind(dim), strict=True))
    if direction in ("up", "left"):
        lines.reverse()
    first, w = lines[0]
    before = first * w.sum(dim=2, keepdim=True)
    aggregated = [before]
    for line, w in lines[1:]:  # (B, C, D, N) and (B, C, 5, N), N being all pixels of the line
        w0, w1, w2, w3, w4 = w.split(1, dim=2)
        lower = torch.cat((line[:, :, :1], before[:, :, :-1]), dim=2)
        higher = torch.cat((before[:, :, 1:], line[:, :, -1:]), dim=2)
        most = before.amax(dim=2, keepdim=True)
        before = w0 * line + w1 * before + w2 * lower + w3 * higher + w4 * most
        aggregated.append(before)
    if direction in ("up", "left"):
        aggregated.reverse()
    return torch.stack(aggregated, dim)


class LocalAggregation(nn.Module):
    """LGA (Sec. 3.2), twice in a row with the same weights."""

    def forward(self, volume: Tensor, guidance: Tensor) -> Tensor:
        """(B, D, H, W) and guidance (B, 75, H, W) -> (B, D, H, W)."""
        weights = F.normalize(guidance, p=1, dim=1)
        return self.aggregate(self.aggregate(volume, weights), weights)

    def aggregate(self, volume: Tensor, weights: Tensor) -> Tensor:
        """See `aggregate_locally`."""
        return aggregate_locally(volume, weights)


def aggregate_locally(volume: Tensor, weights: Tensor) -> Tensor:
    """Weighted sum over three disparities and 5 x 5 pixels around each element (Eq. 8).

    The centre's value takes the place of those outside the volume.

    Args:
        volume: (B, D, H, W).
        weights: (B, 75, H, W): channel (k 5 + i) 5 + j weighs disparity d + k - 1, row y + i - 2,
            column x + j - 2. All disparities share them.

    Returns:
        (B, D, H, W).
    """
    depth, height, width = volume.shape[1:]
    around = (WINDOW // 2, WINDOW // 2, WINDOW // 2, WINDOW // 2, DEPTH // 2, DEPTH // 2)
    values = F.pad(volume, around)
    inside = F.pad(torch.ones_like(volume[:1]), around).bool()
    total = torch.zeros_like(volume)
    for index, weight in enumerate(weights.split(1, dim=1)):
        k, i, j = index // WINDOW**2, index // WINDOW % WINDOW, index % WINDOW
        part = (slice(None), slice(k, k + depth), slice(i, i + height), slice(j, j + width))
        total = total + weight * torch.where(inside[part], values[part], volume)
    return total
