"""`VolumeModel`, a stereo network with a cost volume, and what it computes."""

from __future__ import annotations

from functools import cached_property
from typing import Any, NamedTuple

import torch
from torch import Tensor

from mobilestereonet.nets.coarse_pass import places_in_band
from mobilestereonet.nets.model import Prediction, StereoModel, smooth_l1_of_heads
from mobilestereonet.nets.soft_argmax import SoftArgmax

COARSE_WEIGHT = 0.5
"""Weight of a coarse pass's loss beside that of the fine pass (Gu et al., CVPR 2020: 0.5 to 1)."""


class Band(NamedTuple):
    """Which planes of a cost volume were searched at each pixel.

    Attributes:
        start: First plane, (B, H / s, W / s) int64.
        planes: Number of planes.
    """

    start: Tensor
    planes: int


class VolumeOutputs:
    """What a `VolumeModel` computes: scores per head, and disparities where they are asked for.

    Args:
        scores: Matching scores (B, D, H / s, W / s) per head, first to last; in eval mode those of
            the last head alone. s is ``regression.scale``.
        volume: The cost volume (B, C, N, H / s, W / s) of the planes that were compared, all D or
            fewer; None from networks that do not give it.
        regression: From scores to disparity.
        band: The planes that were searched; None: all.
        coarse: What a coarse pass computed that the same loss trains; None: there is none.
    """

    def __init__(
        self,
        scores: list[Tensor],
        volume: Tensor | None,
        regression: SoftArgmax,
        band: Band | None = None,
        coarse: VolumeOutputs | None = None,
    ) -> None:
        self.scores = scores
        self.volume = volume
        self.regression = regression
        self.band = band
        self.coarse = coarse

    def last(self, count: int) -> VolumeOutputs:
        """The outputs of the last ``count`` heads."""
        if count >= len(self.scores):
            return self
        coarse = None if self.coarse is None else self.coarse.last(count)
        return VolumeOutputs(self.scores[-count:], self.volume, self.regression, self.band, coarse)

    def searched(self, disparity: Tensor) -> Tensor:
        """Pixels whose ground truth lies within the planes that were searched.

        From the others nothing can be learnt: whatever the scores say, the answer is wrong.

        Args:
            disparity: Ground truth (B, H, W), in pixels.

        Returns:
            (B, H, W) bool.
        """
        if self.band is None:
            return torch.ones_like(disparity, dtype=torch.bool)
        scale = self.regression.scale
        start = self.band.start.repeat_interleave(scale, 1).repeat_interleave(scale, 2)
        # Plane k lies at the disparity s k + (s - 1) / 2.
        plane = (disparity - (scale - 1) / 2) / scale
        return (plane >= start) & (plane <= start + self.band.planes - 1)

    @property
    def searched_planes(self) -> Tensor | None:
        """Planes that were searched, (B, D, H / s, W / s) bool; None: all."""
        if self.band is None:
            return None
        place = places_in_band(self.band.start, self.scores[-1].shape[1])
        return (place >= 0) & (place < self.band.planes)

    @property
    def passes(self) -> list[tuple[float, VolumeOutputs]]:
        """Outputs that the loss trains, with their weights.

        The fine pass, and the coarse pass if it learns.
        """
        own = (1.0, self)
        return [own] if self.coarse is None else [own, (COARSE_WEIGHT, self.coarse)]

    @cached_property
    def disparities(self) -> list[Tensor]:
        """Expected disparity (B, H, W) per head."""
        return [self.regression.expectation(scores) for scores in self.scores]

    @property
    def disparity(self) -> Tensor:
        """Expected disparity of the last head, (B, H, W), in pixels."""
        return self.disparities[-1]


class VolumeModel(StereoModel):
    """A network that scores each pixel's disparities, and regresses from the scores.

    Attributes:
        head_weights: Weights of the heads in the loss, first to last.
        regression: From scores to disparity and confidence.
    """

    head_weights: tuple[float, ...] = (1.0,)
    regression: SoftArgmax

    def outputs(self, left: Tensor, right: Tensor) -> VolumeOutputs:
        """Scores of all heads in training mode, of the last one in eval mode.

        Args:
            left: Left views (B, 3, H, W), preprocessed.
            right: Right views, likewise.

        Raises:
            InputError: If the shapes do not fit, see `check_views`.
        """
        raise NotImplementedError

    def scores(self, left: Tensor, right: Tensor) -> Tensor:
        """The last head's matching scores (B, D, H / s, W / s), s being ``regression.scale``."""
        return self.outputs(left, right).scores[-1]

    def forward(self, left: Tensor, right: Tensor) -> Any:
        """A `Prediction` in eval mode, `VolumeOutputs` in training mode; see `StereoModel`."""
        if self.training:
            return self.outputs(left, right)
        scores = self.scores(left, right)
        return Prediction(self.regression(scores), self.regression.confidence(scores))

    def weights_of(self, heads: list[Tensor]) -> list[float]:
        """Weights of the last heads; those before the listed ones weigh as the first of them."""
        missing = max(0, len(heads) - len(self.head_weights))
        weights = [self.head_weights[0]] * missing + list(self.head_weights)
        return weights[-len(heads) :]

    def training_loss(self, outputs: VolumeOutputs, disparity: Tensor, valid: Tensor) -> Tensor:
        """Smooth L1 of the heads' expected disparities, weighted; see `StereoModel`.

        Of each pass's pixels whose disparity was searched (`VolumeOutputs.searched`).
        """
        losses = [
            weight
            * smooth_l1_of_heads(
                part.disparities,
                self.weights_of(part.scores),
                disparity,
                valid & part.searched(disparity),
            )
            for weight, part in outputs.passes
        ]
        return torch.stack(losses).sum()
