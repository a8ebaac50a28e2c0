"""3D layers as 2D layers on slices: for engines without 3D convolutions, or with slow ones.

A volume (1, C, D, H, W) becomes D slices along the batch axis, (D, C, H, W), and a kernel that is
three slices deep a sum of three 2D convolutions. See ``docs/how-it-works.md``, "Exact
accelerations".
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, cast

import torch
import torch.nn.functional as F
from torch import Tensor, nn


def slice_layers(network: nn.Module) -> None:
    """Replace all 3D convolutions of a network without batch norms, in place."""
    for module in list(network.modules()):
        for name, child in module.named_children():
            if isinstance(child, nn.Conv3d):
                setattr(module, name, SlicedConv(child))
            elif isinstance(child, nn.ConvTranspose3d):
                setattr(module, name, SlicedTransposed(child))


class SlicedConv(nn.Module):
    """A convolution 1 or 3 slices deep, of stride 1 or 2."""

    def __init__(self, conv: nn.Conv3d) -> None:
        super().__init__()
        self.stride = conv.stride[0]
        self.taps = nn.ModuleList(_taps(conv, nn.Conv2d))

    def forward(self, x: Tensor) -> Tensor:
        """(D, C, H, W) -> (D / stride, outputs, H / stride, W / stride)."""
        if len(self.taps) == 1:
            return cast(Tensor, self.taps[0](x[:: self.stride]))
        before, middle, after = self.taps
        padded = F.pad(x, (0, 0, 0, 0, 0, 0, 1, 1))
        y = middle(x[:: self.stride]) + before(padded[: -2 : self.stride])
        return cast(Tensor, y + after(padded[2 :: self.stride]))


class SlicedTransposed(nn.Module):
    """A 3x3x3 transposed convolution of stride 2 that doubles the size."""

    def __init__(self, conv: nn.ConvTranspose3d) -> None:
        super().__init__()
        self.after, self.even, self.odd = _taps(conv, nn.ConvTranspose2d)

    def forward(self, x: Tensor) -> Tensor:
        """(D, C, H, W) -> (2 D, outputs, 2 H, 2 W)."""
        after = F.pad(x[1:], (0, 0, 0, 0, 0, 0, 0, 1))
        odd = self.odd(x) + self.after(after)
        order = torch.arange(2 * len(x), device=x.device).reshape(2, -1).t().flatten()
        return torch.cat((self.even(x), odd)).index_select(0, order)


def _taps(conv: nn.Conv3d | nn.ConvTranspose3d, kind: Callable[..., Any]) -> list[nn.Module]:
    """One 2D layer per slice of the kernel; the bias goes with all that start a sum."""
    weights = conv.weight.unbind(2)
    transposed = isinstance(conv, nn.ConvTranspose3d)
    starts = range(1, 3) if transposed else [len(weights) // 2]
    extra = {"output_padding": conv.output_padding[1:]} if transposed else {}
    taps: list[nn.Module] = []
    for index, weight in enumerate(weights):
        bias = conv.bias if index in starts else None
        tap = kind(
            conv.in_channels,
            conv.out_channels,
            conv.kernel_size[1:],
            stride=conv.stride[1:],
            padding=conv.padding[1:],
            groups=conv.groups,
            bias=bias is not None,
            **extra,
        )
        tap.weight = nn.Parameter(weight.contiguous(), requires_grad=False)
        tap.bias = bias
        taps.append(tap)
    return taps
