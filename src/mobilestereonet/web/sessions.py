"""Sessions: each visitor's files in one folder, deleted when the visitor leaves."""

from __future__ import annotations

import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import mkdtemp
from threading import Lock, RLock

from mobilestereonet.errors import InputError

MAX_IDLE_SECONDS = 3600
"""Seconds after which any file is deleted, whether its page is open or not."""

MAX_SESSIONS = 50
"""Sessions that are open at once; for one more, the one idle longest is closed."""


class Session:
    """Folder of one visitor. Its name can't be guessed, which matters: names give access."""

    def __init__(self, root: Path) -> None:
        """Make the folder, below ``root``."""
        self.folder = Path(mkdtemp(dir=root))
        self.used = time.monotonic()
        self._closed = False
        self._slots: dict[str, Path] = {}
        # Held while files are written: who deletes waits, or a late one would bring folders back.
        self._lock = RLock()

    @contextmanager
    def replace(self, slot: str) -> Iterator[Path]:
        """Fill a slot anew, or leave it as it is.

        Args:
            slot: What is kept, such as ``left``.

        Yields:
            An empty folder. It takes the place of the slot's former one, unless an error is
            raised: then nothing of it stays.

        Raises:
            InputError: If the session is closed.
        """
        with self._lock:
            if self._closed:
                raise InputError("this page was closed: load it again")
            folder = Path(mkdtemp(prefix=f"{slot}-", dir=self.folder))
            try:
                yield folder
            except BaseException:
                shutil.rmtree(folder, ignore_errors=True)
                raise
            self.drop(slot)
            self._slots[slot] = folder

    def drop(self, slot: str) -> None:
        """Empty a slot."""
        with self._lock:
            if slot in self._slots:
                shutil.rmtree(self._slots.pop(slot), ignore_errors=True)

    def swap(self, first: str, second: str) -> None:
        """Exchange what two slots hold."""
        with self._lock:
            for slot, held in zip(
                (first, second), (self._slots.get(second), self._slots.get(first)), strict=True
            ):
                self._slots.pop(slot, None)
                if held is not None:
                    self._slots[slot] = held

    def file(self, slot: str, pattern: str = "*") -> Path | None:
        """The first file of a slot that matches; None if there is none."""
        with self._lock:
            return next(self._slots[slot].glob(pattern), None) if slot in self._slots else None

    def holds(self, slot: str) -> bool:
        """Whether a slot is filled."""
        return slot in self._slots

    def close(self) -> None:
        """Delete everything, after what is being written."""
        with self._lock:
            self._closed = True
            shutil.rmtree(self.folder, ignore_errors=True)


class Sessions:
    """Open sessions by the name that the browser gives."""

    def __init__(
        self, root: Path, *, max_idle: float = MAX_IDLE_SECONDS, max_sessions: int = MAX_SESSIONS
    ) -> None:
        """Keep them below ``root``.

        Args:
            root: Folder of their folders.
            max_idle: Seconds after which an idle one is closed, when any is asked for.
            max_sessions: Number of sessions that are open at once.
        """
        self.root = root
        self.max_idle = max_idle
        self.max_sessions = max_sessions
        root.mkdir(mode=0o700, parents=True, exist_ok=True)
        self._open: dict[str, Session] = {}  # the one idle longest comes first
        self._ended = False
        self._lock = Lock()

    def __getitem__(self, name: str) -> Session:
        """The session of that name, opened if it is not; idle ones make room.

        Not every client says goodbye, so that asking for one closes others.

        Raises:
            InputError: After `close_all`.
        """
        with self._lock:
            if self._ended:
                raise InputError("the server is being ended")
            session = self._open.pop(name, None) or Session(self.root)
            session.used = time.monotonic()
            surplus = len(self._open) + 1 - self.max_sessions
            idle = [
                other
                for place, (other, its) in enumerate(self._open.items())
                if place < surplus or session.used - its.used > self.max_idle
            ]
            self._open[name] = session
        for other in idle:
            self.close(other)
        return session

    def close(self, name: str) -> None:
        """Close a session, if it is open."""
        with self._lock:
            session = self._open.pop(name, None)
        if session is not None:
            session.close()

    def close_all(self) -> None:
        """Close all sessions, after what they are writing, and let no other be opened."""
        with self._lock:
            self._ended = True
            names = list(self._open)
        for name in names:
            self.close(name)
