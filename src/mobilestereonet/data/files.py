"""PFM, PNG and NumPy files, and finding of files; writing is atomic."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import suppress
from os import SEEK_END
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from mobilestereonet.atomic import note_inputs, write_atomically
from mobilestereonet.data.images import Array
from mobilestereonet.errors import InputError

# The header is text, the numbers that follow may look like anything: one line end closes it.
# Writers differ in what separates the fields (new lines, blanks, blanks before a new line, CRLF,
# comments), so anything that is white space does.
_PFM_HEADER = re.compile(
    rb"(?P<kind>PF|Pf)(?:\s|#[^\n]*\n)+(?P<width>\d{1,9})\s+(?P<height>\d{1,9})\s+"
    rb"(?P<scale>\S+)[ \t]*\r?\n"
)


_PNG_END = bytes.fromhex("0000000049454e44ae426082")
"""The last chunk of every PNG file."""
_HEADER_BYTES = 512


def read_bytes(path: str | Path) -> bytes:
    """Read the content of a file.

    Raises:
        FileNotFoundError: If there is no such file; the message names it.
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such file")
    note_inputs(path)
    return path.read_bytes()


def visible(root: Path, pattern: str) -> Iterator[Path]:
    """Paths below a folder that a glob finds, without hidden ones unless it asks for them.

    A Mac puts a file ``._0001.png`` beside each ``0001.png`` on disks of other systems.
    """
    hidden = any(part.startswith(".") for part in Path(pattern).parts)
    for path in root.glob(pattern):
        if hidden or not any(part.startswith(".") for part in path.relative_to(root).parts):
            yield path


def read_pfm(path: str | Path) -> npt.NDArray[np.float32]:
    """Read a PFM file as any public writer writes it.

    The scale in the header only tells the byte order (negative: little endian). The values are
    not multiplied by it: writers put arbitrary factors there.

    Args:
        path: The PFM file.

    Returns:
        Float32 array with the top row first: (H, W) for a grey file (``Pf``), (H, W, 3) for a
        colour file (``PF``).

    Raises:
        FileNotFoundError: If there is no such file.
        InputError: If the header is no PFM header or the file is too short for its size.
    """
    content = read_bytes(path)
    header = _PFM_HEADER.match(content)
    if header is None:
        raise InputError(f"{path}: not a PFM file, it starts with {content[:24]!r}")
    try:
        scale = float(header["scale"])
    except ValueError:
        scale = float("nan")
    if not abs(scale) > 0:
        raise InputError(
            f"{path}: PFM scale must be a number other than 0, got {header['scale']!r}"
        )
    shape = (int(header["height"]), int(header["width"]), 3 if header["kind"] == b"PF" else 1)
    count = shape[0] * shape[1] * shape[2]
    found = len(content) - header.end()
    if count == 0 or found < 4 * count:
        raise InputError(
            f"{path}: PFM of {shape[1]}x{shape[0]} with {shape[2]} channel(s) needs {4 * count} "
            f"bytes after the header, found {found}: is the file cut off?"
        )
    values = np.frombuffer(content, "<f4" if scale < 0 else ">f4", count, header.end())
    rows = values.reshape(shape)[::-1].astype(np.float32)
    return rows[..., 0] if shape[2] == 1 else rows


def is_whole(path: str | Path) -> bool:
    """Whether there is a file that is not cut off, as far as its beginning and end tell.

    A file system that lost its power can leave files empty or short that were written in one go.
    """
    path = Path(path)
    if not path.is_file():
        return False
    with path.open("rb") as file:
        content = file.read(_HEADER_BYTES)
        size = file.seek(0, SEEK_END)
        file.seek(max(0, size - len(_PNG_END)))
        end = file.read()
    suffix = path.suffix.lower()
    if suffix == ".png":
        return end == _PNG_END
    if suffix == ".pfm":
        header = _PFM_HEADER.match(content)
        channels = 3 if header and header["kind"] == b"PF" else 1
        return header is not None and size >= header.end() + 4 * channels * (
            int(header["width"]) * int(header["height"])
        )
    if suffix == ".npy":
        with suppress(ValueError, EOFError, OSError):
            return bool(np.load(path, mmap_mode="r", allow_pickle=False).size)
        return False
    return size > 0


def write_png(path: str | Path, image: Array) -> None:
    """Write a PNG file atomically.

    Args:
        path: The file to write.
        image: uint8 or uint16, RGB of shape (H, W, 3) or grey of shape (H, W).

    Raises:
        InputError: If the shape or the dtype is another one.
    """
    colour = image.ndim == 3 and image.shape[2] == 3
    if image.dtype not in (np.uint8, np.uint16) or not (colour or image.ndim == 2):
        raise InputError(
            f"{path}: a PNG takes uint8 or uint16 of shape (H, W) or (H, W, 3), "
            f"got {image.dtype} of shape {image.shape}"
        )
    _, content = cv2.imencode(".png", image[..., ::-1] if colour else image)
    write_atomically(path, lambda temporary: temporary.write_bytes(content.tobytes()))


def write_pfm(path: str | Path, values: Array) -> None:
    """Write a PFM file, little endian, atomically.

    Args:
        path: The file to write.
        values: Numbers of shape (H, W) or (H, W, 3), stored as float32.

    Raises:
        InputError: If the shape is another one.
    """
    if not (values.ndim == 2 or (values.ndim == 3 and values.shape[2] == 3)):
        raise InputError(f"{path}: a PFM takes shape (H, W) or (H, W, 3), got {values.shape}")
    kind = "Pf" if values.ndim == 2 else "PF"
    header = f"{kind}\n{values.shape[1]} {values.shape[0]}\n-1.0\n".encode()
    content = header + values[::-1].astype("<f4").tobytes()
    write_atomically(path, lambda temporary: temporary.write_bytes(content))


def write_npy(path: str | Path, values: Array) -> None:
    """Write an array in NumPy's own format, atomically.

    Args:
        path: The file to write.
        values: Array of any shape and number type.
    """

    def write(temporary: Path) -> None:
        with temporary.open("wb") as file:
            np.save(file, values, allow_pickle=False)

    write_atomically(path, write)
