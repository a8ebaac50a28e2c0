"""Pairing of what two cameras took, by the times at which they took it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import pairwise
from statistics import median
from typing import TypeVar

T = TypeVar("T")


def tolerance_of(*times: Sequence[float]) -> float:
    """Difference up to which two moments are one: half of the shorter usual interval, in s.

    Args:
        times: Moments of each camera in s, in order.
    """
    intervals = [
        median(later - earlier for earlier, later in pairwise(own)) for own in times if len(own) > 1
    ]
    return min(intervals, default=float("inf")) / 2


def pair_by_time(
    left: Iterable[T],
    right: Iterable[T],
    seconds: Callable[[T], float],
    tolerance: float,
    dropped: list[T],
) -> Iterator[tuple[T, T]]:
    """Pair items whose moments differ by the tolerance at most.

    Args:
        left: Items of one camera, in the order of their moments.
        right: Items of the other one, likewise.
        seconds: An item's moment, in s.
        tolerance: Largest difference, in s.
        dropped: Gets the items that have no partner.

    Yields:
        A left and a right item.
    """
    others = iter(right)
    other = next(others, None)
    for item in left:
        while other is not None and seconds(other) < seconds(item) - tolerance:
            dropped.append(other)
            other = next(others, None)
        if other is not None and seconds(other) <= seconds(item) + tolerance:
            yield item, other
            other = next(others, None)
        else:
            dropped.append(item)
    while other is not None:
        dropped.append(other)
        other = next(others, None)
