"""DispNets with a correlation layer: DispNet-Corr1D and DispNet-C.

DispNet-Corr1D: Mayer et al., "A Large Dataset to Train Convolutional Networks for Disparity,
Optical Flow, and Scene Flow Estimation", CVPR 2016. It is also the first stage of CRL and iResNet.
DispNet-C: Ilg et al., "Occlusions, Motion and Depth Boundaries with a Generic Network for
Disparity, Optical Flow or Scene Flow Estimation", ECCV 2018.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from mobilestereonet.errors import check_multiple
from mobilestereonet.nets.model import RGB, Preprocessing
from mobilestereonet.nets.operations import Correlation1D
from mobilestereonet.nets.registry import register_model
from mobilestereonet.nets.regression import (
    DecoderLevel,
    RegressionConfig,
    RegressionModel,
    RegressionOutputs,
    conv,
    enlarged,
    initialise,
    positive,
    predictor,
    transposed,
)

REACH = 40
"""Largest displacement of the correlation, in pixels of the features, to either side."""

CORRELATION = 2 * REACH + 1
"""Channels of the correlation."""


class DispNetCorr1DConfig(RegressionConfig):
    """DispNet-Corr1D as data."""


class Stage(NamedTuple):
    """What `Corr1DStage` computes.

    Attributes:
        features: (B, w / 2, H / 2, W / 2).
        predictions: Of levels 6 to 1, (B, 1, H / 64, W / 64) to (B, 1, H / 2, W / 2).
        half: First features of the left and the right view, (B, w, H / 2, W / 2).
        quarter: Second features likewise, (B, 2 w, H / 4, W / 4).
    """

    features: Tensor
    predictions: list[Tensor]
    half: tuple[Tensor, Tensor]
    quarter: tuple[Tensor, Tensor]


class Corr1DStage(nn.Module):
    """DispNet-Corr1D, from the views to the prediction at half the resolution.

    Args:
        width: Channels w of the first convolution.
        kernel: Kernel size of the first convolution after the correlation.
        activation: None is a leaky ReLU after each convolution but those that fuse and predict.
            Another one stands after the fusions, too.
    """

    def __init__(self, width: int, kernel: int = 5, activation: nn.Module | None = None) -> None:
        super().__init__()
        w, act = width, activation
        self.conv1 = conv(3, w, 7, 2, act)
        self.conv2 = conv(w, 2 * w, 5, 2, act)
        self.correlate = Correlation1D(REACH)
        self.redirect = conv(2 * w, w, 1, 1, act)
        self.conv3 = nn.Sequential(
            conv(CORRELATION + w, 4 * w, kernel, 2, act), conv(4 * w, 4 * w, activation=act)
        )
        self.conv4 = down(4 * w, 8 * w, act)
        self.conv5 = down(8 * w, 8 * w, act)
        self.conv6 = down(8 * w, 16 * w, act)
        self.predict6 = predictor(16 * w)
        sizes = ((16, 8, 8), (8, 8, 4), (4, 4, 2), (2, 2, 1))
        levels = [
            DecoderLevel(a * w, b * w, c * w, activation=act, fusion_activation=act)
            for a, b, c in sizes
        ]
        levels += [DecoderLevel(w, w, w // 2, activation=act, fusion_activation=act)]
        self.levels = nn.ModuleList(levels)

    def forward(self, left: Tensor, right: Tensor) -> Stage:
        """Left and right views (B, 3, H, W), H and W multiples of 64."""
        half = self.conv1(left), self.conv1(right)
        quarter = self.conv2(half[0]), self.conv2(half[1])
        correlation = self.correlate(*quarter)
        conv3 = self.conv3(torch.cat((correlation, self.redirect(quarter[0])), dim=1))
        conv4 = self.conv4(conv3)
        conv5 = self.conv5(conv4)
        features = self.conv6(conv5)
        predictions = [self.predict6(features)]
        skips = (conv5, conv4, conv3, quarter[0], half[0])
        for level, skip in zip(self.levels, skips, strict=True):
            features, prediction = level(features, predictions[-1], skip)
            predictions.append(prediction)
        return Stage(features, predictions, half, quarter)


def down(inputs: int, outputs: int, activation: nn.Module | None = None) -> nn.Sequential:
    """Two 3x3 convolutions, the first of stride 2."""
    return nn.Sequential(
        conv(inputs, outputs, 3, 2, activation), conv(outputs, outputs, activation=activation)
    )


class BGRModel(RegressionModel):
    """A network of the Caffe releases: it takes BGR without the mean of its training views.

    Attributes:
        means: Mean of blue, green and red of the left and the right view, (2, 3), in the weights.
    """

    preprocessing = RGB
    means: Tensor

    def __init__(self, config: object) -> None:
        super().__init__(config)
        self.register_buffer("means", torch.full((2, 3), 0.4))

    def centred(self, left: Tensor, right: Tensor) -> tuple[Tensor, Tensor]:
        """Views in RGB as the network takes them.

        Raises:
            InputError: If the shapes do not fit, see `check_views`.
        """
        self.check_views(left, right)
        left_mean, right_mean = self.means[..., None, None]
        return left.flip(1) - left_mean, right.flip(1) - right_mean


@register_model(
    "dispnet-corr1d",
    paper="Mayer et al., A Large Dataset to Train Convolutional Networks for Disparity, Optical "
    "Flow, and Scene Flow Estimation, CVPR 2016",
    licence="GPL v3 (scripts); nothing is said about the weights",
    checkpoints="lmb-freiburg/dispnet-flownet-docker on GitHub: DispNetCorr1D, DispNetCorr1D-K "
    "(Caffe)",
    trained_on="FlyingThings3D; that and KITTI",
)
class DispNetCorr1D(BGRModel):
    """Correlation at a quarter of the resolution, in an encoder-decoder; prediction at half."""

    config: DispNetCorr1DConfig
    # Training code with the authors' weights is not public: DispNet-C's, doubled once more.
    head_weights = (1 / 16, 1 / 16, 1 / 16, 1 / 8, 1 / 4, 1 / 2)

    def __init__(self, config: DispNetCorr1DConfig) -> None:
        super().__init__(config)
        self.stage = Corr1DStage(config.width)
        initialise(self)

    def outputs(self, left: Tensor, right: Tensor) -> RegressionOutputs:
        """Predictions at 1/64 to 1/2 of the resolution, see `RegressionModel`."""
        predictions = self.stage(*self.centred(left, right)).predictions
        disparity = enlarged((-predictions[-1]).clamp_min(0), 2)[:, 0]
        return RegressionOutputs(positive(predictions), disparity)


@dataclass(frozen=True, kw_only=True)
class DispNetCConfig:
    """DispNet-C as data.

    Attributes:
        max_disparity: Disparities below this are trained on; the network can give any.
        width: Channels of the first convolution, to which all others are in proportion: 64, or 24
            in the authors' "css".
        occlusion: Also classify pixels as occluded, as the networks in the authors' stacks do.
            (There is no loss for it here.)
    """

    max_disparity: int = 192
    width: int = 64
    occlusion: bool = False

    def __post_init__(self) -> None:
        check_multiple("width", self.width, 8)


@register_model(
    "dispnet-c",
    paper="Ilg et al., Occlusions, Motion and Depth Boundaries with a Generic Network for "
    "Disparity, Optical Flow or Scene Flow Estimation, ECCV 2018",
    licence="GPL v3",
    checkpoints="none that can be read here; lmb-freiburg/netdef_models on GitHub has it as the "
    "first network of its stacks CSS and css (TensorFlow snapshots)",
    trained_on="FlyingThings3D; that and KITTI",
    recipes=("dispnet-c-sceneflow",),
)
class DispNetC(RegressionModel):
    """Correlation at an eighth of the resolution, in an encoder-decoder; prediction at a quarter.

    Its decoder passes on the concatenations themselves: no convolution fuses them.
    """

    config: DispNetCConfig
    preprocessing = Preprocessing((0.4, 0.4, 0.4))
    head_weights = (1 / 16, 1 / 16, 1 / 16, 1 / 8, 1 / 4)

    def __init__(self, config: DispNetCConfig) -> None:
        super().__init__(config)
        w, outputs = config.width, 3 if config.occlusion else 1
        self.conv1 = conv(3, w, 7, 2)
        self.conv2 = conv(w, 2 * w, 5, 2)
        self.conv3 = conv(2 * w, 4 * w, 5, 2)
        self.correlate = Correlation1D(REACH)
        self.redirect = conv(4 * w, w // 2, 1)
        self.conv3_1 = conv(w // 2 + CORRELATION, 4 * w)
        self.conv4 = down(4 * w, 8 * w)
        self.conv5 = down(8 * w, 8 * w)
        self.conv6 = down(8 * w, 16 * w)
        self.ups, self.predictors = nn.ModuleList(), nn.ModuleList([predictor(16 * w, outputs)])
        below = 16 * w
        for skip, up in ((8 * w, 8 * w), (8 * w, 4 * w), (4 * w, 2 * w), (2 * w, w)):
            self.ups.append(transposed(below, up))
            below = skip + up + outputs
            self.predictors.append(predictor(below, outputs))
        initialise(self)

    def outputs(self, left: Tensor, right: Tensor) -> RegressionOutputs:
        """Predictions at 1/64 to 1/4 of the resolution, see `RegressionModel`."""
        self.check_views(left, right)
        conv2 = self.conv2(self.conv1(left))
        left_features = self.conv3(conv2)
        right_features = self.conv3(self.conv2(self.conv1(right)))
        correlation = F.relu(self.correlate(left_features, right_features))
        conv3 = self.conv3_1(torch.cat((self.redirect(left_features), correlation), dim=1))
        conv4 = self.conv4(conv3)
        conv5 = self.conv5(conv4)
        features = self.conv6(conv5)
        predictions = [self.predictors[0](features)]
        skips = (conv5, conv4, conv3, conv2)
        for skip, up, predict in zip(skips, self.ups, self.predictors[1:], strict=True):
            told = enlarged(predictions[-1].detach(), 2)  # without a gradient, as in the release
            features = torch.cat((skip, up(features), told), dim=1)
            predictions.append(predict(features))
        final = enlarged(predictions[-1], 4)
        occlusion = final[:, 1:].softmax(dim=1) if self.config.occlusion else None
        disparity = enlarged((-predictions[-1][:, :1]).clamp_min(0), 4)[:, 0]
        return RegressionOutputs(positive(predictions), disparity, occlusion)
