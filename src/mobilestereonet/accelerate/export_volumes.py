"""Cost volumes and guidance for export: in tensors of four dimensions, without a fixed size."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from mobilestereonet.accelerate.planewise import PlanewiseLearnedVolume
from mobilestereonet.nets.coarse_pass import BAND_STEP, scaled_log_probability
from mobilestereonet.nets.cost_volumes import Correlation, LearnedVolume

BLOCK_PLANES = 4
"""Disparities that go through the cost volume together; divides the number of every network."""


def guidance_in_four_dimensions(scores: Tensor) -> Tensor:
    """As `nets.coarse_pass.guidance_from_scores`, on tensors of four dimensions."""
    likely = F.interpolate(scaled_log_probability(scores), scale_factor=2.0, mode="bilinear")
    # Along the disparities: even planes, odd planes, then in order.
    below = torch.cat((likely[:, :1], likely[:, :-1]), dim=1)
    above = torch.cat((likely[:, 1:], likely[:, -1:]), dim=1)
    planes = torch.cat((0.75 * likely + 0.25 * below, 0.75 * likely + 0.25 * above), dim=1)
    order = torch.arange(planes.shape[1], device=planes.device).reshape(2, -1).t().flatten()
    return planes.index_select(1, order).to(scores.dtype)


def fill_without_sizes(views: Tensor) -> Tensor:
    """As `nets.coarse_pass.fill`, with the new size computed from the values of the views."""
    for axis in (2, 3):
        place = places(views, axis)
        # One value for each block of 32 rows or columns, the last of which may have 16, and 32 of
        # each value: as long as the filled axis.
        blocks = F.max_pool1d(F.pad(place, (0, 16))[None, None], 32)
        filled = places(F.interpolate(blocks, scale_factor=32.0), 2)
        views = views.index_select(axis, torch.minimum(filled, place[-1]).long())
    return views


def cut_to(maps: Tensor, like: Tensor) -> Tensor:
    """The first rows and columns of maps (1, D, H, W), as many as another map has."""
    for axis in (2, 3):
        maps = maps.index_select(axis, places(like, axis).long())
    return maps


def places(like: Tensor, axis: int) -> Tensor:
    """0, 1, 2, ... along an axis of a tensor, float32.

    Computed from its values: ones of its shape would be a constant of the graph.
    """
    first = [slice(None) if each == axis else 0 for each in range(like.ndim)]
    return (like[tuple(first)].float() * 0 + 1).cumsum(dim=0) - 1


class BlockwiseLearnedVolume(PlanewiseLearnedVolume):
    """`LearnedVolume` without batch norms, in 2D convolutions, a few planes at a time.

    A block has the columns from its first plane's first on, so that only a small corner, where
    its planes begin one after the other, needs a mask.
    """

    def __init__(self, volume: LearnedVolume) -> None:
        super().__init__(volume)
        self.starts: Tensor
        self.corner: Tensor
        like: dict[str, Any] = {"dtype": self.left.weight.dtype, "device": self.left.weight.device}
        triangle = torch.triu(torch.ones(BLOCK_PLANES, BLOCK_PLANES, **like))
        self.register_buffer("starts", torch.eye(BLOCK_PLANES, **like)[:, None, None])
        self.register_buffer("corner", triangle[:, None, None])

    def forward(self, left: Tensor, right: Tensor, planes: int) -> Iterator[Tensor]:
        """(1, 32, H, W) twice -> blocks of so many planes together, (4, 1, H, W)."""
        count, block = planes, BLOCK_PLANES
        left_share, right_share = self.left(left), self.right(right)
        first = self.left_first(F.pad(left, (0, 1))[..., : count + 1])
        last = self.right_last(F.pad(right, (1, 0))[..., -count - 1 :])
        right_corner = F.pad(right_share[..., :block], (block - 1, 0))
        right_corner = torch.cat(
            [right_corner[..., block - 1 - i : 2 * block - 1 - i] for i in range(block)]
        )
        for a in range(0, count, block):
            b = a + block
            starts = torch.where(self.starts > 0, first[..., a:b], left_share[..., a:b])
            inner = torch.cat([right_share[..., b - i : -1 - i] for i in range(a, b)])
            end = torch.cat([last[..., count - 1 - i : count - i] for i in range(a, b)])
            corner = (starts + right_corner) * self.corner
            columns = (corner, left_share[..., b:-1] + inner, left_share[..., -1:] + end)
            x = F.relu(torch.cat(columns, dim=-1))
            for layer in (self.second, self.third, self.squeeze):
                x = self._masked(layer(x))
            yield F.pad(x, (a, 0))

    def _masked(self, x: Tensor) -> Tensor:
        return torch.cat((x[..., :BLOCK_PLANES] * self.corner, x[..., BLOCK_PLANES:]), dim=-1)


class BlockwiseCorrelation(nn.Module):
    """`Correlation` in tensors of four dimensions."""

    def __init__(self, volume: Correlation, channels: int, like: Tensor) -> None:
        super().__init__()
        # A convolution and no mean over a reshaped tensor, which would need to know its size.
        self.mean = nn.Conv2d(channels, volume.groups, 1, groups=volume.groups, bias=False)
        nn.init.constant_(self.mean.weight, volume.groups / channels)
        self.mean.to(like.device, like.dtype)

    def forward(self, left: Tensor, right: Tensor, planes: int) -> Iterator[Tensor]:
        """(1, C, H, W) twice -> so many planes (1, groups, H, W)."""
        yield self.mean(left * right)
        for i in range(1, planes):
            yield F.pad(self.mean(left[..., i:] * right[..., :-i]), (i, 0))


def banded(volume: list[Tensor], start: Tensor, planes: int) -> Iterator[Tensor]:
    """Planes of each pixel's band, chosen from all planes: that needs no size of the image.

    Args:
        volume: All planes, (1, groups, H, W) each.
        start: First plane of each pixel's band, (1, H, W), see `band_start`.
        planes: Planes of a band.

    Yields:
        Planes (1, groups, H, W).
    """
    for i in range(planes):
        plane = volume[i]
        for first in range(BAND_STEP, len(volume) - planes + 1, BAND_STEP):
            plane = torch.where(start.unsqueeze(1) == first, volume[first + i], plane)
        yield plane
