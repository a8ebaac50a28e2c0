"""Pairing of what two cameras took, by the times at which they took it."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from heapq import merge
from itertools import pairwise, repeat
from statistics import median
from typing import TypeVar

T = TypeVar("T")

_MAX_WAITING = 100
"""Items of one camera that wait for the other one's."""


def tolerance_of(*times: Sequence[float]) -> float:
    """Largest time difference of a stereo pair: half of the shorter frame interval, in s.

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
    moment: Callable[[T], float],
    tolerance: float,
    dropped: list[T],
) -> Iterator[tuple[T, T]]:
    """Pair items of two cameras, each with the nearest one of the other.

    Args:
        left: Items of one camera, in the order of their moments.
        right: Items of the other one, likewise.
        moment: When an item was taken, in any unit.
        tolerance: Largest difference of the moments of a pair, in the same unit.
        dropped: Gets the items that have no partner.

    Yields:
        A left and a right item.
    """
    sides = zip(repeat(0), left), zip(repeat(1), right)
    for one, other in pair_nearest(merge(*sides, key=lambda of: moment(of[1])), moment, tolerance):
        if one is not None and other is not None:
            yield one, other
        else:
            dropped.extend(item for item in (one, other) if item is not None)


def pair_nearest(
    items: Iterable[tuple[int, T]], moment: Callable[[T], float], tolerance: float
) -> Iterator[tuple[T | None, T | None]]:
    """Pair items of two cameras as they come, each with the nearest one of the other.

    Args:
        items: 0 or 1 for the left or the right camera, and an item; those of one camera in the
            order of their moments.
        moment: When an item was taken, in any unit.
        tolerance: Largest difference of the moments of a pair, in the same unit.

    Yields:
        Left and right item, None in place of a partner that there is not, in the order of their
        moments.
    """
    waiting: tuple[deque[T], deque[T]] = deque(), deque()
    for side, item in items:
        waiting[side].append(item)
        full = len(waiting[side]) > _MAX_WAITING
        yield from _settled(waiting, moment, tolerance, ended=full)
        if len(waiting[side]) > _MAX_WAITING:
            yield _alone(side, waiting[side].popleft())
    yield from _settled(waiting, moment, tolerance, ended=True)
    for side, items_left in enumerate(waiting):
        for item in items_left:
            yield _alone(side, item)


def _alone(side: int, item: T) -> tuple[T | None, T | None]:
    return (item, None) if side == 0 else (None, item)


def _settled(
    waiting: tuple[deque[T], deque[T]],
    moment: Callable[[T], float],
    tolerance: float,
    ended: bool,
) -> Iterator[tuple[T | None, T | None]]:
    """Take the items out whose partner is known, or that have none."""
    while all(waiting):
        side = int(moment(waiting[1][0]) < moment(waiting[0][0]))  # whose first one is the earlier
        early, late = waiting[side], waiting[1 - side]
        gap = moment(late[0]) - moment(early[0])
        if gap <= tolerance and len(early) == 1 and gap > 0 and not ended:
            return  # the next one may be nearer
        nearer = len(early) > 1 and abs(moment(late[0]) - moment(early[1])) < gap
        if gap > tolerance or nearer:
            yield _alone(side, early.popleft())
        else:
            yield waiting[0].popleft(), waiting[1].popleft()
