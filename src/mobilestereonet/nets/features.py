"""Feature extraction, shared by both views, and the channel reduction of the 2D networks."""

from __future__ import annotations

import itertools
from functools import partial
from typing import cast

import torch
from torch import Tensor, nn

from mobilestereonet.nets.blocks import Block, V2Block, conv_norm, v1_block
from mobilestereonet.nets.cost_volumes import REDUCED_CHANNELS
from mobilestereonet.nets.msnet_config import FEATURE_CHANNELS, NetConfig


def _first_convolutions(config: NetConfig) -> nn.Sequential:
    def block(inputs: int, *, stride: int = 1) -> nn.Sequential:
        if config.first_conv == "conv":
            return conv_norm(2, inputs, 32, stride=stride)
        v2 = V2Block(2, inputs, 32, expansion=config.first_expansion, stride=stride)
        return nn.Sequential(v2, nn.ReLU()) if config.v2_relu else nn.Sequential(v2)

    return nn.Sequential(block(3, stride=2), block(32), block(32))


class ResidualBlock(nn.Module):
    """Two 3x3 convolutions, or v1 blocks, with a skip and no activation after the sum."""

    def __init__(
        self, kind: Block, inputs: int, outputs: int, *, stride: int = 1, dilation: int = 1
    ) -> None:
        super().__init__()
        if kind == "v1":
            self.conv1 = v1_block(2, inputs, outputs, stride=stride, dilation=dilation)
            self.conv2 = v1_block(2, outputs, outputs, dilation=dilation, last_activation=False)
        else:
            self.conv1 = conv_norm(2, inputs, outputs, stride=stride, dilation=dilation)
            self.conv2 = conv_norm(2, outputs, outputs, dilation=dilation, activation=None)
        self.downsample: nn.Module = nn.Identity()
        if stride != 1 or inputs != outputs:
            self.downsample = conv_norm(
                2, inputs, outputs, kernel=1, stride=stride, activation=None
            )

    def forward(self, x: Tensor) -> Tensor:
        """(B, inputs, H, W) -> (B, outputs, H / stride, W / stride)."""
        return cast(Tensor, self.conv2(self.conv1(x)) + self.downsample(x))


def _stage(
    config: NetConfig, inputs: int, outputs: int, blocks: int, *, stride: int = 1, dilation: int = 1
) -> nn.Sequential:
    def block(inputs: int, stride: int) -> nn.Module:
        if config.features == "v2":
            v2 = partial(V2Block, expansion=config.features_expansion)
            return v2(2, inputs, outputs, stride=stride, dilation=dilation)
        return ResidualBlock(config.features, inputs, outputs, stride=stride, dilation=dilation)

    return nn.Sequential(block(inputs, stride), *(block(outputs, 1) for _ in range(blocks - 1)))


class FeatureExtraction(nn.Module):
    """Feature extraction (Sec. 3.2): three first convolutions and four residual stages.

    3 blocks of 32 channels; 16 of 64, the first of stride 2; 3 of 128; 3 of 128 with dilation 2.
    Stages 2, 3 and 4 are concatenated.

    Args:
        config: Which blocks.
        eighth: The third stage has stride 2 and the fourth no dilation, as in DeepPruner-Fast.
    """

    def __init__(self, config: NetConfig, *, eighth: bool = False) -> None:
        super().__init__()
        self.first = _first_convolutions(config)
        self.stage1 = _stage(config, 32, 32, blocks=3)
        self.stage2 = _stage(config, 32, 64, blocks=16, stride=2)
        self.stage3 = _stage(config, 64, 128, blocks=3, stride=2 if eighth else 1)
        self.stage4 = _stage(config, 128, 128, blocks=3, dilation=1 if eighth else 2)

    def forward(self, image: Tensor) -> Tensor:
        """(B, 3, H, W), H and W multiples of 4 -> (B, 320, H / 4, W / 4)."""
        return torch.cat(self.stages(image)[1:], dim=1)

    def stages(self, image: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """All stages: (B, 32, H / 2, W / 2), (B, 64, H / 4, W / 4) and twice (B, 128, ...)."""
        stage1 = self.stage1(self.first(image))
        stage2 = self.stage2(stage1)
        stage3 = self.stage3(stage2)
        return stage1, stage2, stage3, self.stage4(stage3)


def channel_reduction() -> nn.Sequential:
    """Channel reduction of the 2D networks (Sec. 3.2): (B, 320, H, W) -> (B, 32, H, W).

    1x1 convolutions 320, 256, 128, 64 with batch norm and ReLU, then 64 -> 32 with bias.
    """
    channels = (FEATURE_CHANNELS, 256, 128, 64)
    layers: list[nn.Module] = [
        conv_norm(2, inputs, outputs, kernel=1) for inputs, outputs in itertools.pairwise(channels)
    ]
    return nn.Sequential(*layers, nn.Conv2d(64, REDUCED_CHANNELS, 1))
