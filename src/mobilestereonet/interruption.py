"""Graceful handling of SIGINT (Ctrl-C)."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from threading import Event, current_thread, main_thread


@contextmanager
def sigint_sets_event(stop: Event, notify: Callable[[], object] = lambda: None) -> Iterator[None]:
    """Within, the first Ctrl-C sets an event; the second one interrupts as usual.

    Where Ctrl-C is not Python's own (a process in the background that ignores it, another handler)
    and in other threads than the main one it stays as it is.

    Args:
        stop: The event, which the work within looks at.
        notify: Called at the first Ctrl-C.
    """
    usual = signal.default_int_handler
    if signal.getsignal(signal.SIGINT) is not usual or current_thread() is not main_thread():
        yield
        return

    def ask(*_: object) -> None:
        stop.set()
        signal.signal(signal.SIGINT, usual)
        notify()

    signal.signal(signal.SIGINT, ask)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, usual)
