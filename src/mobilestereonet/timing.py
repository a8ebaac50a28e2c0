"""Timing of functions on a machine that does other things, too, and what is told of long work."""

from __future__ import annotations

import logging
import statistics
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager


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


@contextmanager
def long_work(log: logging.Logger, text: str) -> Iterator[None]:
    """Context of work that may take long: a logger tells that it begins, and what it took.

    Both records, at the level INFO, have an attribute ``work``, "begins" or "ends": the command
    line shows the time in between.

    Args:
        log: The logger.
        text: What is done.
    """
    log.info("%s", text, extra={"work": "begins"})
    started = time.perf_counter()
    try:
        yield
    finally:
        log.info("%s: %.0f s", text, time.perf_counter() - started, extra={"work": "ends"})
