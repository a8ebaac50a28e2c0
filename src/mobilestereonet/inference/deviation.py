"""Standard deviations of disparity and depth, from the confidence."""

from __future__ import annotations

import math

import numpy as np

from mobilestereonet.data.images import FloatMap
from mobilestereonet.errors import InputError
from mobilestereonet.nets.confidence import CORRECT_PX, MIN_PROBABILITY

MIN_DEVIATION_PX = 0.5
"""Least standard deviation of a disparity, in px: a confidence near 1 tells no finer one."""


def check_fitted(fitted: bool, model: str) -> None:
    """Check that a model's confidence is fitted, as a standard deviation needs it.

    Raises:
        InputError: If it is not.
    """
    if not fitted:
        raise InputError(
            f"the confidence of {model} is no probability of an error, which a standard deviation "
            "needs: `msnet fit-confidence` makes it one"
        )


def disparity_deviation(confidence: FloatMap) -> FloatMap:
    """Standard deviation of the error that is below `CORRECT_PX` with these probabilities.

    The errors of disparities have long tails; a Laplace distribution of scale b stands for them.
    It has P(|error| < t) = 1 - exp(-t / b), and the standard deviation sqrt(2) b.

    Args:
        confidence: Probability that the error is below `CORRECT_PX`, in 0..1.

    Returns:
        In px, `MIN_DEVIATION_PX` or more, in the shape of ``confidence``.
    """
    wrong = np.log1p(-np.clip(confidence, MIN_PROBABILITY, 1 - MIN_PROBABILITY))
    return np.maximum(-math.sqrt(2) * CORRECT_PX / wrong, MIN_DEVIATION_PX).astype(np.float32)


def depth_deviation(
    depth: FloatMap, disparity: FloatMap, deviation: FloatMap, doffs: float
) -> FloatMap:
    """Standard deviation of a depth, to first order: depth * deviation / (disparity + doffs).

    Args:
        depth: Depth in metres, (H, W), 0 where it is not known.
        disparity: Disparity in px, (H, W).
        deviation: Its standard deviation in px, (H, W).
        doffs: Difference of the principal points, right minus left, in px.

    Returns:
        In metres, (H, W), 0 where the depth is not known.
    """
    known = depth > 0
    shifted = np.where(known, disparity + np.float32(doffs), np.float32(1))
    return np.where(known, depth * deviation / shifted, np.float32(0))
