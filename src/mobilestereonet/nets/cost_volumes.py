"""Cost volumes: similarity of the left view and the shifted right view, per disparity.

All planes are computed in one batch. Plane i compares left column x with right column x - i at a
quarter of the resolution; the columns x < i, which have no partner, are zero. In eval mode every
volume equals the authors' loop over disparities. In training, batch norm statistics are taken
once, over all disparities, without the columns left of each disparity (the authors' loop updates
them once per disparity).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, cast

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


def _pad_left(parts: Sequence[Tensor], planes: int) -> list[Tensor]:
    """Parts of width W, W - 1 ... -> planes of width W, zero on the left, and where one lacks."""
    width = parts[0].shape[-1]
    padded = [F.pad(part, (width - part.shape[-1], 0)) for part in parts]
    return padded + [torch.zeros_like(padded[0])] * (planes - len(parts))


def _widths(planes: int, width: int) -> list[int]:
    return [width - i for i in range(min(planes, width))]


class _Pack(torch.autograd.Function):
    """(D B, ..., W) -> (B, ..., P): the columns x >= i of every plane i, side by side."""

    @staticmethod
    def forward(ctx: Any, x: Tensor, planes: int) -> Tensor:
        ctx.planes, ctx.width = planes, x.shape[-1]
        parts = x.chunk(planes)[: ctx.width]
        return torch.cat([plane[..., i:] for i, plane in enumerate(parts)], dim=-1)

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor, None]:
        parts = torch.split(grads[0], _widths(ctx.planes, ctx.width), dim=-1)
        return torch.cat(_pad_left(parts, ctx.planes)), None


class _Unpack(torch.autograd.Function):
    """(B, ..., P) -> (D B, ..., W): the inverse of `_Pack`, zero elsewhere."""

    @staticmethod
    def forward(ctx: Any, x: Tensor, planes: int, width: int) -> Tensor:
        ctx.planes = planes
        return torch.cat(_pad_left(torch.split(x, _widths(planes, width), dim=-1), planes))

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor, None, None]:
        return _Pack.forward(ctx, grads[0], ctx.planes), None, None


class _ShiftedSums(torch.autograd.Function):
    """The packed planes of `_shifted_sum`, spared the slow backward pass of their slices."""

    @staticmethod
    def forward(ctx: Any, planes: int, *shares: Tensor) -> Tensor:
        ctx.widths = _widths(planes, shares[0].shape[-1])
        return torch.cat([_shifted_sum(i, *shares) for i in range(len(ctx.widths))], dim=-1)

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor | None, ...]:
        first, *others = torch.split(grads[0], ctx.widths, dim=-1)
        ours, theirs = first.float(), first.float()
        ours_first, theirs_last = torch.zeros_like(ours), torch.zeros_like(ours)
        for i, grad in enumerate(others, start=1):
            end = grad.shape[-1]
            ours[..., i + 1 :] += grad[..., 1:]
            ours_first[..., i] += grad[..., 0]
            theirs[..., : end - 1] += grad[..., :-1]
            theirs_last[..., end - 1] += grad[..., -1]
        dtype = grads[0].dtype
        return None, *(total.to(dtype) for total in (ours, ours_first, theirs, theirs_last))


def _shifted_sum(
    i: int, ours: Tensor, ours_first: Tensor, theirs: Tensor, theirs_last: Tensor
) -> Tensor:
    """Columns i .. W - 1 of plane i: left shares plus right shares from i columns before.

    The crop's first left column and last right column come from tensors of their own.
    """
    if i == 0:
        return ours + theirs
    end = ours.shape[-1] - i
    left = torch.cat((ours_first[..., i : i + 1], ours[..., i + 1 :]), dim=-1)
    right = torch.cat((theirs[..., : end - 1], theirs_last[..., end - 1 : end]), dim=-1)
    return left + right


class Correlation(nn.Module):
    """Mean product of left and shifted right features, over all channels or per group."""

    def __init__(self, planes: int, groups: int = 1) -> None:
        super().__init__()
        self.planes = planes
        self.groups = groups

    def forward(self, left: Tensor, right: Tensor) -> Tensor:
        """(B, C, H, W) twice -> (B, groups, D, H, W)."""
        width = left.shape[-1]
        parts = [
            (left[..., i:] * right[..., : width - i]).unflatten(1, (self.groups, -1)).mean(dim=2)
            for i in range(min(self.planes, width))
        ]
        return torch.stack(_pad_left(parts, self.planes), dim=2)


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
        shares = self._first_shares(left, right)
        planes = self._train(shares) if self.training else self._evaluate(shares)
        # Planes lie along the batch, which keeps every layer's input channels last.
        return torch.stack(planes.chunk(self.planes), dim=2)

    def _evaluate(self, shares: Sequence[Tensor]) -> Tensor:
        """Three convolutions of every plane, masked: (D B, 1, H, W)."""
        batch, width = len(shares[0]), shares[0].shape[-1]
        parts = [_shifted_sum(i, *shares) for i in range(min(self.planes, width))]
        column = torch.arange(width, device=parts[0].device)
        plane = torch.arange(self.planes, device=parts[0].device).repeat_interleave(batch)
        mask = (column >= plane[:, None]).to(parts[0].dtype)[:, None, None, None]
        x = F.relu(self.norm[0](torch.cat(_pad_left(parts, self.planes)))) * mask
        for conv, norm in zip(self.conv[1:], self.norm[1:], strict=True):
            x = F.relu(norm(conv(x))) * mask
        return cast(Tensor, self.squeeze(x.squeeze(2)) * mask.squeeze(2))

    def _train(self, shares: Sequence[Tensor]) -> Tensor:
        """The same on packed columns, so that batch norms see only columns with a partner."""
        width = shares[0].shape[-1]
        packed = F.relu(self.norm[0](_ShiftedSums.apply(self.planes, *shares)))  # type: ignore[no-untyped-call]
        for conv, norm in zip(self.conv[1:], self.norm[1:], strict=True):
            planes = _Unpack.apply(packed, self.planes, width)  # type: ignore[no-untyped-call]
            packed = _Pack.apply(conv(planes), self.planes)  # type: ignore[no-untyped-call]
            packed = F.relu(norm(packed))
        packed = self.squeeze(packed.squeeze(2))
        return cast(Tensor, _Unpack.apply(packed, self.planes, width))  # type: ignore[no-untyped-call]

    def _first_shares(self, left: Tensor, right: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Each view's share of the first convolution, for `_shifted_sum`: (B, 16, depth, H, W)."""
        conv = cast(nn.Conv3d, self.conv[0])
        weight = conv.weight.squeeze(1)  # (16, k, 3, 3)
        depth = 2 * REDUCED_CHANNELS // weight.shape[1]
        # One row of output depth per group of k input channels: a block-diagonal kernel.
        groups = torch.eye(depth, dtype=weight.dtype, device=weight.device)
        kernel = groups[:, None, :, None, None, None] * weight[None, :, None]
        kernel = kernel.flatten(2, 3).flatten(0, 1)  # (depth 16, 64, 3, 3)
        if self.interlaced:
            ours, theirs = kernel[:, 0::2], kernel[:, 1::2]
        else:
            ours, theirs = kernel.split(REDUCED_CHANNELS, dim=1)

        def share(
            view: Tensor, kernel: Tensor, bias: Tensor | None, pad: tuple[int, int]
        ) -> Tensor:
            y: Tensor = F.conv2d(F.pad(view, (*pad, 1, 1)), kernel, bias)
            y = y.unflatten(1, (depth, -1)).transpose(1, 2)
            return y.contiguous(memory_format=torch.channels_last_3d)

        assert conv.bias is not None
        bias = conv.bias.repeat(depth)
        return (
            share(left, ours, bias, (1, 1)),
            share(left, ours[..., 1:], bias, (0, 1)),
            share(right, theirs, None, (1, 1)),
            share(right, theirs[..., :2], None, (1, 0)),
        )


def build_cost_volume(config: NetConfig) -> Correlation | LearnedVolume:
    """The cost volume that ``config`` names: (B, C, H, W) twice -> (B, channels, D, H, W)."""
    if config.learns_volume:
        return LearnedVolume(config.planes, config.cost_volume)
    return Correlation(config.planes, config.volume_channels)
