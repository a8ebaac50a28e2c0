"""An engine on views of a smaller size: less time for a coarser disparity."""

from __future__ import annotations

import math
from collections.abc import Callable

import torch
import torch.nn.functional as F
from torch import Tensor

from mobilestereonet.data.images import pad, unpad
from mobilestereonet.engines.base import Engine, confidence_fit
from mobilestereonet.errors import InputError
from mobilestereonet.nets.model import Prediction, Preprocessing

MIN_SCALE = 0.25
"""Smallest factor of a `ScaledEngine`."""


def check_scale(scale: float) -> None:
    """Check the factor of a `ScaledEngine`.

    Raises:
        InputError: If it is not in 0.25..1.
    """
    if not MIN_SCALE <= scale <= 1:
        raise InputError(f"scale must be in 0.25..1, got {scale}")


class ScaledEngine:
    """Another engine, run on resized views; its results are in the size and pixels of the views.

    So is the probability of the fitted confidence, under the assumption that errors have a Laplace
    distribution, which `inference.deviation` makes, too.

    Args:
        engine: The engine.
        scale: Factor of height and width, in 0.25..1. Disparities that it searches reach as much
            farther.

    Raises:
        InputError: If the scale is out of that range.
    """

    size_multiple = 1

    def __init__(self, engine: Engine, scale: float) -> None:
        check_scale(scale)
        self.engine = engine
        self.scale = scale

    @property
    def name(self) -> str:
        """Name of the engine."""
        return self.engine.name

    @property
    def precision(self) -> str:
        """Number format of the engine."""
        return self.engine.precision

    @property
    def device(self) -> torch.device:
        """Device of the engine."""
        return self.engine.device

    @property
    def threads(self) -> int | None:
        """Threads of the engine."""
        return self.engine.threads

    @property
    def preprocessing(self) -> Preprocessing:
        """Preprocessing of the engine."""
        return self.engine.preprocessing

    @property
    def has_confidence(self) -> bool:
        """Whether the engine has a confidence."""
        return self.engine.has_confidence

    @property
    def confidence_fit(self) -> Callable[[Tensor], Tensor] | None:
        """Calibration of the engine's confidence, with errors in pixels of the views."""
        fit = confidence_fit(self.engine)
        return fit and (lambda own: 1 - (1 - fit(own)) ** self.scale)

    @property
    def min_side(self) -> int:
        """Smallest height and width that are still what the engine takes once resized."""
        return math.ceil(self.engine.min_side / self.scale)

    @property
    def max_disparity(self) -> int:
        """Disparities below this are searched, in pixels of the views."""
        return int(self.engine.max_disparity / self.scale)

    def __call__(self, left: Tensor, right: Tensor, confidence: bool = False) -> Prediction:
        """Match a batch of pairs, see `Engine`."""
        height, width = left.shape[-2:]
        size = [max(1, round(side * self.scale)) for side in (height, width)]
        multiple = self.engine.size_multiple
        padded = [math.ceil(side / multiple) * multiple for side in size]
        views = (
            pad(F.interpolate(view, size, mode="bilinear", antialias=True), *padded)
            for view in (left, right)
        )
        disparity, sure = self.engine(next(views), next(views), confidence)

        def enlarge(map_: Tensor) -> Tensor:
            map_ = unpad(map_, *size).unsqueeze(1)
            return F.interpolate(map_, (height, width), mode="bilinear").squeeze(1)

        return Prediction(
            enlarge(disparity) * (width / size[1]), None if sure is None else enlarge(sure)
        )
