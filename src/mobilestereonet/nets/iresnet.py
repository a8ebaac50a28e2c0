"""iResNet (Liang et al., "Learning for Disparity Estimation through Feature Constancy", CVPR 2018).

The authors' Caffe release with two refinements; and the variant in PyTorch for which Aleotti et
al., "Reversing the cycle: self-supervised deep stereo through enhanced monocular distillation",
ECCV 2020, released weights.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from mobilestereonet.errors import InputError, check_multiple
from mobilestereonet.nets.dispnet import BGRModel, Corr1DStage, Stage
from mobilestereonet.nets.model import RGB
from mobilestereonet.nets.operations import Correlation1D
from mobilestereonet.nets.registry import register_model
from mobilestereonet.nets.regression import (
    DecoderLevel,
    RegressionConfig,
    RegressionModel,
    RegressionOutputs,
    conv,
    initialise,
    positive,
    predictor,
    transposed,
)
from mobilestereonet.nets.resampling import along_rows, flow_warp, remap

FINE_REACH = 20
"""Largest displacement of the refinement's correlation, in pixels at half the resolution."""


@dataclass(frozen=True, kw_only=True)
class IResNetConfig:
    """iResNet as data.

    Attributes:
        max_disparity: Disparities below this are trained on; the network can give any.
        width: Channels of the first convolution, to which all others are in proportion.
        iterations: How often the disparity is refined.
    """

    max_disparity: int = 192
    width: int = 64
    iterations: int = 2

    def __post_init__(self) -> None:
        check_multiple("width", self.width, 8)
        if self.iterations < 1:
            raise InputError(f"iterations must be at least 1, got {self.iterations}")


