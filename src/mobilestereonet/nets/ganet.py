"""GA-Net (Zhang et al., "GA-Net: Guided Aggregation Net", CVPR 2019): GA-Net-11 and GA-Net-deep."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Any, NamedTuple, cast

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from mobilestereonet.errors import InputError, check_multiple
from mobilestereonet.nets.blocks import conv_norm, initialise
from mobilestereonet.nets.guided_aggregation import LocalAggregation, SemiGlobalAggregation
from mobilestereonet.nets.model import (
    Prediction,
    Preprocessing,
    StereoModel,
    smooth_l1_of_heads,
)
from mobilestereonet.nets.operations import concatenate, cost_volume
from mobilestereonet.nets.registry import register_model

LEVELS = (32, 48, 64, 96, 128)
"""Channels of the features, from a third of the resolution down."""


@dataclass(frozen=True, kw_only=True)
class GANetConfig:
    """GA-Net as data.

    Attributes:
        max_disparity: Disparities 0 .. max_disparity are searched; a multiple of 12.
        passes: Passes of the aggregation down to a quarter of its volume and up again: 1 in
            GA-Net-11, 2 in GA-Net-deep.
    """

    max_disparity: int = 192
    passes: int = 2

    def __post_init__(self) -> None:
        check_multiple("max_disparity", self.max_disparity, 12)
        if self.passes not in (1, 2):
            raise InputError(f"passes must be 1 or 2, got {self.passes}")


class Joined(nn.Module):
    """Halves or doubles the size, and joins an earlier map of that size ("2x" block).

    Args:
        dims: 2 for maps, 3 for volumes.
        inputs: Channels of the input.
        outputs: Channels of the earlier map and of the result.
        up: Double the size by a transposed convolution, otherwise halve it.
        activation: A ReLU at the end.
    """

    def __init__(
        self, dims: int, inputs: int, outputs: int, *, up: bool, activation: bool = True
    ) -> None:
        super().__init__()
        self.resize = (
            _doubled(dims, inputs, outputs) if up else conv_norm(dims, inputs, outputs, stride=2)
        )
        self.join = conv_norm(
            dims, 2 * outputs, outputs, activation=nn.ReLU if activation else None
        )

    def forward(self, x: Tensor, earlier: Tensor) -> Tensor:
        """(B, inputs, ...) and (B, outputs, ...) -> (B, outputs, ...)."""
        return cast(Tensor, self.join(torch.cat((self.resize(x), earlier), dim=1)))


class Features(nn.Module):
    """Two U-shaped passes (Sec. 3.3): (B, 3, H, W) -> (B, 32, H / 3, W / 3)."""

    def __init__(self) -> None:
        super().__init__()
        downwards, upwards = list(pairwise(LEVELS)), list(pairwise(LEVELS[::-1]))
        self.start = nn.Sequential(
            conv_norm(2, 3, 32), conv_norm(2, 32, 32, kernel=5, stride=3), conv_norm(2, 32, 32)
        )
        self.down1 = nn.ModuleList(conv_norm(2, i, o, stride=2) for i, o in downwards)
        self.up1 = nn.ModuleList(Joined(2, i, o, up=True) for i, o in upwards)
        self.down2 = nn.ModuleList(Joined(2, i, o, up=False) for i, o in downwards)
        self.up2 = nn.ModuleList(Joined(2, i, o, up=True) for i, o in upwards)

    def forward(self, image: Tensor) -> Tensor:
        """H and W multiples of 48."""
        maps = [self.start(image)]
        for down in self.down1:
            maps.append(down(maps[-1]))
        for blocks in (self.up1, self.down2, self.up2):
            maps.reverse()  # largest first on the way down, smallest first on the way up
            for level, block in enumerate(blocks, start=1):
                maps[level] = block(maps[level - 1], maps[level])
        return cast(Tensor, maps[-1])


class GuidanceMaps(NamedTuple):
    """Weights of all guided layers.

    Attributes:
        thirds: Of the SGAs at a third of the resolution, (B, 640, H / 3, W / 3) each.
        sixths: Of those at a sixth, (B, 960, H / 6, W / 6) each.
        local: Of the LGAs before and after the softmin, (B, 75, H, W) each.
    """

    thirds: list[Tensor]
    sixths: list[Tensor]
    local: list[Tensor]


class Guidance(nn.Module):
    """Guidance subnet (Sec. 3.3): weights from the left view and its features."""

    def __init__(self, passes: int) -> None:
        super().__init__()
        self.image = nn.Sequential(conv_norm(2, 3, 16), conv_norm(2, 16, 32))
        self.features = _conv(2, 32, 32)
        self.features_norm = nn.Sequential(nn.BatchNorm2d(32), nn.ReLU(inplace=True))
        self.start = conv_norm(2, 64, 16)
        self.local = nn.ModuleList(
            nn.Sequential(conv_norm(2, 16, 16), _conv(2, 16, 75)) for _ in range(2)
        )
        first = nn.Sequential(conv_norm(2, 16, 32, kernel=5, stride=3), conv_norm(2, 32, 32))
        self.steps3 = nn.ModuleList([first, *(conv_norm(2, 32, 32) for _ in range(passes))])
        self.weights3 = nn.ModuleList(_conv(2, 32, 20 * 32) for _ in range(passes + 1))
        first = nn.Sequential(conv_norm(2, 32, 48, stride=2), conv_norm(2, 48, 48))
        self.steps6 = nn.ModuleList([first, *(conv_norm(2, 48, 48) for _ in range(2 * passes - 1))])
        self.weights6 = nn.ModuleList(_conv(2, 48, 20 * 48) for _ in range(2 * passes))

    def forward(self, image: Tensor, features: Tensor) -> GuidanceMaps:
        """Left views (B, 3, H, W) and their features (B, 32, H / 3, W / 3)."""
        fine = F.interpolate(self.features(features), size=image.shape[-2:], mode="bilinear")
        x = self.start(torch.cat((self.image(image), self.features_norm(fine)), dim=1))
        maps = GuidanceMaps([], [], [branch(x) for branch in self.local])
        for found, steps, weights in (
            (maps.thirds, self.steps3, self.weights3),
            (maps.sixths, self.steps6, self.weights6),
        ):
            for step, weight in zip(steps, weights, strict=True):
                x = step(x)
                found.append(weight(x))
        return maps


class GuidedBlock(nn.Module):
    """SGA and a 3x3x3 convolution, with a skip around both."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.aggregation = SemiGlobalAggregation()
        self.norm = nn.Sequential(nn.BatchNorm3d(channels), nn.ReLU(inplace=True))
        self.conv = conv_norm(3, channels, channels, activation=None)

    def forward(self, x: Tensor, guidance: Tensor) -> Tensor:
        """(B, C, D, H, W) and guidance (B, 20 C, H, W) -> (B, C, D, H, W)."""
        return F.relu(self.conv(self.norm(self.aggregation(x, guidance))) + x)


