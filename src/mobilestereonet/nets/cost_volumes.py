"""Cost volumes: similarity of the left view and the shifted right view, per disparity.

All planes are computed in one batch. Plane i compares left column x with right column x - i at a
quarter of the resolution; the columns x < i, which have no partner, are zero. In eval mode every
volume equals the authors' loop over disparities. In training, batch norm statistics are taken
once, over all disparities, without the columns left of each disparity (the authors' loop updates
them once per disparity).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, cast

import torch
import torch.nn.functional as F
from torch import Tensor, nn
from torch.autograd.function import once_differentiable

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


class _ShiftedSums(torch.autograd.Function):
    """Both views' shares of the first convolution -> its result for all planes, as rows.

    Plane i is the left shares from column i on plus the right shares from column 0 on. At the
    borders of such a crop the convolution sees zeros: the left shares of its first column and the
    right shares of its last column come from tensors of their own.
    """

    @staticmethod
    def forward(ctx: Any, planes: int, *shares: Tensor) -> Tensor:
        ours, ours_first, theirs, theirs_last = (share.permute(0, 2, 3, 1) for share in shares)
        batch, height, width, channels = ctx.shape = ours.shape
        ctx.rows = [batch * height * (width - i) for i in range(min(planes, width))]
        rows = ours.new_empty(sum(ctx.rows), channels)
        for i, block in enumerate(_ShiftedSums.blocks(rows, ctx.rows, ctx.shape)):
            end = width - i
            torch.add(ours[:, :, i:], theirs[:, :, :end], out=block)
            if i:
                block[:, :, 0] = ours_first[:, :, i] + theirs[:, :, 0]
                last = ours[:, :, -1] if end > 1 else ours_first[:, :, -1]
                block[:, :, -1] = last + theirs_last[:, :, end - 1]
        return rows

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor | None, ...]:
        first, *others = _ShiftedSums.blocks(grads[0], ctx.rows, ctx.shape)
        # Copies, in float32 too: the sums below are each view's own.
        ours, theirs = (first.to(torch.float32, copy=True) for _ in range(2))
        ours_first, theirs_last = torch.zeros_like(ours), torch.zeros_like(ours)
        for i, block in enumerate(others, start=1):
            end = block.shape[2]
            block = block.float()
            ours[:, :, i + 1 :] += block[:, :, 1:]
            ours_first[:, :, i] += block[:, :, 0]
            theirs[:, :, : end - 1] += block[:, :, :-1]
            theirs_last[:, :, end - 1] += block[:, :, -1]
        totals = (ours, ours_first, theirs, theirs_last)
        return None, *(total.to(first.dtype).permute(0, 3, 1, 2) for total in totals)

    @staticmethod
    def blocks(rows: Tensor, lengths: Sequence[int], shape: torch.Size) -> Iterator[Tensor]:
        """The planes (B, H, W - i, C) of rows (P, C)."""
        batch, height, _, channels = shape
        return (plane.view(batch, height, -1, channels) for plane in rows.split(list(lengths)))


class _GroupMeans(torch.autograd.Function):
    """The volume of `Correlation` for training: in channels last, and each product made once.

    Autograd through its slices would add up 2 D padded gradients, in the features' own precision.
    """

    @staticmethod
    def forward(ctx: Any, left: Tensor, right: Tensor, planes: int, groups: int) -> Tensor:
        ours, theirs = (view.permute(0, 2, 3, 1).contiguous() for view in (left, right))
        batch, height, width, _ = ours.shape
        volume = ours.new_zeros(batch, planes, height, width, groups)
        for i in range(min(planes, width)):
            product = ours[:, :, i:] * theirs[:, :, : width - i]
            volume[:, i, :, i:] = product.unflatten(-1, (groups, -1)).mean(dim=-1)
        ctx.save_for_backward(ours, theirs)
        return volume.permute(0, 4, 1, 2, 3)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor | None, ...]:
        groups, planes = grads[0].shape[1:3]
        grad = grads[0].permute(0, 2, 3, 4, 1).unsqueeze(-1)
        ours, theirs = (view.unflatten(-1, (groups, -1)) for view in ctx.saved_tensors)
        width, share = ours.shape[2], 1 / ours.shape[-1]
        dtype = torch.promote_types(ours.dtype, torch.float32)
        totals = [torch.zeros_like(view, dtype=dtype) for view in (ours, theirs)]
        for i in range(min(planes, width)):
            plane, end = grad[:, i, :, i:], width - i
            totals[0][:, :, i:].addcmul_(plane, theirs[:, :, :end], value=share)
            totals[1][:, :, :end].addcmul_(plane, ours[:, :, i:], value=share)
        views = [total.flatten(-2).permute(0, 3, 1, 2).to(ours.dtype) for total in totals]
        return *views, None, None


class Correlation(nn.Module):
    """Mean product of left and shifted right features, over all channels or per group."""

    def __init__(self, groups: int = 1) -> None:
        super().__init__()
        self.groups = groups

    def forward(self, left: Tensor, right: Tensor, planes: int) -> Tensor:
        """(B, C, H, W) twice -> (B, groups, D, H, W), D being ``planes``."""
        if left.requires_grad:
            volume: Tensor = _GroupMeans.apply(left, right, planes, self.groups)  # type: ignore[no-untyped-call]
            return volume
        width = left.shape[-1]
        parts = [
            (left[..., i:] * right[..., : width - i]).unflatten(1, (self.groups, -1)).mean(dim=2)
            for i in range(min(planes, width))
        ]
        return torch.stack(_pad_left(parts, planes), dim=2)


class LearnedVolume(nn.Module):
    """Interlacing cost volume (the paper's Sec. 3.2, Fig. 5), and concatenation likewise.

    The channels of both views, interlaced (L0 R0 L1 R1 ...) or one view after the other, form
    the depth of a one-channel volume. Three 3D convolutions, whose kernels reach as deep as their
    strides, and a 1x1 convolution turn it into one plane per disparity.

    The first convolution is linear, so each view's share is computed once and shifted. Only its
    borders need care: the convolution sees zeros beyond the cropped pair, hence the shares at the
    crop's border columns are those of a kernel without its outer column.
    """

    def __init__(self, kind: CostVolume) -> None:
        super().__init__()
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

    def forward(self, left: Tensor, right: Tensor, planes: int) -> Tensor:
        """(B, 32, H, W) twice -> (B, 1, D, H, W), D being ``planes``."""
        batch, _, height, width = left.shape
        # Rows of channels, one per pixel that has a partner, plane after plane: batch norms see
        # just these, each plane is an image in memory, and nothing is computed to be masked.
        rows: Tensor = _ShiftedSums.apply(planes, *self._first_shares(left, right))  # type: ignore[no-untyped-call]
        lengths = [batch * height * (width - i) for i in range(min(planes, width))]
        rows = self._activate(rows, 0)
        for layer in (1, 2):
            convolved = [
                _conv_planes(rows.unflatten(0, (batch, height, -1)), self.conv[layer])
                for rows in rows.split(lengths)
            ]
            rows = self._activate(torch.cat(convolved), layer)
        image = rows.view(1, 1, -1, rows.shape[1]).permute(0, 3, 1, 2)
        parts = [
            part.view(batch, 1, height, -1) for part in self.squeeze(image).flatten().split(lengths)
        ]
        return torch.stack(_pad_left(parts, planes), dim=2)

    def _activate(self, rows: Tensor, layer: int) -> Tensor:
        """Batch norm and ReLU of a convolution's result (P, depth C)."""
        channels = cast(nn.Conv3d, self.conv[layer]).out_channels
        image = rows.view(1, 1, -1, 1, channels).permute(0, 4, 1, 2, 3)
        image = F.relu(self.norm[layer](image), inplace=True)
        return image.permute(0, 2, 3, 4, 1).reshape(rows.shape)

    def _first_shares(self, left: Tensor, right: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Each view's share of the first convolution, for `_ShiftedSums`: (B, depth 16, H, W)."""
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
            return y.contiguous(memory_format=torch.channels_last)

        assert conv.bias is not None
        bias = conv.bias.repeat(depth)
        return (
            share(left, ours, bias, (1, 1)),
            share(left, ours[..., 1:], bias, (0, 1)),
            share(right, theirs, None, (1, 1)),
            share(right, theirs[..., :2], None, (1, 0)),
        )


def _conv_planes(plane: Tensor, conv: nn.Module) -> Tensor:
    """A 3D convolution whose stride is its depth, of one plane (B, H, W, depth C) -> rows.

    With the steps along the depth side by side in a row of the image, it is a 2D convolution
    dilated by their number.
    """
    conv = cast(nn.Conv3d, conv)
    weight = conv.weight.transpose(1, 2).flatten(1, 2)  # (outputs, depth C, 3, 3)
    steps = plane.shape[3] // weight.shape[1]
    image = plane.view(*plane.shape[:2], -1, weight.shape[1]).permute(0, 3, 1, 2)
    y: Tensor = F.conv2d(image, weight, conv.bias, padding=(1, steps), dilation=(1, steps))
    return y.permute(0, 2, 3, 1).reshape(-1, steps * conv.out_channels)


def build_cost_volume(config: NetConfig) -> Correlation | LearnedVolume:
    """The cost volume that ``config`` names: (B, C, H, W) twice, D -> (B, channels, D, H, W)."""
    if config.learns_volume:
        return LearnedVolume(config.cost_volume)
    return Correlation(config.volume_channels)
