"""Matchers under evaluation: their type, and a timed and checked call."""

from __future__ import annotations

import time
from collections.abc import Callable

import torch
from torch import Tensor

from mobilestereonet.data.sample import StereoSample
from mobilestereonet.errors import InputError

DisparityFn = Callable[[Tensor, Tensor], Tensor]
"""Left and right views, (B, 3, H, W) RGB in 0..1, to disparity in px, (B, H, W).

``StereoMatcher.disparity`` is such a function.
"""


def timed_match(match: DisparityFn, batch: StereoSample) -> tuple[Tensor, float]:
    """Match a batch, measure the time and check the result.

    Args:
        match: Matcher to call.
        batch: Pairs, (B, 3, H, W).

    Returns:
        Disparity on the CPU, (B, H, W) float32 in px, and the seconds until it was there.

    Raises:
        InputError: If the result has another shape or values that are not finite.
    """
    started = time.perf_counter()
    with torch.no_grad():
        prediction = match(batch.left, batch.right).float().cpu()
    elapsed = time.perf_counter() - started
    expected = (batch.left.shape[0], *batch.left.shape[-2:])
    if prediction.shape != expected:
        raise InputError(
            f"{batch.name}: the matcher gave shape {tuple(prediction.shape)}, not {expected}"
        )
    if wrong := int((~prediction.isfinite()).sum()):
        raise InputError(
            f"{batch.name}: the matcher gave {wrong} disparities that are not finite; "
            "are its weights damaged?"
        )
    return prediction, elapsed
