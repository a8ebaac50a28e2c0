"""Writing without half-written files, and without a late surprise."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryFile
from uuid import uuid4

from mobilestereonet.errors import InputError


def make_folder(folder: Path) -> None:
    """Make a folder, unless it exists, and try it: before long work, not after.

    Raises:
        InputError: If no file can be written there.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise InputError(
            f"{folder}: no files can be written there ({error.strerror}): choose another folder"
        ) from error


def refuse_folder(path: Path, kind: str = "file") -> None:
    """Refuse a folder where a file is to be written.

    Raises:
        InputError: If it is one; the message asks for the name of a file of this kind.
    """
    if path.is_dir():
        raise InputError(f"{path} is a folder: name the {kind}, too")


def write_atomically(path: str | Path, writer: Callable[[Path], object]) -> None:
    """Write a file so that no reader ever sees a part of it, whatever happens on the way.

    Args:
        path: The file to make or to replace. Missing folders are made.
        writer: Writes the content to the path that it is given: a temporary name in the same
            folder, with the same ending.

    Raises:
        InputError: If ``path`` is a folder.
        OSError: If the file cannot be written. ``path`` is then as it was.
    """
    path = Path(path)
    refuse_folder(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{uuid4().hex[:12]}.{path.name}")
    try:
        writer(temporary)
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)
