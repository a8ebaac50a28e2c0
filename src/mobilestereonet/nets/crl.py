"""CRL (Pang et al., "Cascade Residual Learning", ICCV workshops 2017).

Two stages: "DispFulNet", which is DispNet-Corr1D up to the full resolution, and "DispResNet", which
corrects its disparity scale by scale.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

from mobilestereonet.nets.dispnet import BGRModel, Corr1DStage, down
from mobilestereonet.nets.registry import register_model
from mobilestereonet.nets.regression import (
    DecoderLevel,
    RegressionConfig,
    RegressionOutputs,
    conv,
    initialise,
    positive,
    predictor,
    transposed,
)
from mobilestereonet.nets.resampling import along_rows, downsample, remap


class CRLConfig(RegressionConfig):
    """CRL as data."""


class ResidualStage(nn.Module):
    """The second stage, DispResNet (Sec. 3.2): corrections at 1/16 to all of the resolution."""

    def __init__(self, width: int) -> None:
        super().__init__()
        w = width
        self.conv2 = conv(13, w, 5)
        self.conv3 = nn.Sequential(conv(w, 2 * w, 5, 2), conv(2 * w, 2 * w))
        self.conv4 = down(2 * w, 4 * w)
        self.conv5 = down(4 * w, 8 * w)
        self.conv6 = down(8 * w, 16 * w)
        self.predict6 = predictor(16 * w)
        self.levels = nn.ModuleList(
            DecoderLevel(2 * skip, skip, skip) for skip in (8 * w, 4 * w, 2 * w)
        )
        self.up = transposed(2 * w, w)
        self.enlarge = nn.ConvTranspose2d(1, 1, 4, 2, 1)
        self.predict = nn.Conv2d(2 * w + 1, 1, 5, padding=2)

    def forward(self, left: Tensor, right: Tensor, first: Tensor) -> list[Tensor]:
        """Correct a disparity.

        Args:
            left: Left views (B, 3, H, W).
            right: Right views, likewise.
            first: The first stage's negative disparity, (B, 1, H, W).

        Returns:
            Negative disparities (B, 1, h, w) at 1/16, 1/8, 1/4, 1/2 and all of the resolution, not
            clamped.
        """
        warped = remap(right, along_rows(first))
        conv2 = self.conv2(torch.cat((first, left, right, warped, left - warped), dim=1))
        conv3 = self.conv3(conv2)
        conv4 = self.conv4(conv3)
        conv5 = self.conv5(conv4)
        features = self.conv6(conv5)
        residual = self.predict6(features)
        corrected = [residual + downsample(first, *residual.shape[-2:])]
        for level, skip in zip(self.levels, (conv5, conv4, conv3), strict=True):
            features, residual = level(features, corrected[-1].clamp_max(0), skip)
            corrected.append(residual + downsample(first, *residual.shape[-2:]))
        told = self.enlarge(corrected[-1].clamp_max(0))
        residual = self.predict(torch.cat((conv2, self.up(features), told), dim=1))
        return [*corrected, residual + first]


@register_model(
    "crl",
    paper="Pang et al., Cascade Residual Learning: A Two-stage Convolutional Neural Network for "
    "Stereo Matching, ICCV workshops 2017",
    licence="Apache-2.0",
    checkpoints="Artifineuro/crl on GitHub: crl.caffemodel",
    trained_on="SceneFlow; that and KITTI 2015",
    published={"KITTI 2015 test D1-all, %": 2.67},
)
class CRL(BGRModel):
    """A disparity at the full resolution and, from views warped by it, its correction."""

    config: CRLConfig
    # Training code is not public: DispNet-C's, doubled with the resolution, for either stage.
    head_weights = (1 / 16, 1 / 16, 1 / 16, 1 / 8, 1 / 4, 1 / 2, 1, 1 / 16, 1 / 8, 1 / 4, 1 / 2, 1)

    def __init__(self, config: CRLConfig) -> None:
        super().__init__(config)
        w = config.width
        self.stage1 = Corr1DStage(w)
        self.full = DecoderLevel(w // 2, 3, w // 4, w // 2)
        self.stage2 = ResidualStage(w)
        initialise(self)

    def outputs(self, left: Tensor, right: Tensor) -> RegressionOutputs:
        """Predictions of stage 1 at 1/64 to 1, of stage 2 at 1/16 to 1, see `RegressionModel`.

        No gradient of the second stage reaches the first, which the authors keep fixed meanwhile.
        """
        left, right = self.centred(left, right)
        stage = self.stage1(left, right)
        _, first = self.full(stage.features, stage.predictions[-1], left)
        corrected = self.stage2(left, right, first.detach().clamp_max(0))
        predictions = positive([*stage.predictions, first, *corrected])
        return RegressionOutputs(predictions, predictions[-1].clamp_min(0))