class MultiScale(nn.Module):
    """Multi-scale features (Sec. 3.1): first and second features at the full resolution."""

    def __init__(self, width: int, activation: nn.Module | None = None) -> None:
        super().__init__()
        self.up1 = transposed(width, width // 2, 2, activation)
        self.up2 = transposed(2 * width, width // 2, 4, activation)

    def forward(self, half: Tensor, quarter: Tensor) -> Tensor:
        """(B, w, H / 2, W / 2) and (B, 2 w, H / 4, W / 4) -> (B, w, H, W)."""
        return torch.cat((self.up1(half), self.up2(quarter)), dim=1)


class Refinement(nn.Module):
    """Disparity refinement (Sec. 3.3): from features warped by the disparity, its residual."""

    def __init__(self, width: int, activation: nn.Module | None = None) -> None:
        super().__init__()
        w, act = width, activation
        self.conv0 = conv(w + 1, w // 2, activation=act)
        self.conv1 = conv(w // 2, w, 3, 2, act)
        self.conv1b = conv(2 * FINE_REACH + 1 + w, w, activation=act)
        self.conv2 = nn.Sequential(conv(w, 2 * w, 3, 2, act), conv(2 * w, 2 * w, activation=act))
        self.predict2 = predictor(2 * w)
        self.level1 = DecoderLevel(2 * w, w, w, activation=act, fusion_activation=act)
        self.level0 = DecoderLevel(w, w // 2, w // 2, activation=act, fusion_activation=act)

    def forward(
        self, left: Tensor, error: Tensor, disparity: Tensor, correlation: Tensor
    ) -> list[Tensor]:
        """One refinement.

        Args:
            left: Multi-scale features of the left views, (B, w / 2, H, W).
            error: Reconstruction error of those, likewise.
            disparity: (B, 1, H, W).
            correlation: (B, 41, H / 2, W / 2).

        Returns:
            Residuals (B, 1, h, w) at 1/4, 1/2 and all of the resolution.
        """
        conv0 = self.conv0(torch.cat((left, disparity, error), dim=1))
        conv1 = self.conv1b(torch.cat((correlation, self.conv1(conv0)), dim=1))
        features = self.conv2(conv1)
        coarse = self.predict2(features)
        features, middle = self.level1(features, coarse, conv1)
        return [coarse, middle, self.level0(features, middle, conv0)[1]]


_PAPER = "Liang et al., Learning for Disparity Estimation through Feature Constancy, CVPR 2018"


@register_model(
    "iresnet",
    paper=_PAPER,
    licence="BSD 2-clause (code); nothing is said about the weights",
    checkpoints="leonzfa/iResNet on GitHub (Caffe; that of ROB 2018 is another network)",
    trained_on="SceneFlow; that and KITTI 2015",
    recipes=("iresnet-sceneflow",),
)
class IResNet(BGRModel):
    """DispNet-Corr1D at the full resolution, refined by the constancy of multi-scale features."""

    config: IResNetConfig

    def __init__(self, config: IResNetConfig) -> None:
        super().__init__(config)
        w = config.width
        self.stage = Corr1DStage(w)
        self.multi_scale = MultiScale(w)
        self.project_left = conv(w, w // 2, 1)
        self.project_right = conv(w, w // 2, 1)
        self.full = DecoderLevel(w // 2, w // 2, w // 2)
        self.compress = conv(w, w // 4)
        self.correlate = Correlation1D(FINE_REACH)
        self.refinement = Refinement(w)
        # The initial disparity; 1/4, 1/2 and all of the resolution in each refinement.
        self.head_weights = (1.0, *(0.2, 0.2, 1.0) * config.iterations)
        initialise(self)

    def outputs(self, left: Tensor, right: Tensor) -> RegressionOutputs:
        """The initial disparity and all refined ones, see `RegressionModel`."""
        stage: Stage = self.stage(*self.centred(left, right))
        left_features, right_features = (
            project(self.multi_scale(*features))
            for project, features in zip(
                (self.project_left, self.project_right),
                zip(stage.half, stage.quarter, strict=True),
                strict=True,
            )
        )
        left_fine, right_fine = map(self.compress, stage.half)
        correlation = self.correlate(left_fine, right_fine)
        _, disparity = self.full(stage.features, stage.predictions[-1], left_features)
        predictions = [disparity]
        for _ in range(self.config.iterations):
            before = disparity.detach()  # as in the release
            error = (flow_warp(right_features, along_rows(before)) - left_features).abs()
            residuals = self.refinement(left_features, error, before, correlation)
            predictions += [
                residual + F.avg_pool2d(disparity, scale)
                for scale, residual in zip((4, 2, 1), residuals, strict=True)
            ]
            disparity = predictions[-1].clamp_max(0)
        return RegressionOutputs(positive(predictions), -disparity[:, 0])


class ReversingConfig(RegressionConfig):
    """The variant of "Reversing the cycle" as data."""


@register_model(
    "iresnet-reversing",
    paper=_PAPER,
    licence="Apache-2.0",
    checkpoints="FilippoAleotti/Reversing on GitHub",
    trained_on="KITTI without ground truth, on disparities distilled from a monocular network",
)
class ReversingIResNet(RegressionModel):
    """iResNet with ReLUs, positive disparities, and one refinement that gives the disparity itself.

    The authors' code concatenates in other orders; the reader of their weights changes those.
    """

    config: ReversingConfig
    preprocessing = RGB
    head_weights = (1.0, 0.2, 0.2, 1.0)

    def __init__(self, config: ReversingConfig) -> None:
        super().__init__(config)
        w, relu = config.width, nn.ReLU()
        self.stage = Corr1DStage(w, kernel=3, activation=relu)
        self.multi_scale = MultiScale(w, relu)
        self.project = conv(w, w // 2, 1, activation=relu)
        self.full = DecoderLevel(w // 2, w // 2, w // 2, activation=relu, fusion_activation=relu)
        self.compress = conv(w, w // 4, activation=relu)
        self.correlate = Correlation1D(FINE_REACH)
        self.refinement = Refinement(w, relu)
        initialise(self)

    def outputs(self, left: Tensor, right: Tensor) -> RegressionOutputs:
        """The initial disparity and those of the refinement, see `RegressionModel`."""
        self.check_views(left, right)
        stage: Stage = self.stage(left, right)
        left_features, right_features = (
            self.project(self.multi_scale(*features))
            for features in zip(stage.half, stage.quarter, strict=True)
        )
        left_fine, right_fine = map(self.compress, stage.half)
        correlation = self.correlate(left_fine, right_fine)
        _, initial = self.full(stage.features, stage.predictions[-1], left_features)
        error = (remap(right_features, along_rows(-initial)) - left_features).abs()
        predictions = [initial, *self.refinement(left_features, error, initial, correlation)]
        maps = [prediction[:, 0] for prediction in predictions]
        return RegressionOutputs(maps, maps[-1].clamp_min(0))
