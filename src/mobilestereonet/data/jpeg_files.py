"""JPEG files: whether their data is whole, and both pictures of stereo cameras' MPO files."""

from __future__ import annotations

import re
from typing import Any, cast

import numpy as np
import simplejpeg
from numpy.typing import NDArray

_SEGMENT = re.compile(rb"\xff+([\xc0-\xfe])(..)", re.DOTALL)
_SCAN = re.compile(
    rb"(\xff\xda\x00(?:\x08\x01..|\x0a\x02.{4}|\x0c\x03.{6}|\x0e\x04.{8})).{3}", re.DOTALL
)
"""Header of a scan; its last three bytes say something in progressive files only."""

_START_OF_SCAN = b"\xda"
_SEQUENTIAL = (b"\xc0", b"\xc1")
_NOTES = tuple(bytes([marker]) for marker in (*range(0xE0, 0xF0), 0xFE))
"""Markers of segments that do not hold data of the picture: APP0 to APP15, and comments."""

_UNKNOWN_SUBSAMPLING = "Could not determine subsampling"
"""Error of TurboJPEG, which libjpeg does not have."""

_FILLING = re.compile(r"(\d+) extraneous bytes before marker 0xd9")
"""Warning of bytes behind the data: zeros by some cameras, or data that a hole has shifted."""

_ENTRIES_TAG = 0xB002
"""Of the MP format: attribute, size and place of each picture."""


def check_jpeg(content: bytes) -> NDArray[np.uint8] | None:
    """Check that a JPEG has all its data, which OpenCV fills with grey where it has not.

    Returns:
        Its brightness, (H, W). None if it could not be checked: TurboJPEG does not know how its
        colours are subsampled, as of many JPEG files in CMYK.

    Raises:
        ValueError: If parts of it are missing or damaged.
    """
    picture = without_notes(content)
    try:
        return _brightness(picture, strict=True)
    except ValueError as error:
        if _UNKNOWN_SUBSAMPLING in str(error):
            return None
        if not _is_harmless(str(error), content):
            raise
    return _brightness(picture, strict=False)


def _brightness(content: bytes, *, strict: bool) -> NDArray[np.uint8]:
    # Whole: a decoder that makes it smaller tells less.
    return cast(NDArray[np.uint8], simplejpeg.decode_jpeg(content, "GRAY", strict=strict)[..., 0])


def cut_frames(image: Any, content: bytes) -> list[bytes]:
    """Cut the two JPEG files out of an MPO.

    Args:
        image: The file as Pillow opens it.
        content: The file.

    Returns:
        Both, or the file itself if it holds one picture or its second is of another size than the
        first, as the previews and gain maps in photos of telephones are.
    """
    entries = image.mpinfo[_ENTRIES_TAG]
    frames, sizes = [], set()
    for index, entry in enumerate(entries[:2]):
        image.seek(index)
        frames.append(content[image.offset : image.offset + entry["Size"]])
        sizes.add(image.size)
    return frames if len(frames) == 2 and len(sizes) == 1 else [content]


def without_notes(content: bytes) -> bytes:
    """The JPEG without what libjpeg may warn of although the picture does not depend on it.

    It tells the first warning alone, which would hide one of missing data: of notes in another
    version, or of the numbers in a sequential scan's header, which some telephones write wrongly.
    """
    kept, at, sequential = [content[:2]], 2, False
    while (segment := _SEGMENT.match(content, at)) and segment[1] != _START_OF_SCAN:
        end = segment.start(2) + int.from_bytes(segment[2], "big")
        if segment[1] not in _NOTES:
            kept.append(content[at:end])
        sequential |= segment[1] in _SEQUENTIAL
        at = end
    scans = content[at:]
    if sequential:
        scans = _SCAN.sub(lambda header: header[1] + b"\0\x3f\0", scans)
    return b"".join((*kept, scans))


def _is_harmless(warning: str, content: bytes) -> bool:
    if filling := _FILLING.search(warning):
        return bytes(int(filling[1])) + b"\xff\xd9" in content
    # Markers of other processes within the data, as random bytes may hold, are damage.
    damage = ("Unsupported marker", "Unsupported JPEG process")
    return warning.startswith("Unsupported") and not warning.startswith(damage)
