"""Matchers by name: the networks, and StereoSGBM like any of them."""

from __future__ import annotations

from pathlib import Path

from mobilestereonet.errors import InputError
from mobilestereonet.evaluation.evaluate import Match
from mobilestereonet.runtimes.sgbm import StereoSGBM


def load_matcher(model: str, weights: Path | None = None) -> Match:
    """Find a matcher.

    Args:
        model: Name of a network, or ``sgbm``.
        weights: Weights file of a network; by default those that come with the package.

    Returns:
        A function from two views, RGB in 0..1, to disparity.

    Raises:
        InputError: If there is no such model, or ``sgbm`` is given weights.
    """
    if model != StereoSGBM.name:
        from mobilestereonet.inference import StereoMatcher  # sgbm needs none of it

        return StereoMatcher.from_pretrained(model, weights=weights).disparity
    if weights is not None:
        raise InputError(f"sgbm has no weights, drop {weights}")
    return StereoSGBM()