class Pass(nn.Module):
    """One pass of the aggregation: down to a quarter of the volume's size and up again.

    Args:
        joined: Join the maps of the pass before on the way down.
    """

    def __init__(self, *, joined: bool) -> None:
        super().__init__()
        self.joined = joined
        self.down1 = Joined(3, 32, 48, up=False) if joined else conv_norm(3, 32, 48, stride=2)
        self.down2 = Joined(3, 48, 64, up=False) if joined else conv_norm(3, 48, 64, stride=2)
        self.up2 = Joined(3, 64, 48, up=True)
        self.up1 = Joined(3, 48, 32, up=True, activation=False)
        self.guided_down = GuidedBlock(48)
        self.guided_up = GuidedBlock(48)
        self.guided = GuidedBlock(32)

    def forward(
        self, x: Tensor, earlier: list[Tensor], sixths: list[Tensor], third: Tensor
    ) -> tuple[Tensor, list[Tensor]]:
        """Aggregate.

        Args:
            x: (B, 32, D, H, W).
            earlier: The pass before's volumes of half and of a quarter of the size; none in the
                first pass.
            sixths: Guidance on the way down and on the way up.
            third: Guidance at full size.

        Returns:
            The result, and its volumes of half and of a quarter of the size.
        """
        joins = [[volume] for volume in earlier] if self.joined else [[], []]
        half = self.guided_down(self.down1(x, *joins[0]), sixths[0])
        quarter = self.down2(half, *joins[1])
        half = self.guided_up(self.up2(quarter, half), sixths[1])
        return self.guided(self.up1(half, x), third), [half, quarter]


class Regression(nn.Module):
    """3x3x3 convolution to costs, upsampling, and the expectation under the softmin."""

    def __init__(self, max_disparity: int) -> None:
        super().__init__()
        self.disparities = max_disparity + 1
        self.cost = _conv(3, 32, 1)
        self.local = LocalAggregation()

    def forward(self, x: Tensor, local: list[Tensor] | None = None) -> Tensor:
        """Disparity (B, 3 H, 3 W) in pixels.

        Args:
            x: (B, 32, D, H, W).
            local: Guidance of the LGAs before and after the softmin; None: without them.
        """
        size = (self.disparities, *(3 * side for side in x.shape[-2:]))
        costs = F.interpolate(self.cost(x), size=size, mode="trilinear").squeeze(1)
        if local is None:
            probability = F.softmin(costs, dim=1)
        else:
            probability = F.softmin(self.local(costs, local[0]), dim=1)
            probability = F.normalize(self.local(probability, local[1]), p=1, dim=1)
        d = torch.arange(self.disparities, dtype=x.dtype, device=x.device)[:, None, None]
        return (probability * d).sum(dim=1)


