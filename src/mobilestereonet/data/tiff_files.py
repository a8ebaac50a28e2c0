"""TIFF files: whether data that is deflated is whole, by its checksums."""

from __future__ import annotations

import zlib
from collections.abc import Mapping
from typing import Any

_COMPRESSION_TAG = 259
_DEFLATED = (8, 32946)
"""Adobe's number of the compression, and an older one."""

_PARTS = ((273, 279), (324, 325))
"""Tags of places and sizes: of strips, and of tiles."""

_MAX_BYTES_PER_PIXEL = 32


def check_tiff(content: bytes, tags: Mapping[int, Any], pixels: int) -> None:
    """Check the strips or tiles of a TIFF that are deflated; decoders ignore their checksums.

    Args:
        content: The file.
        tags: Its tags, as Pillow reads them.
        pixels: Number of pixels of the picture.

    Raises:
        ValueError: If one is damaged.
    """
    if tags.get(_COMPRESSION_TAG) not in _DEFLATED:
        return
    most = max(pixels, 1 << 20) * _MAX_BYTES_PER_PIXEL
    for places, sizes in _PARTS:
        for place, size in zip(tags.get(places, ()), tags.get(sizes, ()), strict=False):
            reader = zlib.decompressobj()
            try:
                reader.decompress(content[place : place + size], most)
            except zlib.error as error:
                raise ValueError(f"its data is damaged ({error})") from None
            if not reader.eof:
                raise ValueError("a part of its data is missing")
