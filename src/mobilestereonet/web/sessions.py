"""A visitor's files: in one folder, which goes when the visitor does."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import mkdtemp
from threading import Lock

from mobilestereonet.errors import InputError


class Session:
    """One visitor's folder. Its name can't be guessed, which matters: names give access."""

    def __init__(self, root: Path) -> None:
        """Make the folder, below ``root``."""
        self.folder = Path(mkdtemp(dir=root))
        self._closed = False
        self._slots: dict[str, Path] = {}

    @contextmanager
    def replace(self, slot: str) -> Iterator[Path]:
        """Fill a slot anew, or leave it as it is.

        Args:
            slot: What is kept, such as ``left``.

        Yields:
            An empty folder. It takes the place of the slot's former one unless an error is raised
            or the session is closed meanwhile: then nothing of it stays.

        Raises:
            InputError: If the session is closed.
        """
        folder = self.folder / slot
        try:
            if not self._closed:
                folder = Path(mkdtemp(prefix=f"{slot}-", dir=self.folder))
                yield folder
            if self._closed:
                raise InputError("this page was closed: load it again")
        except BaseException:
            shutil.rmtree(self.folder if self._closed else folder, ignore_errors=True)
            raise
        self.drop(slot)
        self._slots[slot] = folder

    def drop(self, slot: str) -> None:
        """Empty a slot."""
        if slot in self._slots:
            shutil.rmtree(self._slots.pop(slot), ignore_errors=True)

    def file(self, slot: str, pattern: str = "*") -> Path | None:
        """The first file of a slot that matches; None if there is none."""
        return next(self._slots[slot].glob(pattern), None) if slot in self._slots else None

    def close(self) -> None:
        """Delete everything, now and when a running `replace` ends."""
        self._closed = True
        shutil.rmtree(self.folder, ignore_errors=True)


class Sessions:
    """The sessions that are open, by what the browser calls itself."""

    def __init__(self, root: Path) -> None:
        """Keep them below ``root``."""
        self.root = root
        root.mkdir(mode=0o700, parents=True, exist_ok=True)
        self._open: dict[str, Session] = {}
        self._lock = Lock()

    def __getitem__(self, name: str) -> Session:
        """The session of that name, opened if it is not."""
        with self._lock:
            if name not in self._open:
                self._open[name] = Session(self.root)
            return self._open[name]

    def close(self, name: str) -> None:
        """Close a session, if it is open."""
        with self._lock:
            session = self._open.pop(name, None)
        if session is not None:
            session.close()
