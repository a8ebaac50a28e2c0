"""Cost volumes: similarity of the left view and the shifted right view, per disparity.

All planes are computed in one batch. Plane i compares left column x with right column x - i at a
quarter of the resolution; the columns x < i, which have no partner, are zero. In eval mode every
volume equals the authors' loop over disparities. In training, batch norm statistics are taken
once, over all disparities, without the columns left of each disparity (the authors' loop updates
them once per disparity).
"""

from __future__ import annotations

from collections.abc import Callable

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from mobilestereonet.nets.blocks import conv_norm
from mobilestereonet.nets.config import REDUCED_CHANNELS, CostVolume, NetConfig

_KERNEL_DEPTHS: dict[CostVolume, tuple[int, int, int]] = {
    "interlaced-1": (2, 8, 4),
    "interlaced-2": (4, 4, 4),
    "interlaced-4": (8, 4, 2),
    "interlaced-8": (16, 2, 2),
    "interlaced-16": (32, 2, 1),
    "concatenation": (8, 4, 2),
}
"""Depths of the three kernels, each also its stride. Only the first ones are the paper's."""


def _stack_planes(plane: Callable[[int], Tensor], planes: int, width: int, dim: int) -> Tensor:
    """Stack plane(i), whose columns i .. width - 1 are given, with zero columns on the left."""
    cropped = [F.pad(plane(i), (i, 0)) for i in range(min(planes, width))]
    empty = torch.zeros_like(cropped[0])
    return torch.stack(cropped + [empty] * (planes - len(cropped)), dim=dim)


class Correlation(nn.Module):
    """Mean product of left and shifted right features, over all channels or per group."""

    def __init__(self, planes: int, groups: int = 1) -> None:
        super().__init__()
        self.planes = planes
        self.groups = groups

    def forward(self, left: Tensor, right: Tensor) -> Tensor:
        """(B, C, H, W) twice -> (B, groups, D, H, W)."""
        width = left.shape[-1]

        def plane(i: int) -> Tensor:
            products = left[..., i:] * right[..., : width - i]
            return products.unflatten(1, (self.groups, -1)).mean(dim=2)

        return _stack_planes(plane, self.planes, width, dim=2)


class LearnedVolume(nn.Module):
    """Interlacing cost volume (the paper's Sec. 3.2, Fig. 5), and concatenation likewise.

    The channels of both views, interlaced (L0 R0 L1 R1 ...) or one view after the other, form
    the depth of a one-channel volume. Three 3D convolutions, whose kernels reach as deep as their
    strides, and a 1x1 convolution turn it into one plane per disparity.

    The first convolution is linear, so each view's share is computed once and shifted. Only its
    borders need care: the convolution sees zeros beyond the cropped pair, hence the shares at the
    crop's border columns are those of a kernel without its outer column.
    """

    def __init__(self, planes: int, kind: CostVolume) -> None:
        super().__init__()
        self.planes = planes
        self.interlaced = kind != "concatenation"
        channels = (1, 16, 32, 16)
        self.conv = nn.ModuleList(
            nn.Conv3d(inputs, outputs, (depth, 3, 3), stride=(depth, 1, 1), padding=(0, 1, 1))
            for inputs, outputs, depth in zip(
                channels[:-1], channels[1:], _KERNEL_DEPTHS[kind], strict=True
            )
        )
        self.norm = nn.ModuleList(nn.BatchNorm3d(outputs) for outputs in channels[1:])
        self.squeeze = conv_norm(2, 16, 1, kernel=1)

    def forward(self, left: Tensor, right: Tensor) -> Tensor:
        """(B, 32, H, W) twice -> (B, 1, D, H, W)."""
        batch, _, _, width = left.shape
        x = self._activate(self.norm[0], self._first(left, right), width)
        for conv, norm in zip(self.conv[1:], self.norm[1:], strict=True):
            x = self._activate(norm, conv(x), width)
        x = self._activate(self.squeeze[1], self.squeeze[0](x.squeeze(2)), width)
        return x.unflatten(0, (batch, self.planes)).transpose(1, 2)

    def _first(self, left: Tensor, right: Tensor) -> Tensor:
        """First convolution of every plane: (B, 32, H, W) twice -> (B D, 16, depth, H, W)."""
        conv = self.conv[0]
        width = left.shape[-1]
        weight = conv.weight.squeeze(1)  # (16, k, 3, 3)
        depth = 2 * REDUCED_CHANNELS // weight.shape[1]
        # One row of output depth per group of k input channels: a block-diagonal kernel.
        groups = torch.eye(depth, dtype=weight.dtype, device=weight.device)
        full = groups[:, None, :, None, None, None] * weight[None, :, None]
        full = full.flatten(2, 3)  # (depth, 16, 64, 3, 3)
        if self.interlaced:
            weights = full[:, :, 0::2], full[:, :, 1::2]
        else:
            weights = full.split(REDUCED_CHANNELS, dim=2)

        def share(view: Tensor, weight: Tensor, columns: slice, bias: Tensor | None) -> Tensor:
            kernel = weight.flatten(0, 1)[..., columns]
            outer = (int(columns.start is None), int(columns.stop is None))
            y = F.conv2d(F.pad(view, (*outer, 1, 1)), kernel, bias)
            return y.unflatten(1, (depth, -1)).transpose(1, 2)  # (B, 16, depth, H, W)

        every, no_first, no_last = slice(None), slice(1, None), slice(None, 2)
        bias = conv.bias.repeat(depth)
        ours = share(left, weights[0], every, bias)
        ours_first = share(left, weights[0], no_first, bias)
        theirs = share(right, weights[1], every, None)
        theirs_last = share(right, weights[1], no_last, None)

        def plane(i: int) -> Tensor:
            if i == 0:
                return ours + theirs
            end = width - i
            columns = torch.cat((ours_first[..., i : i + 1], ours[..., i + 1 :]), dim=-1)
            partners = torch.cat((theirs[..., : end - 1], theirs_last[..., end - 1 : end]), dim=-1)
            return columns + partners

        return _stack_planes(plane, self.planes, width, dim=1).flatten(0, 1)

    def _activate(self, norm: nn.Module, x: Tensor, width: int) -> Tensor:
        """Batch norm and ReLU on the columns that have a partner, zero elsewhere.

        (B D, C, ..., H, W) -> the same shape.
        """
        if not norm.training:
            column = torch.arange(width, device=x.device)
            plane = torch.arange(self.planes, device=x.device)
            mask = (column >= plane[:, None]).to(x.dtype)
            shape = (self.planes, *[1] * (x.dim() - 2), width)
            y = F.relu(norm(x)).unflatten(0, (-1, self.planes))
            return (y * mask.view(shape)).flatten(0, 1)
        # The columns with a partner are packed side by side, so that an ordinary batch norm
        # (synchronised or not) takes its statistics from them alone.
        planes = x.unflatten(0, (-1, self.planes)).unbind(1)
        packed = torch.cat([plane[..., i:] for i, plane in enumerate(planes[:width])], dim=-1)
        parts = F.relu(norm(packed)).split([width - i for i in range(min(self.planes, width))], -1)
        return _stack_planes(lambda i: parts[i], self.planes, width, dim=1).flatten(0, 1)


def build_cost_volume(config: NetConfig) -> Correlation | LearnedVolume:
    """The cost volume that ``config`` names: (B, C, H, W) twice -> (B, channels, D, H, W)."""
    if config.learns_volume:
        return LearnedVolume(config.planes, config.cost_volume)
    return Correlation(config.planes, config.volume_channels)
