"""GwcNet (Guo et al., "Group-wise Correlation Stereo Network", CVPR 2019).

GwcNet-g has the group-wise correlation alone: MobileStereoNet's 3D baseline is that network with
one hourglass. GwcNet-gc concatenates the features, too, after a reduction to 12 channels.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor, nn

from mobilestereonet.errors import InputError, check_multiple
from mobilestereonet.nets.blocks import conv_norm, initialise
from mobilestereonet.nets.cost_volumes import Correlation
from mobilestereonet.nets.features import FeatureExtraction
from mobilestereonet.nets.hourglass import Head, Hourglass, PreHourglass
from mobilestereonet.nets.msnet import BASELINE3D, MobileStereoNet
from mobilestereonet.nets.msnet_config import FEATURE_CHANNELS
from mobilestereonet.nets.operations import concatenate, cost_volume
from mobilestereonet.nets.registry import register_model
from mobilestereonet.nets.soft_argmax import SoftArgmax
from mobilestereonet.nets.volume_model import VolumeModel, VolumeOutputs

GROUPS = 40
"""Groups of the correlation, of 8 channels each."""

REDUCED_CHANNELS = 12
"""Channels per view in the concatenation."""


@dataclass(frozen=True, kw_only=True)
class GwcNetConfig:
    """GwcNet with the concatenation ("gc") as data.

    Attributes:
        max_disparity: Disparities 0 .. max_disparity - 1 are searched; a multiple of 16.
        hourglasses: Number of stacked hourglasses, at least 1.
    """

    max_disparity: int = 192
    hourglasses: int = 3

    def __post_init__(self) -> None:
        check_multiple("max_disparity", self.max_disparity, 16)
        if self.hourglasses < 1:
            raise InputError(f"hourglasses must be at least 1, got {self.hourglasses}")


_INFORMATION: dict[str, Any] = {
    "paper": "Guo et al., Group-wise Correlation Stereo Network, CVPR 2019",
    "recipes": ("gwcnet-sceneflow", "gwcnet-kitti2015"),
}
_RELEASE = {
    **_INFORMATION,
    "licence": "MIT (code; nothing is said about the weights, KITTI's and SceneFlow's terms apply)",
}

register_model(
    "gwcnet-g",
    config=replace(BASELINE3D, hourglasses=3),
    checkpoints="xy-guo/GwcNet on GitHub: kitti15/gwcnet-g/best.ckpt",
    trained_on="SceneFlow finalpass and KITTI 2015",
    published={"SceneFlow EPE, px": 0.79, "KITTI 2015 test D1-all, %": 2.11},
    **_RELEASE,
)(MobileStereoNet)


# Its ablation's base: MobileStereoNet's tables call it Gwc40-Cat24-Base.
@register_model(
    "gwcnet-gc-base", config=GwcNetConfig(hourglasses=1), checkpoints="none", **_INFORMATION
)
@register_model(
    "gwcnet-gc",
    checkpoints="xy-guo/GwcNet on GitHub: sceneflow/gwcnet-gc/checkpoint_000015.ckpt, "
    "kitti12/gwcnet-gc/best.ckpt",
    trained_on="SceneFlow finalpass; that and KITTI 2012",
    published={"SceneFlow EPE, px": 0.765},
    **_RELEASE,
)
class GwcNet(VolumeModel):
    """Group-wise correlation and concatenation in one volume, and stacked hourglasses."""

    config: GwcNetConfig
    head_weights = (0.5, 0.5, 0.7, 1.0)

    def __init__(self, config: GwcNetConfig) -> None:
        super().__init__(config)
        self.features = FeatureExtraction(BASELINE3D)
        self.reduction = nn.Sequential(
            conv_norm(2, FEATURE_CHANNELS, 128), nn.Conv2d(128, REDUCED_CHANNELS, 1, bias=False)
        )
        self.correlation = Correlation(GROUPS)
        self.pre_hourglass = PreHourglass(BASELINE3D, GROUPS + 2 * REDUCED_CHANNELS)
        self.hourglasses = nn.ModuleList(Hourglass(BASELINE3D) for _ in range(config.hourglasses))
        self.heads = nn.ModuleList(Head(BASELINE3D) for _ in range(config.hourglasses + 1))
        self.regression = SoftArgmax(4)
        initialise(self)

    def outputs(self, left: Tensor, right: Tensor) -> VolumeOutputs:
        """Cost volume (Sec. 3.2) and scores (Sec. 3.3), see `VolumeModel`."""
        self.check_views(left, right)
        volume = self.cost_volume(self.features(left), self.features(right))
        x = self.pre_hourglass(volume)
        scores = []
        for head, hourglass in zip(self.heads[:-1], self.hourglasses, strict=True):
            if self.training:
                scores.append(head(x))
            x = hourglass(x)
        return VolumeOutputs([*scores, self.heads[-1](x)], volume, self.regression)

    def cost_volume(self, left: Tensor, right: Tensor) -> Tensor:
        """Features (B, 320, H, W) of both views -> (B, 40 + 24, D, H, W)."""
        planes = self.max_disparity // 4
        correlation = self.correlation(left, right, planes)
        left, right = self.reduction(left), self.reduction(right)
        return torch.cat((correlation, cost_volume(concatenate, left, right, planes)), dim=1)
