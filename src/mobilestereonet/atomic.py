"""Outputs: whole files or none, and never over an input of the same call.

Everything that this package writes goes through `write_atomically`. A command that works for long
asks `check_outputs` first, so that nothing is refused after the work.
"""

from __future__ import annotations

import os
import stat
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryDirectory, TemporaryFile
from uuid import uuid4

from mobilestereonet.errors import InputError

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

_MAX_ENDING = 32
"""Characters of a name's endings, such as .tar.gz, that its temporary name has as well."""

_inputs: set[tuple[int, int]] | None = None
"""Device and inode of each file that the present call reads; None outside of `one_call`."""


@contextmanager
def one_call() -> Iterator[None]:
    """Context of one call of the command line, within which no input can be written over."""
    global _inputs
    before, _inputs = _inputs, set()
    try:
        yield
    finally:
        _inputs = before


def unused_path(path: Path) -> Path:
    """A path where nothing is: the given one, or name-2, name-3 and so on, with its ending."""
    tried, number = path, 1
    while os.path.lexists(tried):
        number += 1
        tried = path.with_stem(f"{path.stem}-{number}")
    return tried


def note_inputs(*paths: str | Path) -> None:
    """Note files that are read; within `one_call` none of them is written over afterwards."""
    if _inputs is not None:
        for path in paths:
            with suppress(OSError, ValueError):
                state = Path(path).stat()
                _inputs.add((state.st_dev, state.st_ino))


def make_folder(folder: Path) -> None:
    """Make a folder, unless it exists, and try it: before long work, not after.

    Raises:
        InputError: If no file can be written there.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with TemporaryFile(dir=folder):
            pass
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise InputError(
            f"{folder}: no files can be written there ({reason}): choose another folder"
        ) from error


@contextmanager
def locked_folder(folder: Path, wanted: bool = True) -> Iterator[None]:
    """Context that one process at a time can enter for a folder; however that ends, it is free.

    Where the system or the folder's disk has no such locks, nothing is locked.

    Args:
        folder: An existing folder.
        wanted: False for the other ranks of the run that has the lock.

    Raises:
        InputError: If another process is in it.
    """
    if not wanted or fcntl is None:
        yield
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        with suppress(OSError):  # of network drives
            try:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                raise InputError(
                    f"{folder}: another training is going on in it: wait for its end, or choose "
                    "another folder"
                ) from None
        yield
    finally:
        os.close(handle)


def check_outputs(*paths: Path, kind: str = "file") -> None:
    """Check where a call is going to write, before the work.

    Args:
        *paths: All files of the call. Those that exist already are fine: they are replaced.
        kind: What they are, for the message.

    Raises:
        InputError: If one is a folder, a device or a pipe, is write-protected, or is an input of
            this call; or if two are one file.
    """
    seen: dict[Path, Path] = {}
    for path in paths:
        target = _target(path, kind)
        if target in seen:
            names = f"{seen[target]} and {path}" if seen[target] != path else f"{path}, twice"
            raise InputError(f"one file for two outputs: {names}: choose another name for one")
        seen[target] = path


def write_atomically(path: str | Path, writer: Callable[[Path], object]) -> None:
    """Write a file so that no reader ever sees a part of it, whatever happens on the way.

    Args:
        path: The file to make or to replace; of a link, what it points to. Missing folders are
            made.
        writer: Writes the content to the path that it is given: a temporary name in the same
            folder, with the same ending.

    Raises:
        InputError: As `check_outputs`.
        OSError: If the file cannot be written. ``path`` is then as it was.
    """
    path = Path(path)
    target = _target(path, "file")
    target.parent.mkdir(parents=True, exist_ok=True)
    ending = "".join(target.suffixes)[-_MAX_ENDING:]
    temporary = target.with_name(f".{uuid4().hex[:12]}{ending}")
    try:
        writer(temporary)
        if target.exists():
            temporary.chmod(stat.S_IMODE(target.stat().st_mode))
        temporary.replace(target)
    except OSError as error:
        if error.filename == str(temporary):
            error.filename = str(path)  # what the user knows
        raise
    finally:
        temporary.unlink(missing_ok=True)


class GrowingFile:
    """A file that is written bit by bit in a hidden folder beside it, and appears when it is whole.

    As a context manager it ends in its folder's removal.

    Args:
        path: The file to make or to replace; of a link, what it points to. Missing folders are
            made.

    Attributes:
        folder: Folder to write into.

    Raises:
        InputError: As `check_outputs`.
        OSError: If the folder cannot be made.
    """

    def __init__(self, path: Path) -> None:
        self._target = _target(path, "file")
        self._target.parent.mkdir(parents=True, exist_ok=True)
        self._temporary = TemporaryDirectory(prefix=".", dir=self._target.parent)
        self.folder = Path(self._temporary.name)

    def appear(self, written: Path) -> None:
        """Put a whole file of the folder in its place."""
        written.replace(self._target)

    def __enter__(self) -> GrowingFile:
        return self

    def __exit__(self, *_: object) -> None:
        self._temporary.cleanup()


def write_text(path: str | Path, text: str) -> None:
    """Write UTF-8 text atomically; bytes of file names that are no text are escaped."""
    content = text.encode("utf-8", "backslashreplace")
    write_atomically(path, lambda temporary: temporary.write_bytes(content))


def _target(path: Path, kind: str) -> Path:
    """The file behind all links of a path; refuses what is no place for an output."""
    try:
        target = path.resolve()
        state = target.stat()
    except FileNotFoundError:
        return target
    except (OSError, ValueError, RuntimeError) as error:  # loops of links, NUL in the name
        reason = getattr(error, "strerror", None) or error
        raise InputError(f"{path}: cannot be written ({reason}): choose another {kind}") from None
    if stat.S_ISDIR(state.st_mode):
        raise InputError(f"{path} is a folder: name the {kind}, too")
    if not stat.S_ISREG(state.st_mode):
        raise InputError(f"{path} is a device or a pipe, and stays: name a {kind}")
    if _inputs is not None and (state.st_dev, state.st_ino) in _inputs:
        raise InputError(
            f"{path}: this call reads it, and would write over it: choose another name or folder"
        )
    if not os.access(target, os.W_OK):
        raise InputError(f"{path} is write-protected: choose another name")
    return target
