"""Batched forms for training: both views at once, all disparities of a cost volume at once.

In eval mode the result is that of the plain network. In training mode batch norms take their
statistics once, over both views and over all disparities without the columns that have no partner;
the plain network, as the authors', updates them once per view and per disparity. See
``docs/how-it-works.md``, "Exact accelerations".
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, cast

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from mobilestereonet.accelerate.planewise import per_view
from mobilestereonet.nets.cost_volumes import REDUCED_CHANNELS, LearnedVolume
from mobilestereonet.nets.msnet import MobileStereoNet
from mobilestereonet.nets.volume_model import VolumeModel


class BatchedMobileStereoNet(MobileStereoNet):
    """`MobileStereoNet`, with the modules of another, whose features take both views in a batch."""

    def __init__(self, net: MobileStereoNet) -> None:
        VolumeModel.__init__(self, net.config)
        self.size_multiple = net.size_multiple
        for name, module in net.named_children():
            self.add_module(name, module)
        self.training = net.training
        self._guided = net._guided

    def view_features(self, left: Tensor, right: Tensor) -> Sequence[Tensor]:
        """See `MobileStereoNet.view_features`."""
        views: Tensor = self.reduction(self.features(torch.cat((left, right))))
        return views.chunk(2)


class BatchedLearnedVolume(nn.Module):
    """`LearnedVolume`, all planes in one batch; it shares the layers of another.

    The first convolution is linear, so each view's share is computed once and shifted. Only its
    borders need care: the convolution sees zeros beyond the cropped pair, hence the shares at the
    crop's border columns are those of a kernel without its outer column.
    """

    def __init__(self, volume: LearnedVolume) -> None:
        super().__init__()
        self.interlaced = volume.interlaced
        self.conv, self.norm, self.squeeze = volume.conv, volume.norm, volume.squeeze

    def forward(self, left: Tensor, right: Tensor, planes: int) -> Tensor:
        """(B, 32, H, W) twice -> (B, 1, D, H, W), D being ``planes``."""
        batch, _, height, width = left.shape
        # Rows of channels, one per pixel that has a partner, plane after plane: batch norms see
        # just these, each plane is an image in memory, and nothing is computed to be masked.
        rows: Tensor = _shifted_sums(*self._first_shares(left, right), planes)
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
            F.pad(part.view(batch, 1, height, -1), (i, 0))
            for i, part in enumerate(self.squeeze(image).flatten().split(lengths))
        ]
        parts += [torch.zeros_like(parts[0])] * (planes - len(parts))
        return torch.stack(parts, dim=2)

    def _activate(self, rows: Tensor, layer: int) -> Tensor:
        """Batch norm and ReLU of a convolution's result (P, depth C)."""
        channels = cast(nn.Conv3d, self.conv[layer]).out_channels
        image = rows.view(1, 1, -1, 1, channels).permute(0, 4, 1, 2, 3)
        image = F.relu(self.norm[layer](image), inplace=True)
        return image.permute(0, 2, 3, 4, 1).reshape(rows.shape)

    def _first_shares(self, left: Tensor, right: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Each view's share of the first convolution, for `_shifted_sums`: (B, depth 16, H, W)."""
        conv = cast(nn.Conv3d, self.conv[0])
        weight = conv.weight.squeeze(1)  # (16, k, 3, 3)
        depth = 2 * REDUCED_CHANNELS // weight.shape[1]
        # One row of output depth per group of k input channels: a block-diagonal kernel.
        groups = torch.eye(depth, dtype=weight.dtype, device=weight.device)
        kernel = groups[:, None, :, None, None, None] * weight[None, :, None]
        kernel = kernel.flatten(2, 3).flatten(0, 1)  # (depth 16, 64, 3, 3)
        left_kernel, right_kernel = per_view(kernel, self.interlaced)

        def share(
            view: Tensor, kernel: Tensor, bias: Tensor | None, padding: tuple[int, int]
        ) -> Tensor:
            y: Tensor = F.conv2d(F.pad(view, (*padding, 1, 1)), kernel, bias)
            return y.contiguous(memory_format=torch.channels_last)

        assert conv.bias is not None
        bias = conv.bias.repeat(depth)
        return (
            share(left, left_kernel, bias, (1, 1)),
            share(left, left_kernel[..., 1:], bias, (0, 1)),
            share(right, right_kernel, None, (1, 1)),
            share(right, right_kernel[..., :2], None, (1, 0)),
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


@torch.library.custom_op("mobilestereonet::shifted_sums", mutates_args=())
def _shifted_sums(
    left: Tensor, left_first: Tensor, right: Tensor, right_last: Tensor, planes: int
) -> Tensor:
    """Both views' shares of the first convolution -> its result for all planes, as rows.

    Plane i is the left shares from column i on plus the right shares from column 0 on. At the
    borders of such a crop the convolution sees zeros: the left shares of its first column and the
    right shares of its last column come from tensors of their own.
    """
    shape = _rows_last(left).shape
    left, left_first, right, right_last = map(_rows_last, (left, left_first, right, right_last))
    rows = left.new_empty(_row_count(shape, planes), shape[3])
    for i, block in enumerate(_planes_of(rows, shape, planes)):
        end = shape[2] - i
        torch.add(left[:, :, i:], right[:, :, :end], out=block)
        if i:
            block[:, :, 0] = left_first[:, :, i] + right[:, :, 0]
            last = left[:, :, -1] if end > 1 else left_first[:, :, -1]
            block[:, :, -1] = last + right_last[:, :, end - 1]
    return rows


@_shifted_sums.register_fake
def _(left: Tensor, left_first: Tensor, right: Tensor, right_last: Tensor, planes: int) -> Tensor:
    shape = _rows_last(left).shape
    return left.new_empty(_row_count(shape, planes), shape[3])


@torch.library.custom_op("mobilestereonet::shifted_sums_backward", mutates_args=())
def _shifted_sums_backward(
    grad: Tensor, shape: Sequence[int], planes: int
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    first, *others = _planes_of(grad.contiguous(), shape, planes)
    # Copies, in float32 too: the sums below are each view's own.
    dtype = torch.promote_types(grad.dtype, torch.float32)
    left, right = (first.to(dtype, copy=True) for _ in range(2))
    left_first, right_last = torch.zeros_like(left), torch.zeros_like(left)
    for i, block in enumerate(others, start=1):
        end = block.shape[2]
        block = block.to(left.dtype)
        left[:, :, i + 1 :] += block[:, :, 1:]
        left_first[:, :, i] += block[:, :, 0]
        right[:, :, : end - 1] += block[:, :, :-1]
        right_last[:, :, end - 1] += block[:, :, -1]
    totals = [
        total.to(grad.dtype).permute(0, 3, 1, 2) for total in (left, left_first, right, right_last)
    ]
    return totals[0], totals[1], totals[2], totals[3]


@_shifted_sums_backward.register_fake
def _(grad: Tensor, shape: Sequence[int], planes: int) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    totals = [grad.new_empty(shape).permute(0, 3, 1, 2) for _ in range(4)]
    return totals[0], totals[1], totals[2], totals[3]


def _keep_shape(ctx: Any, inputs: tuple[Any, ...], output: Tensor) -> None:
    ctx.shape, ctx.planes = list(_rows_last(inputs[0]).shape), inputs[4]


def _shifted_sums_gradient(ctx: Any, grad: Tensor) -> tuple[Tensor | None, ...]:
    return *_shifted_sums_backward(grad, ctx.shape, ctx.planes), None


_shifted_sums.register_autograd(_shifted_sums_gradient, setup_context=_keep_shape)


def _rows_last(share: Tensor) -> Tensor:
    """(B, C, H, W) -> (B, H, W, C)."""
    return share.permute(0, 2, 3, 1)


def _row_count(shape: Sequence[int], planes: int) -> int:
    batch, height, width, _ = shape
    return sum(batch * height * (width - i) for i in range(min(planes, width)))


def _planes_of(rows: Tensor, shape: Sequence[int], planes: int) -> Iterator[Tensor]:
    """The planes (B, H, W - i, C) of rows (P, C)."""
    batch, height, width, channels = shape
    lengths = [batch * height * (width - i) for i in range(min(planes, width))]
    return (plane.view(batch, height, -1, channels) for plane in rows.split(lengths))
