"""Fused layers: activations and sums happen in the pass of the convolution before them.

See ``docs/how-it-works.md``, "Exact accelerations".
"""

from __future__ import annotations

from typing import Any, cast

from torch import Tensor, nn

from mobilestereonet.accelerate.modules import is_plain, replace_modules, without_identities
from mobilestereonet.accelerate.onednn import FusedConv, activation_name
from mobilestereonet.accelerate.rows import SlicedV2Block
from mobilestereonet.nets.features import ResidualBlock
from mobilestereonet.nets.hourglass import Hourglass, PreHourglass


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
        self.first = blocks.first
        layers = (layer for block in blocks.second for layer in cast(nn.Sequential, block))
        *others, self.last = without_identities(layers)
        self.others = nn.Sequential(*others)

    def forward(self, volume: Tensor) -> Tensor:
        """(B, inputs, ...) -> (B, width, ...), same spatial size."""
        x = self.first(volume)
        return _add_layer(x, self.last, self.others(x))


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
        half = _add_layer(self.up5(self.down2(half)), self.redirect2, half, relu=True)
        return _add_layer(self.up6(half), self.redirect1, x, relu=True)


def _add_layer(total: Tensor, layer: nn.Module, x: Tensor, *, relu: bool = False) -> Tensor:
    """``total + layer(x)`` in place of ``total``, and a ReLU of it."""
    if isinstance(layer, SlicedV2Block):
        return cast(Tensor, layer(x, total, relu=relu))
    total = total.add_(layer(x))
    return total.relu_() if relu else total
