"""`ConfidenceFit`: from a network's own confidence to the probability that a disparity is right."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from mobilestereonet.errors import InputError

CORRECT_PX = 3.0
"""Error in px below which a disparity counts as correct, as in KITTI's outliers."""

MIN_PROBABILITY = 1e-4
"""Probabilities nearer to 0 or 1 are taken for this far from it, so that logarithms are finite."""


@dataclass(frozen=True)
class ConfidenceFit:
    """Calibration of a network's confidence, fitted to its weights.

    Beta calibration (Kull et al., AISTATS 2017): of the network's own confidence c, the
    probability is ``sigmoid(rise * log(c) - fall * log(1 - c) + offset)``. It never falls where c
    rises.

    Attributes:
        rise: Weight of log(c), 0 or more.
        fall: Weight of -log(1 - c), 0 or more.
        offset: The rest.

    Raises:
        InputError: If a value is no such number.
    """

    rise: float
    fall: float
    offset: float

    def __post_init__(self) -> None:
        values = (self.rise, self.fall, self.offset)
        numbers = all(isinstance(value, int | float) for value in values)
        if not (numbers and all(map(math.isfinite, values)) and min(self.rise, self.fall) >= 0):
            raise InputError(
                "a fit of the confidence is three numbers, of which rise and fall are 0 or more, "
                f"got {values}"
            )

    def __call__(self, confidence: Tensor) -> Tensor:
        """Probability that the error is below `CORRECT_PX`.

        Args:
            confidence: The network's own, in 0..1, of any shape.

        Returns:
            In 0..1, of the same shape and type.
        """
        sure = confidence.clamp(MIN_PROBABILITY, 1 - MIN_PROBABILITY)
        logit = self.rise * sure.log() - self.fall * torch.log1p(-sure) + self.offset
        return logit.sigmoid()
