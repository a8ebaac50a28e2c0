"""Fused layers: convolution, sum and activation in one pass over memory, and blocks by rows.

See ``docs/how-it-works.md``, "Exact accelerations".
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Callable
from typing import Any, cast

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from mobilestereonet.accelerate.modules import (
    is_plain,
    replace_modules,
    without_identities,
)
from mobilestereonet.nets.blocks import V2Block
from mobilestereonet.nets.features import ResidualBlock
from mobilestereonet.nets.hourglass import Head, Hourglass, PreHourglass

_ONEDNN: dict[str, tuple[str, list[float]]] = {
    "none": ("none", []),
    "relu": ("relu", []),
    "relu6": ("hardtanh", [0.0, 6.0]),
}
"""oneDNN's names and limits of the activations that it can append to a convolution."""

SLICE_BYTES = 1 << 23
"""Bytes of a v2 block's hidden tensor, or of a head's input, that are worked on at a time.

What a processor's cache can hold."""

MIN_ROWS = 6
"""Rows in a slice at least: whatever their number, two more are computed around them."""


def activation_name(layer: nn.Module) -> str:
    """What `FusedConv` calls an activation: "relu" or "relu6"; "none" for other layers."""
    if isinstance(layer, nn.ReLU):
        return "relu"
    return "relu6" if isinstance(layer, nn.ReLU6) else "none"


def process_by_rows(net: nn.Module) -> None:
    """v2 blocks and 3D heads by rows. After `fold_norms`, before `fuse_convolutions`."""
    replace_modules(net, V2Block, SlicedV2Block)
    replace_modules(net, Head, lambda head: SlicedHead(head) if head.dims == 3 else head)


def fuse_convolutions(net: nn.Module) -> None:
    """Convolutions and v2 blocks do the activation after them in the same pass.

    Residual blocks, pre-hourglass and hourglasses take their sums without another tensor. After
    `fold_norms` and `process_by_rows`.
    """
    layers: Any
    for layers in [module for module in net.modules() if is_plain(module, nn.Sequential)]:
        for index in reversed(range(len(layers))):
            layer = layers[index]
            if is_plain(layer, (nn.Conv2d, nn.Conv3d)) and _fusable(layer):
                layers[index] = layer = FusedConv(layer)
            last = layer.project if isinstance(layer, SlicedV2Block) else layer
            following = _following(layers, index)
            name = "none" if following is None else activation_name(layers[following])
            if isinstance(last, FusedConv) and name != "none":
                last.activation = name
                layers[following] = nn.Identity()
    replace_modules(net, ResidualBlock, FusedResidualBlock)
    replace_modules(net, PreHourglass, FusedPreHourglass)
    replace_modules(net, Hourglass, FusedHourglass)


def _fusable(conv: Any) -> bool:
    return conv.padding_mode == "zeros" and not isinstance(conv.padding, str)


def _following(layers: nn.Sequential, index: int) -> int | None:
    """Place of the next layer that is no identity."""
    return next(
        (i for i in range(index + 1, len(layers)) if type(layers[i]) is not nn.Identity), None
    )


class FusedConv(nn.Module):
    """``activation(conv(x) + other)`` in 2D or 3D: by oneDNN where it can, else by PyTorch.

    Next to 1x1 and depthwise convolutions, which wait for memory, an activation of its own costs
    about a third of the convolution before it.
    """

    def __init__(self, conv: nn.Conv2d | nn.Conv3d, activation: str = "none") -> None:
        super().__init__()
        self.conv = conv
        self.activation = activation

    def forward(self, x: Tensor, other: Tensor | None = None, *, pad_first: bool = True) -> Tensor:
        """Convolve.

        Args:
            x: (B, C, H, W) or (B, C, D, H, W).
            other: Tensor of the result's shape that is added to the convolution.
            pad_first: False leaves out the padding along the first of the spatial axes.
        """
        conv = self.conv
        padding = list(cast(tuple[int, ...], conv.padding))
        if not pad_first:
            padding[0] = 0
        size = (padding, conv.stride, conv.dilation, conv.groups)
        if not _runs_onednn(x):
            y = _convolve(x, conv.weight, conv.bias, *size)
            return _activate(y if other is None else y + other, self.activation)
        if other is None:
            return _onednn(x, conv.weight, conv.bias, *size, activation=self.activation)
        if other.shape[2:].numel() == 1:  # PyTorch 2.11 has no sum of single pixels
            return _activate(_onednn(x, conv.weight, conv.bias, *size) + other, self.activation)
        if self.activation == "relu6":  # oneDNN can follow a sum by a ReLU alone
            return _activate(_onednn_sum(x, other, conv.weight, conv.bias, *size), "relu6")
        relu = self.activation == "relu"
        return _onednn_sum(x, other, conv.weight, conv.bias, *size, relu=relu)


def _convolve(x: Tensor, weight: Tensor, bias: Tensor | None, padding: Any, *size: Any) -> Tensor:
    convolve = F.conv2d if x.ndim == 4 else F.conv3d
    stride, dilation, groups = size
    return convolve(x, weight, bias, stride, padding, dilation, groups)


