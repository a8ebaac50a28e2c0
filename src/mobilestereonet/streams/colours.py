"""Colours of a stream's disparities, which do not flicker."""

from __future__ import annotations

import math

import numpy as np

from mobilestereonet.data.images import Mask, Picture
from mobilestereonet.inference import StereoResult
from mobilestereonet.plots import colour_disparity


class SmoothedRange:
    """Colour range that follows the scene slowly, so that a video does not flicker.

    Its end is the 99th percentile of the disparity, averaged over about the last second.
    """

    def __init__(self, memory: float = 1.0) -> None:
        """Start without a range.

        Args:
            memory: Seconds after which a frame's weight has sunk to 1/e.
        """
        self.memory = memory
        self.maximum: float | None = None
        self.seconds = 0.0

    def update(self, seconds: float, result: StereoResult) -> float:
        """Update the range by a frame.

        Args:
            seconds: Time at which it is shown, in s; never decreases.
            result: Its disparity.

        Returns:
            The disparity of the last colour, in px.
        """
        known = result.disparity[result.valid]
        if known.size:
            high = float(np.percentile(known, 99))
            share = 1 - math.exp((self.seconds - seconds) / self.memory)
            before = high if self.maximum is None else self.maximum
            self.maximum = before + share * (high - before)
            self.seconds = seconds
        return 1.0 if self.maximum is None else self.maximum

    def colour(self, seconds: float, result: StereoResult, shown: Mask | None = None) -> Picture:
        """The colours of a frame's disparity, (H, W, 3) uint8 RGB.

        Args:
            seconds: Time at which it is shown, in s; never decreases.
            result: Its disparity.
            shown: (H, W) bool, False where it is black; by default where it is not known.
        """
        maximum = self.update(seconds, result)
        return colour_disparity(result.disparity, maximum, result.valid if shown is None else shown)
