"""Progress bars with the rate and the time left, messages above them, and the time of long work."""

from __future__ import annotations

import sys
from threading import Lock, Timer
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.progress import Progress


PATIENCE_S = 2.0
"""Seconds after which work is shown to go on."""


class LongWork:
    """A line on stderr, with the time that goes by on a terminal, of work that lasts."""

    def __init__(self, text: str) -> None:
        """Show it after `PATIENCE_S`.

        Args:
            text: What is done.
        """
        self.text = text
        self._lock = Lock()
        self._bar: Progress | None = None
        self._is_shown = self._has_ended = False
        self._timer = Timer(PATIENCE_S, self._show)
        self._timer.daemon = True
        self._timer.start()

    def end(self) -> bool:
        """Take the line away; returns whether it was shown."""
        self._timer.cancel()
        with self._lock:
            self._has_ended = True
            if self._bar is not None:
                self._bar.stop()
            return self._is_shown

    def _show(self) -> None:
        from rich.console import Console
        from rich.file_proxy import FileProxy
        from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

        with self._lock:
            if self._has_ended:
                return
            self._is_shown = True
            console = Console(stderr=True)
            if not console.is_terminal or isinstance(sys.stderr, FileProxy):  # of another bar
                print(f"msnet: {self.text} ...", file=sys.stderr, flush=True)
                return
            columns = SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn()
            self._bar = Progress(*columns, console=console, transient=True)
            self._bar.add_task(self.text, total=None)
            self._bar.tasks[0].start_time = self._bar.get_time() - PATIENCE_S
            self._bar.start()


def progress_bar(unit: str) -> Progress:
    """Make a progress bar on stderr: items done, rate, time left.

    Args:
        unit: What is counted, in the plural.
    """
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        ProgressColumn,
        Task,
        TextColumn,
        TimeRemainingColumn,
    )
    from rich.text import Text

    class Rate(ProgressColumn):
        def render(self, task: Task) -> Text:
            return Text("" if task.speed is None else f"{task.speed:.1f} {unit} per second")

    console = Console(stderr=True)
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        Rate(),
        TimeRemainingColumn(),
        console=console,
        transient=True,
        disable=not console.is_terminal,
    )


def report_skipped(progress: Progress, name: str, problem: str) -> None:
    """Print above the bar what was skipped, and why."""
    progress.console.print(
        f"msnet: {name} skipped: {problem}", markup=False, highlight=False, soft_wrap=True
    )
