"""From matching scores to disparity and confidence: upsampling, softmax, expectation.

The expectation under the softmax is GC-Net's soft argmin (Kendall et al., ICCV 2017) on negated
costs, as in the authors' release of MobileStereoNet, whose paper does not describe its regression.

An expectation over all disparities lies between foreground and background wherever both are
possible: edges come out blurred. The estimator "mode" takes it over the most likely neighbourhood
alone (the dominant mode of Xu et al., "Adaptive Multi-Modal Cross-Entropy Loss for Stereo
Matching", CVPR 2024; here three intervals between coarse planes), where that holds enough of the
probability.
"""

from __future__ import annotations

from typing import Literal

import torch
import torch.nn.functional as F
from torch import Tensor, nn

Estimator = Literal["mean", "mode"]

MIN_MODE_PROBABILITY = 0.3
"""Probability of the most likely neighbourhood below which "mode" takes the mean over all."""

CONFIDENCE_RADIUS_PX = 2
"""Pixels around the estimate in which the confidence sums up the probability."""


class SoftArgmax(nn.Module):
    """Expected disparity under the softmax of upsampled scores.

    Args:
        scale: Full-resolution pixels per plane and per pixel of the scores, which are upsampled by
            this factor in disparity, height and width.
        estimator: "mean" takes the expectation over all disparities, as GC-Net does; "mode" over
            the most likely neighbourhood. Training takes the mean.
        align_corners: Upsample with the corners' centres aligned, as PyTorch did before version
            0.4; otherwise with half-pixel centres.
    """

    def __init__(
        self, scale: int = 4, estimator: Estimator = "mean", *, align_corners: bool = False
    ) -> None:
        super().__init__()
        self.align_corners = align_corners
        self.scale = scale
        self.estimator = estimator

    def forward(self, scores: Tensor) -> Tensor:
        """Scores (B, D, H, W), higher for better matches, to disparity (B, s H, s W) in pixels."""
        return self._estimate(self._upsample(scores, (self.scale,) * 3), self.estimator)

    def expectation(self, scores: Tensor) -> Tensor:
        """As `forward`, with the estimator "mean"."""
        return self._estimate(self._upsample(scores, (self.scale,) * 3), "mean")

    def confidence(self, scores: Tensor) -> Tensor:
        """Probability that the disparity is within 2 px of the estimate (not in the paper).

        Computed at the resolution of the scores and upsampled, with half-pixel centres.

        Args:
            scores: (B, D, H, W).

        Returns:
            (B, s H, s W) in 0..1.
        """
        scores = self._upsample(scores, (self.scale, 1, 1))
        disparity = self._estimate(scores, self.estimator).unsqueeze(1)
        distance = (_disparities(scores) - disparity).abs()
        within = (CONFIDENCE_RADIUS_PX + 0.5 - distance).clamp(0, 1)
        confidence = (scores.softmax(dim=1) * within).sum(dim=1, keepdim=True)
        return F.interpolate(confidence, scale_factor=self.scale, mode="bilinear").squeeze(1)

    def _upsample(self, scores: Tensor, factors: tuple[int, int, int]) -> Tensor:
        """(B, D, H, W) -> upsampled by factors of D, H and W; reduced precision becomes float32."""
        scores = scores.to(torch.promote_types(scores.dtype, torch.float32)).unsqueeze(1)
        size = [side * factor for side, factor in zip(scores.shape[2:], factors, strict=True)]
        fine = F.interpolate(scores, size=size, mode="trilinear", align_corners=self.align_corners)
        return fine.squeeze(1)

    def _estimate(self, scores: Tensor, estimator: Estimator) -> Tensor:
        """Expected disparity of scores (B, s D, H, W), one per pixel of disparity."""
        probability = scores.softmax(dim=1)
        if estimator == "mode":
            probability = probability * self._dominant_mode(probability)
            probability = probability / probability.sum(dim=1, keepdim=True)
        return (probability * _disparities(scores)).sum(dim=1)

    @torch.no_grad()
    def _dominant_mode(self, probability: Tensor) -> Tensor:
        """1 for the disparities that "mode" looks at, 0 for the others: (B, s D, H, W)."""
        scale, below = self.scale, self.scale // 2
        # Half an interval below the first plane, the intervals between planes, half an interval.
        padded = F.pad(probability, (0, 0, 0, 0, below, scale - below))
        intervals = padded.unflatten(1, (-1, scale)).sum(dim=2)
        mask = dominant_mode(intervals).repeat_interleave(scale, dim=1)
        return mask[:, below : below + probability.shape[1]]


def dominant_mode(intervals: Tensor) -> Tensor:
    """How often each interval counts: 1 in the most likely three neighbouring ones, 0 elsewhere.

    Of neighbourhoods that are exactly as likely it takes the mean, and the mean over everything
    where none holds `MIN_MODE_PROBABILITY`.

    Args:
        intervals: Probability, or anything proportional to it, of each interval: (B, N, H, W).

    Returns:
        (B, N, H, W) in the type of ``intervals``.
    """
    three = intervals[:, :-2] + intervals[:, 1:-1] + intervals[:, 2:]
    most = three.amax(dim=1, keepdim=True)
    centre = F.pad((three >= most).to(intervals.dtype), (0, 0, 0, 0, 2, 2))
    counts = centre[:, :-2] + centre[:, 1:-1] + centre[:, 2:]
    spread = most < MIN_MODE_PROBABILITY * intervals.sum(dim=1, keepdim=True)
    return torch.where(spread, 1, counts)


def _disparities(scores: Tensor) -> Tensor:
    """Disparities 0 .. D - 1 of scores (B, D, H, W): (D, 1, 1)."""
    return torch.arange(scores.shape[1], dtype=scores.dtype, device=scores.device)[:, None, None]
