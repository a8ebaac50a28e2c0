"""Number of threads that PyTorch computes with in one thread of the program."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager

import torch

_LOCK = threading.Lock()


@contextmanager
def use_threads(count: int | None) -> Iterator[None]:
    """Let PyTorch compute with a number of threads for a while, in the calling thread alone.

    Args:
        count: Threads; None leaves the setting untouched.
    """
    if count is None:
        yield
        return
    before = _set_threads(count)
    try:
        yield
    finally:
        _set_threads(before)


def _set_threads(count: int) -> int:
    """Set the calling thread's number; returns what it was.

    `torch.set_num_threads` also sets what threads start with that have not computed yet. A new
    thread tells that default and puts it back at once, so threads that begin meanwhile, or
    overlap, never see the number.
    """
    with _LOCK:
        before = torch.get_num_threads()
        if before != count:
            with ThreadPoolExecutor(max_workers=1) as new_thread:
                default = new_thread.submit(torch.get_num_threads).result()
                torch.set_num_threads(count)
                new_thread.submit(torch.set_num_threads, default).result()
        return before