def _onednn(
    x: Tensor, weight: Tensor, bias: Tensor | None, *size: Any, activation: str = "none"
) -> Tensor:
    """``activation(conv(x))`` by a private operator of PyTorch, which torch.compile uses."""
    call = torch.ops.mkldnn._convolution_pointwise
    return cast(Tensor, call(x, weight, bias, *size, *_ONEDNN[activation], ""))


def _onednn_sum(
    x: Tensor, other: Tensor, weight: Tensor, bias: Tensor | None, *size: Any, relu: bool = False
) -> Tensor:
    """``conv(x) + other`` likewise, and a ReLU of that."""
    call = torch.ops.mkldnn._convolution_pointwise.binary
    unary = "relu" if relu else None
    return cast(Tensor, call(x, other, weight, bias, *size, "add", 1.0, unary, [], None))


def _activate(x: Tensor, activation: str) -> Tensor:
    if activation == "relu":
        return F.relu(x, inplace=True)
    return F.relu6(x, inplace=True) if activation == "relu6" else x


def _runs_onednn(x: Tensor) -> bool:
    if x.device.type != "cpu" or x.dtype not in (torch.float32, torch.bfloat16):
        return False
    return has_onednn_operators(x.dtype)


@functools.cache
def has_onednn_operators(dtype: torch.dtype) -> bool:
    """Whether this PyTorch has the private operators, and they do what they did in PyTorch 2.13."""
    x = torch.linspace(-2, 2, 64).view(1, 4, 4, 4)
    weight = torch.linspace(-8, 8, 144).view(4, 4, 3, 3)
    x, weight = (t.to(dtype, memory_format=torch.channels_last) for t in (x, weight))
    size = ([1, 1], [1, 1], [1, 1], 1)
    expected = _convolve(x, weight, None, *size).float()
    try:
        clipped = _onednn(x, weight, None, *size, activation="relu6").float()
        total = _onednn_sum(x, x, weight, None, *size).float()
    except (AttributeError, NotImplementedError, RuntimeError, TypeError):
        return False
    pairs = ((clipped, expected.clamp(0, 6)), (total, expected + x.float()))
    return all(torch.allclose(found, right, rtol=0.02, atol=1) for found, right in pairs)


class FusedResidualBlock(nn.Module):
    """`ResidualBlock` of fused convolutions: its last one adds the skip."""

    def __init__(self, block: ResidualBlock) -> None:
        super().__init__()
        *layers, self.last = without_identities(block.conv2)
        self.layers = nn.Sequential(*block.conv1, *layers)
        self.downsample = block.downsample

    def forward(self, x: Tensor) -> Tensor:
        """(B, inputs, H, W) -> (B, outputs, H / stride, W / stride)."""
        return cast(Tensor, self.last(self.layers(x), self.downsample(x)))


class FusedPreHourglass(nn.Module):
    """`PreHourglass` that sums in place."""

    def __init__(self, blocks: PreHourglass) -> None:
        super().__init__()
        self.first, self.second = blocks.first, blocks.second

    def forward(self, volume: Tensor) -> Tensor:
        """(B, inputs, ...) -> (B, width, ...), same spatial size."""
        x = self.first(volume)
        return cast(Tensor, self.second(x).add_(x))


class FusedHourglass(nn.Module):
    """`Hourglass` that sums in place."""

    def __init__(self, hourglass: Hourglass) -> None:
        super().__init__()
        self.down1 = nn.Sequential(hourglass.conv1, hourglass.conv2)
        self.down2 = nn.Sequential(hourglass.conv3, hourglass.conv4)
        self.up5, self.redirect2 = hourglass.up5, hourglass.redirect2
        self.up6, self.redirect1 = hourglass.up6, hourglass.redirect1

    def forward(self, x: Tensor) -> Tensor:
        """(B, width, ...), spatial sizes multiples of 4 -> the same shape."""
        half = self.down1(x)
        half = self.up5(self.down2(half)).add_(self.redirect2(half)).relu_()
        return cast(Tensor, self.up6(half).add_(self.redirect1(x)).relu_())


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

    def forward(self, x: Tensor) -> Tensor:
        """(B, inputs, ...) -> (B, outputs, ...), spatial sizes divided by the stride."""
        stride = self.depthwise.conv.stride[0]
        height = (x.shape[2] - 1) // stride + 1
        hidden_row = x[:, 0, 0].numel() * self.depthwise.conv.in_channels * x.element_size()
        rows = max(SLICE_BYTES // hidden_row // stride, MIN_ROWS)
        if rows >= height:
            return self._project(self.depthwise(self.expand(x)), x)
        result: Tensor | None = None
        for top in range(0, height, rows):
            bottom = min(top + rows, height)
            y = self._project(self._hidden(x, top, bottom), x[:, :, top:bottom])
            if result is None:
                result = _empty_like(y, height)
            result[:, :, top:bottom] = y
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


def _empty_like(part: Tensor, height: int) -> Tensor:
    """Uninitialised, ``height`` rows instead of the part's, channels last."""
    batch, channels, _, *size = part.shape
    return part.new_empty(batch, height, *size, channels).movedim(-1, 1)
