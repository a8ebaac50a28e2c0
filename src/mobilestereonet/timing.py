"""Timing of functions on a machine that does other things, too."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable


def time_interleaved(*functions: Callable[[], object], repeats: int) -> list[float]:
    """Median seconds of each function.

    The functions run in turns, so that whatever else the machine does meets all of them alike.

    Args:
        *functions: What to time; each returns when its work is done.
        repeats: Timed runs of each.

    Returns:
        One median per function, in their order.
    """
    seconds: list[list[float]] = [[] for _ in functions]
    for _ in range(repeats):
        for times, function in zip(seconds, functions, strict=True):
            started = time.perf_counter()
            function()
            times.append(time.perf_counter() - started)
    return [statistics.median(times) for times in seconds]
