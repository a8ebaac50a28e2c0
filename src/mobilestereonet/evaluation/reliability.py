"""Is a confidence the probability that it says? Its fit to errors, and the reliability diagram."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mobilestereonet.data.sample import StereoSample
from mobilestereonet.errors import InputError
from mobilestereonet.inference import StereoMatcher
from mobilestereonet.nets.confidence import CORRECT_PX, MIN_PROBABILITY, ConfidenceFit
from mobilestereonet.nets.model import trained_pixels

BINS = 10
"""Bins of the reliability diagram, of equal width."""

_MAX_STEPS = 50
_RIDGE = 1e-6
"""Part of the curvature's trace that keeps Newton's method going where a weight does not count."""


@dataclass(frozen=True)
class Reliability:
    """What a confidence says against what came true, in `BINS` bins of the confidence.

    Attributes:
        pixels: Number of pixels per bin, (`BINS`,).
        said: Mean confidence per bin; NaN in an empty one.
        true: Share of pixels whose error is below `CORRECT_PX`; NaN in an empty one.
    """

    pixels: NDArray[np.int64]
    said: NDArray[np.float64]
    true: NDArray[np.float64]

    @property
    def error(self) -> float:
        """Expected calibration error: mean difference of both over the pixels, 0..1."""
        full = self.pixels > 0
        gaps = np.abs(self.said - self.true)[full]
        return float(np.average(gaps, weights=self.pixels[full]))

    def table(self) -> list[dict[str, Any]]:
        """Rows of the bins that are not empty, as a model card has them."""
        return [
            {
                "from": round(int(index) / BINS, 1),
                "pixels": int(self.pixels[index]),
                "said": round(float(self.said[index]), 4),
                "true": round(float(self.true[index]), 4),
            }
            for index in np.flatnonzero(self.pixels)
        ]


def reliability(confidence: NDArray[Any], correct: NDArray[np.bool_]) -> Reliability:
    """Count what a confidence says and what came true.

    Args:
        confidence: Confidence of pixels with ground truth, in 0..1, of any shape.
        correct: Whether their error is below `CORRECT_PX`, in the same shape.

    Raises:
        InputError: If the shapes differ or there is no pixel.
    """
    _check(confidence, correct)
    values = confidence.ravel().astype(np.float64)
    bins = np.minimum((values * BINS).astype(int), BINS - 1)
    pixels = np.bincount(bins, minlength=BINS)
    with np.errstate(invalid="ignore"):
        said, true = (
            np.bincount(bins, weights, minlength=BINS) / pixels
            for weights in (values, correct.ravel().astype(np.float64))
        )
    return Reliability(pixels, said, true)


def confidences(
    matcher: StereoMatcher, samples: Iterable[StereoSample]
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Confidence of a matcher, and whether its disparity is correct, over pairs.

    Args:
        matcher: A matcher whose engine has a confidence.
        samples: Pairs with ground truth.

    Returns:
        Both of all pixels with ground truth that the matcher could find, (N,): the confidence in
        0..1, and whether the error is below `CORRECT_PX`.

    Raises:
        InputError: If the matcher has no confidence, or the pairs no ground truth.
    """
    found: list[tuple[NDArray[np.float32], NDArray[np.bool_]]] = []
    for sample in samples:
        if sample.disparity is None or sample.valid is None:
            continue
        prediction = matcher.infer(sample.left[None], sample.right[None])
        if prediction.confidence is None:
            raise InputError(f"{matcher.model} has no confidence: nothing can be fitted to it")
        known = trained_pixels(sample.disparity, sample.valid, matcher.max_disparity)
        error = (prediction.disparity[0] - sample.disparity)[known].abs()
        found.append((prediction.confidence[0][known].numpy(), (error < CORRECT_PX).numpy()))
    if not sum(confidence.size for confidence, _ in found):
        raise InputError("no pixel has ground truth: nothing tells which disparities are correct")
    sure, correct = (np.concatenate(parts) for parts in zip(*found, strict=True))
    return sure, correct


def fit_confidence(confidence: NDArray[Any], correct: NDArray[np.bool_]) -> ConfidenceFit:
    """Fit the calibration of a confidence: the most likely one, by Newton's method.

    Args:
        confidence: A network's own confidence of pixels with ground truth, in 0..1, of any shape.
        correct: Whether their error is below `CORRECT_PX`, in the same shape.

    Raises:
        InputError: If the shapes differ, or the pixels are all correct or all wrong.
    """
    _check(confidence, correct)
    if correct.all() or not correct.any():
        raise InputError(
            f"a fit needs pixels of errors below and above {CORRECT_PX:g} px, and all are "
            f"{'below' if correct.all() else 'above'}: take more pairs"
        )
    sure = confidence.ravel().astype(np.float64).clip(MIN_PROBABILITY, 1 - MIN_PROBABILITY)
    inputs = np.stack((np.log(sure), -np.log1p(-sure), np.ones_like(sure)))
    target = correct.ravel().astype(np.float64)
    # A weight below 0 would make the map fall: as in the paper, it is then left out.
    kept = [0, 1, 2]
    while (weights := _logistic(inputs[kept], target))[:-1].min(initial=0) < 0:
        kept.pop(int(weights[:-1].argmin()))
    values = dict(zip(kept, map(float, weights), strict=True))
    return ConfidenceFit(*(values.get(index, 0.0) for index in range(3)))


def _logistic(inputs: NDArray[np.float64], target: NDArray[np.float64]) -> NDArray[np.float64]:
    """Weights (K,) of a logistic regression of targets (N,) in 0..1 on inputs (K, N)."""
    weights = np.zeros(len(inputs))
    for _ in range(_MAX_STEPS):
        probability = 1 / (1 + np.exp(-(weights @ inputs)))
        slope = inputs @ (target - probability)
        curvature = (inputs * (probability * (1 - probability))) @ inputs.T
        curvature += _RIDGE * np.trace(curvature) * np.eye(len(inputs))
        step = np.linalg.solve(curvature, slope)
        weights += step
        if np.abs(step).max() < 1e-6:
            break
    return weights


def _check(confidence: NDArray[Any], correct: NDArray[np.bool_]) -> None:
    if confidence.shape != correct.shape or not confidence.size:
        raise InputError(
            f"confidences and errors need one shape with a pixel in it, got {confidence.shape} and "
            f"{correct.shape}"
        )