class GANetOutputs(NamedTuple):
    """Disparities (B, H, W) of all heads, first to last, in pixels."""

    disparities: list[Tensor]

    @property
    def disparity(self) -> Tensor:
        """Disparity of the last head, (B, H, W)."""
        return self.disparities[-1]


_RELEASE: dict[str, Any] = {
    "paper": "Zhang et al., GA-Net: Guided Aggregation Net for End-to-end Stereo Matching, "
    "CVPR 2019",
    "licence": "MIT (code; nothing is said about the weights, KITTI's and SceneFlow's terms apply)",
    "recipes": ("ganet-sceneflow", "ganet-kitti2015"),
}


@register_model("ganet-11", config=GANetConfig(passes=1), checkpoints="none", **_RELEASE)
@register_model(
    "ganet-deep",
    checkpoints="feihuzhang/GANet on GitHub: SceneFlow, KITTI 2012, KITTI 2015",
    trained_on="SceneFlow finalpass; that and KITTI 2012 or KITTI 2015",
    published={
        "SceneFlow EPE, px": 0.78,
        "KITTI 2012 test, wrong by more than 3 px, all pixels, %": 1.60,
        "KITTI 2015 test D1-all, %": 1.81,
    },
    **_RELEASE,
)
class GANet(StereoModel):
    """Concatenation volume, aggregated by layers whose weights the left view gives.

    The last head's probabilities go through an LGA: they are no softmax of scores, and there is no
    confidence.
    """

    config: GANetConfig
    preprocessing = Preprocessing(per_image=True)
    size_multiple = 48
    exportable = False  # the semi-global aggregation goes line by line through the volume

    def __init__(self, config: GANetConfig) -> None:
        super().__init__(config)
        self.head_weights = (0.4, 1.2) if config.passes == 1 else (0.2, 0.6, 1.0)
        self.features = Features()
        self.left, self.right = conv_norm(2, 32, 32), conv_norm(2, 32, 32)
        self.guidance = Guidance(config.passes)
        self.start = conv_norm(3, 64, 32, activation=None)
        self.guided = GuidedBlock(32)
        self.passes = nn.ModuleList(Pass(joined=index > 0) for index in range(config.passes))
        self.heads = nn.ModuleList(
            Regression(config.max_disparity) for _ in range(config.passes + 1)
        )
        initialise(self)

    def forward(self, left: Tensor, right: Tensor) -> Any:
        """A `Prediction` in eval mode, `GANetOutputs` in training mode; see `StereoModel`."""
        self.check_views(left, right)
        features = self.features(left)
        guidance = self.guidance(left, features)
        volume = cost_volume(
            concatenate,
            self.left(features),
            self.right(self.features(right)),
            self.max_disparity // 3 + 1,
        )
        x = self.guided(self.start(volume), guidance.thirds[0])
        disparities = []
        earlier: list[Tensor] = []
        for index, (head, aggregation) in enumerate(zip(self.heads[:-1], self.passes, strict=True)):
            if self.training:
                disparities.append(head(x))
            sixths = guidance.sixths[2 * index : 2 * index + 2]
            x, earlier = aggregation(x, earlier, sixths, guidance.thirds[index + 1])
        disparity = self.heads[-1](x, guidance.local)
        return GANetOutputs([*disparities, disparity]) if self.training else Prediction(disparity)

    def training_loss(self, outputs: GANetOutputs, disparity: Tensor, valid: Tensor) -> Tensor:
        """Smooth L1 of all heads, weighted (Sec. 3.4), see `StereoModel`."""
        return smooth_l1_of_heads(outputs.disparities, self.head_weights, disparity, valid)


def _conv(dims: int, inputs: int, outputs: int) -> nn.Conv2d | nn.Conv3d:
    """3x3(x3) convolution without bias and norm."""
    kind = nn.Conv2d if dims == 2 else nn.Conv3d
    return kind(inputs, outputs, 3, padding=1, bias=False)


def _doubled(dims: int, inputs: int, outputs: int) -> nn.Sequential:
    """4x4 or 3x4x4 transposed convolution, norm, ReLU: 2 D - 1 planes of the double size."""
    layers: list[nn.Module] = (
        [nn.ConvTranspose2d(inputs, outputs, 4, stride=2, padding=1, bias=False)]
        if dims == 2
        else [nn.ConvTranspose3d(inputs, outputs, (3, 4, 4), stride=2, padding=1, bias=False)]
    )
    layers += [nn.BatchNorm2d(outputs) if dims == 2 else nn.BatchNorm3d(outputs)]
    return nn.Sequential(*layers, nn.ReLU(inplace=True))
