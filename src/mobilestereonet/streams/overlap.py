"""Overlapping work: a thread makes the next items while the caller uses this one."""

from __future__ import annotations

from collections import deque
from collections.abc import Generator, Iterable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from queue import Empty, Full, Queue
from threading import Event, Thread
from typing import TypeVar

T = TypeVar("T")

_END = object()


def prefetch(items: Iterable[T], count: int = 2) -> Generator[T]:
    """Prefetch items: the same ones in the same order, up to ``count`` made ahead in a thread.

    Args:
        items: Their source; an error of its own is raised here.
        count: Number of items that may wait.
    """
    iterator = iter(items)
    worker = ThreadPoolExecutor(1)
    try:
        waiting = deque(worker.submit(next, iterator, _END) for _ in range(count))
        while (item := waiting.popleft().result()) is not _END:
            waiting.append(worker.submit(next, iterator, _END))
            yield item  # type: ignore[misc]
    finally:
        worker.shutdown(cancel_futures=True)
        if isinstance(iterator, Generator):
            iterator.close()


def latest_only(items: Generator[T]) -> Generator[T]:
    """Give the latest item whenever one is asked for, and drop earlier ones, as cameras need it.

    Args:
        items: Their source; an error of its own is raised here. Its last item is always given.
    """
    latest: Queue[T | object] = Queue(1)
    stop = Event()
    thread = Thread(target=_hand_over, args=(items, latest, stop), daemon=True)
    thread.start()
    try:
        while (item := latest.get()) is not _END:
            if isinstance(item, BaseException):
                raise item
            yield item  # type: ignore[misc]
    finally:
        stop.set()
        with suppress(Empty):
            latest.get_nowait()
        thread.join()
        items.close()


def _hand_over(items: Iterable[T], latest: Queue[T | object], stop: Event) -> None:
    last: object = _END
    try:
        for item in items:
            # An item that nobody took gives way to this one.
            with suppress(Empty):
                latest.get_nowait()
            latest.put(item)
            if stop.is_set():
                return
    except BaseException as error:
        last = error
    while not stop.is_set():
        with suppress(Full):
            latest.put(last, timeout=0.1)
            return
