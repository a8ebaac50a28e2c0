"""Number of threads that PyTorch computes with: in one thread of the program, or on busy cores."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from functools import partial

import torch
import torch.nn.functional as F

from mobilestereonet.timing import time_interleaved

_LOCK = threading.Lock()

THREAD_SETTINGS = ("OMP_NUM_THREADS", "MKL_NUM_THREADS")
"""What a user says about threads in the environment, which holds."""

_TRIAL_SHAPE = (1, 32, 128, 128)
"""Features of the convolution that is timed: some milliseconds of a core, as a layer's."""

_TRIAL_REPEATS = 7

_CLEARLY_FASTER = 0.9
"""Part of the time of all threads below which fewer of them are taken."""


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


def fitting_threads() -> int:
    """Number of threads with which PyTorch computes fastest beside what else the machine does.

    Where other programs use the cores, or a container has fewer of them than it sees, threads wait
    for each other, and few are faster than many. A convolution is timed with all threads, with
    half of them and so on, in turns; it takes some 0.1 s. What the environment says
    (``OMP_NUM_THREADS``) is not questioned.
    """
    most = torch.get_num_threads()
    if most == 1 or any(name in os.environ for name in THREAD_SETTINGS):
        return most
    counts = [most]
    while counts[-1] > 1:
        counts.append(counts[-1] // 2)
    features = torch.rand(_TRIAL_SHAPE)
    weight = torch.rand(_TRIAL_SHAPE[1], _TRIAL_SHAPE[1], 3, 3)

    def convolve(count: int) -> None:
        with torch.inference_mode(), use_threads(count):
            F.conv2d(features, weight, padding=1)

    for count in counts:
        convolve(count)  # threads are started, and code is loaded
    runs = (partial(convolve, count) for count in counts)
    seconds = time_interleaved(*runs, repeats=_TRIAL_REPEATS)
    best = min(range(len(counts)), key=seconds.__getitem__)
    return counts[best] if seconds[best] < _CLEARLY_FASTER * seconds[0] else most


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
