"""Sparsification curve of a confidence map and its area (AUSE)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mobilestereonet.atomic import write_atomically
from mobilestereonet.errors import InputError, needs_extra

_CURVE_POINTS = 100


@dataclass(frozen=True)
class Sparsification:
    """Sparsification curve: mean error when the least confident pixels are removed.

    Attributes:
        removed: Share of the pixels that is removed, (N,), 0 to 0.99.
        error: Mean error of the rest in px, (N,).
        oracle: The same if the pixels with the largest errors are removed: no confidence can do
            better.
    """

    removed: NDArray[np.float64]
    error: NDArray[np.float64]
    oracle: NDArray[np.float64]

    @property
    def area(self) -> float:
        """Area between curve and oracle over the error of all pixels (AUSE): 0 is perfect.

        A confidence without information has about 1 less the oracle's own area.
        """
        return float(np.mean(self.error - self.oracle) / self.error[0]) if self.error[0] else 0.0


def sparsification(error: NDArray[np.float32], confidence: NDArray[np.float32]) -> Sparsification:
    """Compute the sparsification curve of a confidence map.

    Args:
        error: Absolute disparity errors of the pixels with ground truth, any shape, in px.
        confidence: Confidence of the same pixels, in the same shape.

    Returns:
        The curve at each percent.

    Raises:
        InputError: If the shapes differ or there is no pixel.
    """
    if error.shape != confidence.shape or not error.size:
        raise InputError(
            f"errors and confidences need one shape with a pixel in it, got {error.shape} and "
            f"{confidence.shape}"
        )
    removed = np.arange(_CURVE_POINTS) / _CURVE_POINTS
    error, confidence = error.ravel().astype(np.float64), confidence.ravel()
    kept = np.ceil((1 - removed) * error.size).astype(int)
    curves = []
    for order in (np.argsort(-confidence, kind="stable"), np.argsort(error, kind="stable")):
        means = np.cumsum(error[order]) / np.arange(1, error.size + 1)
        curves.append(means[kept - 1])
    return Sparsification(removed, *curves)


def plot_sparsification(curves: Sequence[tuple[str, Sparsification]], picture: Path) -> None:
    """Draw sparsification curves, each over its error without removal; oracles dotted.

    Args:
        curves: Names and curves.
        picture: PNG file to write.
    """
    with needs_extra("plots"):
        from matplotlib.figure import Figure

    figure = Figure(figsize=(7, 4.5), layout="constrained")
    axes = figure.subplots()
    for name, curve in curves:
        whole = curve.error[0] or 1.0
        label = f"{name}: {curve.error[0]:.2f} px, area {curve.area:.3f}"
        (line,) = axes.plot(100 * curve.removed, curve.error / whole, label=label)
        axes.plot(100 * curve.removed, curve.oracle / whole, ":", color=line.get_color(), alpha=0.6)
    axes.set_xlabel("least confident pixels removed, %")
    axes.set_ylabel("mean error of the rest over that of all")
    axes.set_ylim(0, None)
    axes.grid(alpha=0.3)
    axes.legend(fontsize="small")
    write_atomically(picture, lambda path: figure.savefig(path, format="png", dpi=120))
