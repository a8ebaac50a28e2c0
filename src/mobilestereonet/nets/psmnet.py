"""PSMNet (Chang and Chen, "Pyramid Stereo Matching Network", CVPR 2018), stacked and basic.

Where the released code departs from the paper, this follows the code, whose weights need it: the
last two stages of the features have dilations 1 and 2, in the paper 2 and 4.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, cast

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from mobilestereonet.errors import check_multiple
from mobilestereonet.nets.blocks import conv_norm, initialise, transposed_norm
from mobilestereonet.nets.features import FeatureExtraction
from mobilestereonet.nets.hourglass import Head, PreHourglass
from mobilestereonet.nets.msnet import BASELINE3D
from mobilestereonet.nets.operations import concatenate, cost_volume
from mobilestereonet.nets.registry import register_model
from mobilestereonet.nets.soft_argmax import SoftArgmax
from mobilestereonet.nets.volume_model import VolumeModel, VolumeOutputs

POOLING = (8, 16, 32, 64)
"""Sides of the pyramid's pooling windows, in pixels of the features."""

FEATURES = 32
"""Channels per view that enter the cost volume."""


@dataclass(frozen=True, kw_only=True)
class PSMNetConfig:
    """PSMNet as data.

    Attributes:
        max_disparity: Disparities 0 .. max_disparity - 1 are searched; a multiple of 16.
        stacked: Three stacked hourglasses (Sec. 3.4); otherwise the "basic" residual blocks.
        align_corners: Upsample with aligned corners, which the authors' KITTI weights and their
            first SceneFlow weights need; those of 2021 and new ones take half-pixel centres.
    """

    max_disparity: int = 192
    stacked: bool = True
    align_corners: bool = False

    free_fields: ClassVar[tuple[str, ...]] = ("max_disparity", "align_corners")
    """Fields that do not change what a network is called, see `model_name`."""

    untold: ClassVar[dict[str, str]] = {"align_corners": "weights from before 2021 need true"}
    """Fields that the authors' checkpoints do not tell, and what to know of them."""

    def __post_init__(self) -> None:
        check_multiple("max_disparity", self.max_disparity, 16)


