"""Choice of a quality level by a rate that has to be kept."""

from __future__ import annotations

from collections.abc import Callable

from mobilestereonet.inference.matcher import StereoMatcher
from mobilestereonet.inference.pair import StereoPair
from mobilestereonet.inference.quality import QUALITIES
from mobilestereonet.timing import time_interleaved

MARGIN = 0.9
"""Share of a frame's time that matching may take when it is measured: it varies."""

SMALLER_SCALES = (0.5, 0.35)
"""Scales at which the fastest level is tried where no level is fast enough as it is."""


def choose_quality(
    pair: StereoPair, hz: float, open_level: Callable[[str, float | None], StereoMatcher]
) -> tuple[StereoMatcher, float]:
    """The best quality level that keeps up with a rate on this machine.

    Each is measured on a pair, from the best one on, until one is fast enough.

    Args:
        pair: A pair of the size that is to be matched.
        hz: Pairs per second.
        open_level: Makes a matcher of a level's name and a scale; None is the level's own.

    Returns:
        The matcher, and its time for a pair in s. If nothing is fast enough: the fastest.
    """
    different = {level: name for name, level in reversed(QUALITIES.items())}
    levels: list[tuple[str, float | None]] = [(name, None) for name in different.values()]
    levels += [(next(iter(QUALITIES)), scale) for scale in SMALLER_SCALES]
    for name, scale in levels:
        matcher = open_level(name, scale)
        matcher.match(pair)  # the first run also prepares the engine
        seconds = time_interleaved(lambda m=matcher: m.match(pair), repeats=3)[0]  # type: ignore[misc]
        if seconds <= MARGIN / hz:
            break
    return matcher, seconds
