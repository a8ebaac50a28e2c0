"""The encoder-decoder: pre-hourglass, hourglasses and heads, in 2D and 3D."""

from __future__ import annotations

from functools import partial
from typing import cast

import torch.nn.functional as F
from torch import Tensor, nn

from mobilestereonet.nets.blocks import CONV, V2Block, conv_norm, transposed_norm, v1_block
from mobilestereonet.nets.coarse_pass import Guide
from mobilestereonet.nets.msnet_config import NetConfig


class PreHourglass(nn.Module):
    """Pre-hourglass (Sec. 3.2): two blocks, then two more with a skip around them."""

    def __init__(self, config: NetConfig, inputs: int) -> None:
        super().__init__()
        width = config.width

        def block(channels: int, *, last: bool = False) -> nn.Sequential:
            if config.pre_hourglass == "conv":
                return conv_norm(config.dims, channels, width, activation=None if last else nn.ReLU)
            v2 = V2Block(
                config.dims, channels, width, expansion=config.pre_expansion, skip=config.v2_skip
            )
            relu = config.v2_relu and not last
            return nn.Sequential(v2, nn.ReLU()) if relu else nn.Sequential(v2)

        self.first = nn.Sequential(block(inputs), block(width))
        self.second = nn.Sequential(block(width), block(width, last=True))

    def forward(self, volume: Tensor) -> Tensor:
        """(B, inputs, ...) -> (B, width, ...), same spatial size."""
        x = self.first(volume)
        return cast(Tensor, x + self.second(x))


class Hourglass(nn.Module):
    """Hourglass (Sec. 3.2, Fig. A1): to a quarter of the volume's size and up again, with skips.

    The ReLUs after both sums are functional: the paper's count of MACs leaves them out.
    """

    def __init__(self, config: NetConfig) -> None:
        super().__init__()
        dims, width = config.dims, config.width

        def block(inputs: int, outputs: int, *, stride: int = 1) -> nn.Module:
            if config.hourglass == "conv":
                return conv_norm(dims, inputs, outputs, stride=stride)
            if config.hourglass == "v1":
                return v1_block(dims, inputs, outputs, stride=stride)
            v2 = partial(V2Block, expansion=config.hourglass_expansion, skip=config.v2_skip)
            return v2(dims, inputs, outputs, stride=stride)

        def redirect(channels: int) -> nn.Module:
            # v1 hourglasses keep the 1x1 convolutions: that is how the paper's tables count.
            if config.hourglass == "v2":
                return block(channels, channels)
            return conv_norm(dims, channels, channels, kernel=1, activation=None)

        self.conv1 = block(width, 2 * width, stride=2)
        self.conv2 = block(2 * width, 2 * width)
        self.conv3 = block(2 * width, 4 * width, stride=2)
        self.conv4 = block(4 * width, 4 * width)
        self.up5 = transposed_norm(dims, 4 * width, 2 * width)
        self.up6 = transposed_norm(dims, 2 * width, width)
        self.redirect1 = redirect(width)
        self.redirect2 = redirect(2 * width)

    def forward(self, x: Tensor) -> Tensor:
        """(B, width, ...), spatial sizes multiples of 4 -> the same shape."""
        half = self.conv2(self.conv1(x))
        quarter = self.conv4(self.conv3(half))
        half = F.relu(self.up5(quarter) + self.redirect2(half))
        return F.relu(self.up6(half) + self.redirect1(x))


class Head(nn.Module):
    """Matching scores per disparity: 3x3(x3) convolution, batch norm, ReLU, 3x3(x3) convolution.

    As in the authors' release; the paper does not describe it.
    """

    def __init__(self, config: NetConfig) -> None:
        super().__init__()
        self.dims = config.dims
        outputs = config.planes if config.dims == 2 else 1
        self.conv = conv_norm(config.dims, config.width, config.width)
        self.score = CONV[config.dims](config.width, outputs, 3, padding=1, bias=False)

    def forward(self, x: Tensor) -> Tensor:
        """(B, width, H, W) or (B, width, D, H, W) -> scores (B, D, H, W)."""
        scores = cast(Tensor, self.score(self.conv(x)))
        return scores.squeeze(1) if self.dims == 3 else scores


class Aggregation:
    """What a pre-hourglass, hourglasses and heads compute: mixin of modules that have them."""

    training: bool
    pre_hourglass: nn.Module
    hourglasses: nn.ModuleList
    heads: nn.ModuleList
    guide: Guide

    def aggregate(self, volume: Tensor, guidance: Tensor | None = None) -> list[Tensor]:
        """Matching scores of a cost volume.

        Args:
            volume: (B, C, D, H / 4, W / 4); for 2D networks (B, C D, H / 4, W / 4).
            guidance: (B, D, H / 4, W / 4), see `nets.coarse_pass`; None or zeros: none.

        Returns:
            One (B, D, H / 4, W / 4) per head in training mode, the last one's alone in eval mode.
        """
        x = self.pre_hourglass(volume)
        if guidance is not None:
            x = self.guide(x, guidance)
        scores = []
        for hourglass, head in zip(self.hourglasses, self.heads, strict=False):
            if self.training:
                scores.append(cast(Tensor, head(x)))
            x = hourglass(x)
        return [*scores, cast(Tensor, self.heads[-1](x))]


class EncoderDecoder(Aggregation, nn.Module):
    """Pre-hourglass, hourglasses and heads of a coarse pass that has weights of its own."""

    def __init__(self, config: NetConfig, inputs: int, hourglasses: int) -> None:
        super().__init__()
        self.pre_hourglass = PreHourglass(config, inputs)
        self.hourglasses = nn.ModuleList(Hourglass(config) for _ in range(hourglasses))
        self.heads = nn.ModuleList(Head(config) for _ in range(hourglasses + 1))