class PyramidFeatures(nn.Module):
    """Trunk and spatial pyramid pooling (Sec. 3.2).

    Args:
        windows: Sides of the pooling windows.
        eighth: Features at an eighth of the resolution, as in DeepPruner-Fast, not at a quarter.
        align_corners: See `PSMNetConfig`.
    """

    def __init__(
        self,
        windows: Sequence[int] = POOLING,
        *,
        eighth: bool = False,
        align_corners: bool = False,
    ) -> None:
        super().__init__()
        self.eighth, self.align_corners = eighth, align_corners
        # The residual stages are those of PSMNet.
        self.trunk = FeatureExtraction(BASELINE3D, eighth=eighth)
        self.pools = nn.ModuleList(nn.AvgPool2d(side) for side in windows)
        self.branches = nn.ModuleList(conv_norm(2, 128, 32, kernel=1) for _ in windows)
        channels = (128 if eighth else 64) + 128 + 32 * len(windows)
        self.fusion = nn.Sequential(
            conv_norm(2, channels, 128), nn.Conv2d(128, FEATURES, 1, bias=False)
        )

    def forward(self, image: Tensor) -> Tensor:
        """(B, 3, H, W), sides of at least the largest window -> (B, 32, H / 4, W / 4) or / 8."""
        return self.levels(image)[0]

    def levels(self, image: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """The features, and stages 2 and 1: (B, 64, H / 4, W / 4) and (B, 32, H / 2, W / 2)."""
        stage1, stage2, stage3, stage4 = self.trunk.stages(image)
        regions = [
            F.interpolate(
                branch(pool(stage4)),
                size=stage4.shape[-2:],
                mode="bilinear",
                align_corners=self.align_corners,
            )
            for pool, branch in zip(self.pools, self.branches, strict=True)
        ]
        joined = torch.cat((stage3 if self.eighth else stage2, stage4, *regions), dim=1)
        return self.fusion(joined), stage2, stage1


class StackedHourglass(nn.Module):
    """One of the stacked hourglasses (Table 1 of the paper); 64 channels at both lower levels."""

    def __init__(self) -> None:
        super().__init__()
        self.conv1 = conv_norm(3, 32, 64, stride=2)
        self.conv2 = conv_norm(3, 64, 64, activation=None)
        self.conv3 = conv_norm(3, 64, 64, stride=2)
        self.conv4 = conv_norm(3, 64, 64)
        self.up5 = transposed_norm(3, 64, 64)
        self.up6 = transposed_norm(3, 64, 32)

    def forward(
        self, x: Tensor, first_down: Tensor | None, previous_up: Tensor | None
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Down by 4 and up again.

        Args:
            x: (B, 32, D, H, W), sizes multiples of 4.
            first_down: Half-resolution features of the first hourglass on the way down ("pre" in
                the release), which its successors add on their way up; None in the first, which
                adds its own.
            previous_up: Half-resolution features of the previous hourglass on the way up ("post");
                None in the first.

        Returns:
            The result (B, 32, D, H, W), and this hourglass's half-resolution features (B, 64,
            D / 2, H / 2, W / 2) on the way down and on the way up.
        """
        down = self.conv2(self.conv1(x))
        down = F.relu(down if previous_up is None else down + previous_up)
        bottom = self.conv4(self.conv3(down))
        up = F.relu(self.up5(bottom) + (down if first_down is None else first_down))
        return self.up6(up), down, up


_INFORMATION: dict[str, Any] = {
    "paper": "Chang and Chen, Pyramid Stereo Matching Network, CVPR 2018",
    "recipes": ("psmnet-sceneflow", "psmnet-kitti2015"),
}


@register_model(
    "psmnet-basic", config=PSMNetConfig(stacked=False), checkpoints="none", **_INFORMATION
)
@register_model(
    "psmnet",
    **_INFORMATION,
    licence="MIT (code; nothing is said about the weights, KITTI's and SceneFlow's terms apply)",
    checkpoints="JiaRenChang/PSMNet on GitHub: pretrained_sceneflow_new.tar (align_corners=False); "
    "pretrained_sceneflow.tar, pretrained_model_KITTI2015.tar and pretrained_model_KITTI2012.tar "
    "(align_corners=True)",
    trained_on="SceneFlow cleanpass; that and KITTI 2015 or KITTI 2012",
    published={
        "SceneFlow EPE, px": 1.09,
        "SceneFlow EPE of pretrained_sceneflow_new.tar by its author, px": 0.974,
        "KITTI 2015 test D1-all, %": 2.32,
    },
)
class PSMNet(VolumeModel):
    """Pyramid features, a concatenation volume and a 3D encoder-decoder.

    Views need sides of at least 256 px, for the largest pooling window.
    """

    config: PSMNetConfig
    min_side = 4 * POOLING[-1]

    def __init__(self, config: PSMNetConfig) -> None:
        super().__init__(config)
        self.features = PyramidFeatures(align_corners=config.align_corners)
        self.pre_hourglass = PreHourglass(BASELINE3D, 2 * FEATURES)
        if config.stacked:
            self.head_weights = (0.5, 0.7, 1.0)
            self.hourglasses = nn.ModuleList(StackedHourglass() for _ in range(3))
            self.heads = nn.ModuleList(Head(BASELINE3D) for _ in range(3))
        else:
            self.blocks = nn.ModuleList(
                nn.Sequential(conv_norm(3, 32, 32), conv_norm(3, 32, 32, activation=None))
                for _ in range(3)
            )
            self.head = Head(BASELINE3D)
        self.regression = SoftArgmax(4, align_corners=config.align_corners)
        initialise(self)

    def outputs(self, left: Tensor, right: Tensor) -> VolumeOutputs:
        """Concatenation volume (Sec. 3.3) and scores (Sec. 3.4), see `VolumeModel`."""
        self.check_views(left, right)
        left, right = self.features(left), self.features(right)
        volume = cost_volume(concatenate, left, right, self.max_disparity // 4)
        x = self.pre_hourglass(volume)
        scores = self._stacked_scores(x) if self.config.stacked else [self._basic_scores(x)]
        return VolumeOutputs(scores if self.training else scores[-1:], volume, self.regression)

    def _stacked_scores(self, x: Tensor) -> list[Tensor]:
        """Each head adds to the scores of the one before: all three run in eval mode, too."""
        first_down = previous_up = None
        y = x
        scores: list[Tensor] = []
        for hourglass, head in zip(self.hourglasses, self.heads, strict=True):
            y, down, previous_up = hourglass(y, first_down, previous_up)
            first_down = down if first_down is None else first_down
            y = y + x
            scores.append(head(y) + scores[-1] if scores else head(y))
        return scores

    def _basic_scores(self, x: Tensor) -> Tensor:
        for block in self.blocks:
            x = block(x) + x
        return cast(Tensor, self.head(x))
