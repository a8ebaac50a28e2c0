"""Common base of the engines that run a `StereoModel`."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from typing import ClassVar

import torch
from torch import Tensor

from mobilestereonet.engines.threads import use_threads
from mobilestereonet.errors import InputError
from mobilestereonet.nets.model import Prediction, StereoModel
from mobilestereonet.nets.volume_model import VolumeModel


class NetworkEngine(ABC):
    """Engine that runs a `StereoModel`.

    Of a `VolumeModel` the engine computes the scores, and PyTorch regresses disparity and
    confidence from them in float32. Of others it computes the disparity.

    Args:
        net: The network.
        precision: Number format of the computation.
        threads: Threads on a CPU; None leaves them to the engine.
        device: PyTorch's device on which results lie.

    Raises:
        InputError: If ``threads`` is below 1.

    Attributes:
        has_confidence: Whether the network has scores, from which the confidence is computed.
        confidence_fit: Calibration of the confidence, which is for the matcher to apply.
    """

    name: ClassVar[str]

    def __init__(
        self, net: StereoModel, precision: str, threads: int | None, device: torch.device
    ) -> None:
        if threads is not None and threads < 1:
            raise InputError(f"threads must be at least 1, got {threads}")
        self.precision = precision
        self.threads = threads
        self.device = device
        self.preprocessing = net.preprocessing
        self.size_multiple = net.size_multiple
        self.min_side = net.min_side
        self.max_disparity = net.max_disparity
        self.has_confidence = isinstance(net, VolumeModel)
        self.confidence_fit = net.confidence_fit

    def __call__(self, left: Tensor, right: Tensor, confidence: bool = False) -> Prediction:
        """Match a batch of pairs, see `Engine`."""
        with torch.inference_mode(), use_threads(self._torch_threads):
            parts = list(self._predict(left, right, confidence))
            disparity = torch.cat([part.disparity for part in parts]).float()
            confidences = [part.confidence for part in parts if part.confidence is not None]
            if not confidence or not confidences:
                return Prediction(disparity)
            return Prediction(disparity, torch.cat(confidences).float())

    def scores(self, left: Tensor, right: Tensor) -> Tensor:
        """Matching scores of a network that has them, see `VolumeModel.scores`.

        Args:
            left: Left views, (B, 3, H, W) float, preprocessed.
            right: Right views, likewise.

        Returns:
            (B, D, H / s, W / s) in the engine's precision, on ``device``.

        Raises:
            InputError: If the network has none, or the shapes do not fit.
        """
        if not self.has_confidence:
            raise InputError("this network regresses the disparity directly: it has no scores")
        with torch.inference_mode(), use_threads(self._torch_threads):
            return torch.cat(list(self._scores(left, right)))

    @property
    def _torch_threads(self) -> int | None:
        return self.threads if self.device.type == "cpu" else None

    @abstractmethod
    def _predict(self, left: Tensor, right: Tensor, confidence: bool) -> Iterator[Prediction]:
        """Predictions of the pairs in their order, some at a time, on the engine's device."""

    @abstractmethod
    def _scores(self, left: Tensor, right: Tensor) -> Iterator[Tensor]:
        """Scores of the pairs in their order, some at a time, on the engine's device."""


def regress(net: VolumeModel, scores: Tensor, confidence: bool) -> Prediction:
    """Disparity, and confidence if it is asked for, from scores (B, D, H / s, W / s)."""
    return Prediction(
        net.regression(scores), net.regression.confidence(scores) if confidence else None
    )
