"""Steps that overlap: a thread makes the next items while the caller uses this one."""

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


def ahead(items: Iterable[T], count: int = 2) -> Generator[T]:
    """The same items in the same order, up to ``count`` of them made ahead in one thread.

    Args:
        items: What makes the items; an error of its own comes out here.
        count: How many may wait.
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


def newest(items: Generator[T]) -> Generator[T]:
    """The newest item whenever one is asked for: a live camera does not wait.

    Args:
        items: What makes the items; an error of its own comes out here, and so does the last one.
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
