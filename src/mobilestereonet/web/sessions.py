"""A visitor's files: in one folder, which goes when the visitor does."""

from __future__ import annotations

import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import mkdtemp
from threading import Lock, RLock

from mobilestereonet.errors import InputError

OLDEST = 3600
"""Seconds after which any file goes, whether its page is open or not."""

MOST = 50
"""Sessions that are open at once; one more, and the one idle longest is closed."""


class Session:
    """One visitor's folder. Its name can't be guessed, which matters: names give access."""

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

    def file(self, slot: str, pattern: str = "*") -> Path | None:
        """The first file of a slot that matches; None if there is none."""
        with self._lock:
            return next(self._slots[slot].glob(pattern), None) if slot in self._slots else None

    def close(self) -> None:
        """Delete everything, after what is being written."""
        with self._lock:
            self._closed = True
            shutil.rmtree(self.folder, ignore_errors=True)


class Sessions:
    """The sessions that are open, by what the browser calls itself."""

    def __init__(self, root: Path, *, oldest: float = OLDEST, most: int = MOST) -> None:
        """Keep them below ``root``.

        Args:
            root: Folder of their folders.
            oldest: Seconds after which an idle one is closed, when any is asked for.
            most: How many are open at once.
        """
        self.root = root
        self.oldest = oldest
        self.most = most
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
            surplus = len(self._open) + 1 - self.most
            idle = [
                other
                for place, (other, its) in enumerate(self._open.items())
                if place < surplus or session.used - its.used > self.oldest
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
