"""GC-Net (Kendall et al., "End-to-End Learning of Geometry and Context", ICCV 2017).

There is no code by its authors. This is the version that MobileStereoNet's paper counts: in GC-Net
itself the main path and the skip of a level share their first strided convolution, here each has
its own.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import cast

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from mobilestereonet.errors import check_multiple
from mobilestereonet.nets.blocks import conv_norm, transposed_norm
from mobilestereonet.nets.model import Preprocessing
from mobilestereonet.nets.operations import cost_volume
from mobilestereonet.nets.registry import register_model
from mobilestereonet.nets.soft_argmax import SoftArgmax
from mobilestereonet.nets.volume_model import VolumeModel, VolumeOutputs

FEATURES = 32
"""Channels per view that enter the cost volume."""


@dataclass(frozen=True, kw_only=True)
class GCNetConfig:
    """GC-Net as data.

    Attributes:
        max_disparity: Disparities 0 .. max_disparity - 1 are searched; a multiple of 32.
    """

    max_disparity: int = 192

    def __post_init__(self) -> None:
        check_multiple("max_disparity", self.max_disparity, 32)


class ConvChain(nn.Sequential):
    """3x3x3 convolutions with bias and batch norm, and a ReLU after each.

    Args:
        channels: Those of the input, then of each result.
        stride: Stride of the first convolution.
    """

    def __init__(self, *channels: int, stride: int = 1) -> None:
        super().__init__(
            *(
                _conv(3, inputs, outputs, stride=stride if index == 0 else 1)
                for index, (inputs, outputs) in enumerate(pairwise(channels))
            )
        )

    def forward(self, x: Tensor) -> Tensor:
        """(B, C, D, H, W) -> the last channels, sizes divided by the stride."""
        for conv in self:
            x = F.relu(conv(x))
        return x


class ResidualBlock(nn.Module):
    """Two 3x3 convolutions with a skip, and a ReLU after the sum."""

    def __init__(self) -> None:
        super().__init__()
        self.first = _conv(2, FEATURES, FEATURES)
        self.second = _conv(2, FEATURES, FEATURES)

    def forward(self, x: Tensor) -> Tensor:
        """(B, 32, H, W) -> the same shape."""
        return F.relu(self.second(F.relu(self.first(x))) + x)


class Features(nn.Module):
    """Unary features (Sec. 3.1): (B, 3, H, W) -> (B, 32, H / 2, W / 2)."""

    def __init__(self) -> None:
        super().__init__()
        self.first = _conv(2, 3, FEATURES, kernel=5, stride=2)
        self.blocks = nn.Sequential(*(ResidualBlock() for _ in range(8)))
        self.last = nn.Conv2d(FEATURES, FEATURES, 3, padding=1)

    def forward(self, image: Tensor) -> Tensor:
        """(B, 3, H, W), H and W even -> (B, 32, H / 2, W / 2)."""
        return cast(Tensor, self.last(self.blocks(F.relu(self.first(image)))))


@register_model(
    "gcnet",
    paper="Kendall et al., End-to-End Learning of Geometry and Context for Deep Stereo "
    "Regression, ICCV 2017",
    checkpoints="none",
    recipes=("gcnet-sceneflow", "gcnet-kitti2015"),
    published={"KITTI 2015 test D1-all, %": 2.87},
)
class GCNet(VolumeModel):
    """Concatenation volume at half resolution and a 3D encoder-decoder of five levels."""

    config: GCNetConfig
    preprocessing = Preprocessing((0.5, 0.5, 0.5), (0.5, 0.5, 0.5))  # to -1..1
    size_multiple = 32

    def __init__(self, config: GCNetConfig) -> None:
        super().__init__(config)
        self.features = Features()
        self.down = nn.ModuleList(ConvChain(64, 64, stride=2) for _ in range(3))
        self.skips = nn.ModuleList(
            [
                ConvChain(2 * FEATURES, 32, 32),
                *(ConvChain(64, 64, 64, 64, stride=2) for _ in range(3)),
            ]
        )
        self.bottom = ConvChain(64, 128, 128, 128, stride=2)
        self.up = nn.ModuleList(
            transposed_norm(3, inputs, outputs, bias=True)
            for inputs, outputs in pairwise((128, 64, 64, 64, 32))
        )
        self.cost = nn.ConvTranspose3d(32, 1, 3, stride=2, padding=1, output_padding=1)
        self.regression = SoftArgmax(1)

    def outputs(self, left: Tensor, right: Tensor) -> VolumeOutputs:
        """Cost volume (Sec. 3.2) and scores at full resolution (Sec. 3.3), see `VolumeModel`."""
        self.check_views(left, right)
        volume = self.cost_volume(self.features(left), self.features(right))
        skips = [self.skips[0](volume)]
        x = volume
        for down, skip in zip(self.down, self.skips[1:], strict=True):
            skips.append(skip(x))
            x = down(x)
        x = self.bottom(x)
        for up in self.up:
            x = F.relu(up(x) + skips.pop())
        scores = -self.cost(x).squeeze(1)  # the softmin of Sec. 3.4
        return VolumeOutputs([scores], volume, self.regression)

    def cost_volume(self, left: Tensor, right: Tensor) -> Tensor:
        """Features (B, 32, H, W) of both views -> (B, 64, D, H, W).

        The left features are whole in every plane, the right ones zero where there are none.
        """
        planes = self.max_disparity // 2
        shifted = cost_volume(lambda _, right: right, left, right, planes)
        return torch.cat((left.unsqueeze(2).expand_as(shifted), shifted), dim=1)

    def training_loss(self, outputs: VolumeOutputs, disparity: Tensor, valid: Tensor) -> Tensor:
        """Mean absolute error (Sec. 3.5), see `StereoModel`."""
        truth = torch.where(valid, disparity, outputs.disparity)
        return (outputs.disparity - truth).abs().sum() / valid.sum().clamp_min(1)


def _conv(
    dims: int, inputs: int, outputs: int, *, kernel: int = 3, stride: int = 1
) -> nn.Sequential:
    """Convolution with bias, and batch norm.

    The ReLUs are functional: MobileStereoNet's count of MACs leaves them out.
    """
    return conv_norm(
        dims, inputs, outputs, kernel=kernel, stride=stride, bias=True, activation=None
    )
