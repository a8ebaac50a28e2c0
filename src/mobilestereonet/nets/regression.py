"""What the networks that regress the disparity scale by scale share: DispNet's blocks and loss.

Their releases predict *negative* disparity, the shift along the row from left to right, in pixels
of the full resolution at every scale; so do the blocks here. `RegressionOutputs` has it positive.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from mobilestereonet.errors import check_multiple
from mobilestereonet.nets.model import Prediction, StereoModel

SLOPE = 0.1
"""Slope of the leaky ReLU below zero."""


class RegressionOutputs(NamedTuple):
    """What a `RegressionModel` computes.

    Attributes:
        predictions: Disparity (B, h, w) in pixels of the full resolution at every scale, in the
            order of ``head_weights``; it may be negative.
        disparity: The final one, (B, H, W), not negative.
        occlusion: Probabilities (B, 2, H, W) of occluded and visible, from networks that have them.
    """

    predictions: list[Tensor]
    disparity: Tensor
    occlusion: Tensor | None = None


class RegressionModel(StereoModel):
    """A network that regresses disparity maps of several resolutions.

    Attributes:
        head_weights: Weights of the predictions in the loss.
    """

    head_weights: tuple[float, ...]
    size_multiple = 64

    def outputs(self, left: Tensor, right: Tensor) -> RegressionOutputs:
        """All predictions, see `StereoModel.forward` for the views.

        Raises:
            InputError: If the shapes do not fit, see `check_views`.
        """
        raise NotImplementedError

    def forward(self, left: Tensor, right: Tensor) -> Any:
        """A `Prediction` in eval mode, `RegressionOutputs` in training mode; see `StereoModel`."""
        outputs = self.outputs(left, right)
        return outputs if self.training else Prediction(outputs.disparity)

    def training_loss(self, outputs: RegressionOutputs, disparity: Tensor, valid: Tensor) -> Tensor:
        """L1 of every prediction, weighted; see `StereoModel`."""
        losses = [
            weight * coarse_l1(prediction, disparity, valid)
            for weight, prediction in zip(self.head_weights, outputs.predictions, strict=True)
        ]
        return torch.stack(losses).sum()


def coarse_l1(prediction: Tensor, disparity: Tensor, valid: Tensor) -> Tensor:
    """Mean L1 of a prediction against the mean of the valid pixels in each of its cells.

    Args:
        prediction: (B, h, w), sides that divide those of the ground truth.
        disparity: Ground truth (B, H, W); anything where it is not valid.
        valid: (B, H, W) bool.

    Returns:
        Mean over the cells with a valid pixel, a scalar; 0 where there is none.
    """
    scale = disparity.shape[-1] // prediction.shape[-1]
    share = F.avg_pool2d(valid.to(prediction.dtype), scale)
    truth = F.avg_pool2d(torch.where(valid, disparity, 0), scale)
    known = share > 0
    error = (prediction - truth / share.where(known, 1)).abs()
    return torch.where(known, error, 0).sum() / known.sum().clamp_min(1)


@dataclass(frozen=True, kw_only=True)
class RegressionConfig:
    """What the networks that regress the disparity have in common, as data.

    Attributes:
        max_disparity: Disparities below this are trained on; the network can give any.
        width: Channels of the first convolution, to which all others are in proportion.
    """

    max_disparity: int = 192
    width: int = 64

    def __post_init__(self) -> None:
        check_multiple("width", self.width, 8)


def conv(
    inputs: int,
    outputs: int,
    kernel: int = 3,
    stride: int = 1,
    activation: nn.Module | None = None,
) -> nn.Sequential:
    """Convolution with bias and, by default, a leaky ReLU; keeps the size at stride 1."""
    layer = nn.Conv2d(inputs, outputs, kernel, stride, kernel // 2)
    return nn.Sequential(layer, activation or leaky())


def transposed(
    inputs: int, outputs: int, scale: int = 2, activation: nn.Module | None = None
) -> nn.Sequential:
    """Transposed convolution with bias that enlarges, and an activation as in `conv`."""
    layer = nn.ConvTranspose2d(inputs, outputs, 2 * scale, scale, scale // 2)
    return nn.Sequential(layer, activation or leaky())


def leaky() -> nn.Module:
    """The activation of this family."""
    return nn.LeakyReLU(SLOPE)


def predictor(inputs: int, outputs: int = 1) -> nn.Conv2d:
    """3x3 convolution to a prediction."""
    return nn.Conv2d(inputs, outputs, 3, padding=1)


class DecoderLevel(nn.Module):
    """A level on the way up: enlarge features and prediction, join the skip, fuse, predict.

    Args:
        inputs: Channels of the features below.
        skip: Channels of the encoder's features.
        outputs: Channels of the enlarged features.
        fused: Channels after the fusion, by default as many.
        activation: After the enlargement.
        fusion_activation: After the fusion; none in the DispNets.
    """

    def __init__(
        self,
        inputs: int,
        skip: int,
        outputs: int,
        fused: int | None = None,
        *,
        activation: nn.Module | None = None,
        fusion_activation: nn.Module | None = None,
    ) -> None:
        super().__init__()
        fused = outputs if fused is None else fused
        self.up = transposed(inputs, outputs, activation=activation)
        self.enlarge = nn.ConvTranspose2d(1, 1, 4, 2, 1)
        self.fuse = conv(skip + outputs + 1, fused, activation=fusion_activation or nn.Identity())
        self.predict = predictor(fused)

    def forward(self, below: Tensor, prediction: Tensor, skip: Tensor) -> tuple[Tensor, Tensor]:
        """Features, prediction (B, 1, h, w) and a skip of twice the size -> both of that size."""
        joined = torch.cat((skip, self.up(below), self.enlarge(prediction)), dim=1)
        fused = self.fuse(joined)
        return fused, self.predict(fused)


def positive(predictions: Sequence[Tensor]) -> list[Tensor]:
    """Disparities (B, h, w) of negative ones (B, 1, h, w)."""
    return [-prediction[:, 0] for prediction in predictions]


def enlarged(prediction: Tensor, scale: int) -> Tensor:
    """A prediction (B, C, h, w) enlarged bilinearly; its values stay."""
    return F.interpolate(prediction, scale_factor=float(scale), mode="bilinear")


def initialise(network: nn.Module) -> None:
    """Set fresh weights for a network without norms: He's normal, biases of zero."""
    for module in network.modules():
        if isinstance(module, nn.Conv2d | nn.ConvTranspose2d):
            nn.init.kaiming_normal_(module.weight, SLOPE)
            if module.bias is not None:
                nn.init.zeros_(module.bias)
