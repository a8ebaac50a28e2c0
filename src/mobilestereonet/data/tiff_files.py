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

_BITS_TAG = 258
_SAMPLES_TAG = 277

_TILE_SIZE_TAGS = (322, 323)

_MAX_TILE_PIXELS = 1 << 20
"""Pixels of a tile, beyond which the rest does not count: tiles may reach beyond the picture."""

_STEP_BYTES = 1 << 20
"""Bytes that are inflated at once."""


def check_tiff(content: bytes, tags: Mapping[int, Any], pixels: int) -> None:
    """Check the strips or tiles of a TIFF that are deflated; decoders ignore their checksums.

    Args:
        content: The file.
        tags: Its tags, as Pillow reads them.
        pixels: Number of pixels of the picture.

    Raises:
        ValueError: If one is damaged, or they hold far more than the picture.
    """
    if tags.get(_COMPRESSION_TAG) not in _DEFLATED:
        return
    bits = max(tags.get(_BITS_TAG, (1,))) * tags.get(_SAMPLES_TAG, 1)
    width, height = (tags.get(tag, 0) for tag in _TILE_SIZE_TAGS)
    tiled = len(tags.get(_PARTS[1][0], ())) * min(width * height, _MAX_TILE_PIXELS)
    left = max(2 * pixels, tiled, _MAX_TILE_PIXELS) * bits // 8
    for places, sizes in _PARTS:
        for place, size in zip(tags.get(places, ()), tags.get(sizes, ()), strict=False):
            left -= _inflated_size(content[place : place + size], left)


def _inflated_size(part: bytes, most: int) -> int:
    """Bytes that a strip or tile inflates to, of which few are held at a time."""
    reader, size = zlib.decompressobj(), 0
    while not reader.eof:
        try:
            step = len(reader.decompress(part, _STEP_BYTES))
        except zlib.error as error:
            raise ValueError(f"its data is damaged ({error})") from None
        part, size = reader.unconsumed_tail, size + step
        if not (step or reader.eof):
            raise ValueError("a part of its data is missing")
        if size > most:
            raise ValueError("its data is larger than the picture")
    return size
