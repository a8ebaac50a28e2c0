"""v2 blocks and 3D heads by rows: their large tensors exist some rows at a time.

See ``docs/how-it-works.md``, "Exact accelerations".
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any, cast

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from mobilestereonet.accelerate.modules import replace_modules, without_identities
from mobilestereonet.accelerate.onednn import FusedConv, activation_name
from mobilestereonet.nets.blocks import V2Block
from mobilestereonet.nets.hourglass import Head

SLICE_BYTES = 1 << 23
"""Bytes of a v2 block's hidden tensor, or of a head's input, that are worked on at a time.

What a processor's cache can hold."""

MIN_ROWS = 6
"""Rows in a slice at least: whatever their number, two more are computed around them."""


def process_by_rows(net: nn.Module) -> None:
    """v2 blocks and 3D heads by rows. After `fold_norms`, before `fuse_convolutions`."""
    replace_modules(net, V2Block, SlicedV2Block)
    replace_modules(net, Head, lambda head: SlicedHead(head) if head.dims == 3 else head)


class SlicedV2Block(nn.Module):
    """`V2Block` of fused convolutions, some rows at a time where its hidden tensor is large.

    At 3 times the block's channels, that tensor would set the peak of the memory in use; and the
    depthwise convolution runs several times faster on rows that are still in the cache. Rows are
    along the first of the spatial axes, so that with channels last they are one block of memory.
    """

    def __init__(self, block: V2Block) -> None:
        super().__init__()
        expand, first, depthwise, second, project = cast(list[Any], without_identities(block.conv))
        self.expand = FusedConv(expand, activation_name(first))
        self.depthwise = FusedConv(depthwise, activation_name(second))
        self.project = FusedConv(project)
        self.skip = block.skip

    def forward(self, x: Tensor, onto: Tensor | None = None, *, relu: bool = False) -> Tensor:
        """Apply the block.

        Args:
            x: (B, inputs, ...).
            onto: Tensor of the result's shape that the result is added to, in place, while its
                rows are in the cache.
            relu: Whether a ReLU follows that sum.

        Returns:
            (B, outputs, ...), spatial sizes divided by the stride; ``onto`` where it is given.
        """
        stride = self.depthwise.conv.stride[0]
        height = (x.shape[2] - 1) // stride + 1
        hidden_row = x[:, 0, 0].numel() * self.depthwise.conv.in_channels * x.element_size()
        rows = max(SLICE_BYTES // hidden_row // stride, MIN_ROWS)
        if rows >= height:
            y = self._project(self.depthwise(self.expand(x)), x)
            return y if onto is None else _add(onto, y, relu=relu)
        result = onto
        for top in range(0, height, rows):
            bottom = min(top + rows, height)
            y = self._project(self._hidden(x, top, bottom), x[:, :, top:bottom])
            if result is None:
                result = _empty_like(y, height)
            if onto is None:
                result[:, :, top:bottom] = y
            else:
                _add(result[:, :, top:bottom], y, relu=relu)
        return cast(Tensor, result)

    def _hidden(self, x: Tensor, top: int, bottom: int) -> Tensor:
        """Rows ``top`` to ``bottom`` of the depthwise convolution's result."""
        stride, reach = self.depthwise.conv.stride[0], self.depthwise.conv.dilation[0]
        first, last = stride * top - reach, stride * (bottom - 1) + reach + 1
        return cast(Tensor, self.depthwise(_rows(x, first, last, self.expand), pad_first=False))

    def _project(self, hidden: Tensor, x: Tensor) -> Tensor:
        return cast(Tensor, self.project(hidden, x if self.skip else None))


class SlicedHead(nn.Module):
    """3D `Head`, some rows at a time: the features before its last convolution don't exist.

    A convolution to one channel would leave most of a vector unused: here one matrix product gives
    the shares of all neighbours, which are then added up. In float32.
    """

    def __init__(self, head: Head) -> None:
        super().__init__()
        conv, activation = cast(list[Any], without_identities(head.conv))
        self.conv = FusedConv(conv, activation_name(activation))
        self.score = head.score

    def forward(self, x: Tensor) -> Tensor:
        """(B, width, H, ...) -> scores (B, H, ...), H being the first of the spatial axes."""
        batch, channels, height, *size = x.shape
        rows = max(SLICE_BYTES // (x[:, :, 0].numel() * x.element_size()), MIN_ROWS)
        dtype = torch.promote_types(x.dtype, torch.float32)
        shares = self.score.weight[0].flatten(1).t().to(dtype)  # (27, width)
        sums = x.new_zeros(batch, height + 2, *(length + 2 for length in size), dtype=dtype)
        for top in range(0, height, rows):
            bottom = min(top + rows, height)
            y = self.conv(_rows(x, top - 1, bottom + 1), pad_first=False)
            y = shares @ y.movedim(1, -1).reshape(-1, channels).to(dtype).t()
            y = y.view(3, 3, 3, batch, -1, *size)
            for i, j, k in itertools.product(range(3), repeat=3):
                part = sums[:, top + 2 - i : bottom + 2 - i, 2 - j :, 2 - k :]
                part[..., : size[0], : size[1]] += y[i, j, k]
        return sums[:, 1:-1, 1:-1, 1:-1].to(x.dtype)


def _rows(
    x: Tensor, first: int, last: int, layer: Callable[[Tensor], Tensor] | None = None
) -> Tensor:
    """Rows ``first`` to ``last`` of a layer's result, or of ``x``; zeros where ``x`` ends."""
    above, below = max(-first, 0), max(last - x.shape[2], 0)
    y = x[:, :, first + above : last - below]
    if layer is not None:
        y = layer(y)
    return F.pad(y, (0, 0) * (x.ndim - 3) + (above, below)) if above or below else y


def _add(onto: Tensor, x: Tensor, *, relu: bool) -> Tensor:
    total = onto.add_(x)
    return total.relu_() if relu else total


def _empty_like(part: Tensor, height: int) -> Tensor:
    """Uninitialised, ``height`` rows instead of the part's, channels last."""
    batch, channels, _, *size = part.shape
    return part.new_empty(batch, height, *size, channels).movedim(-1, 1)
