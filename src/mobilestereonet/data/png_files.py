"""PNG files: their size, checksums and EXIF, whatever texts lie beside the picture."""

from __future__ import annotations

import io
import struct

from PIL import PngImagePlugin

SIGNATURE = b"\x89PNG\r\n\x1a\n"
"""First bytes of a PNG."""


def png_pixels(content: bytes) -> int:
    """Number of pixels that the header of a PNG tells.

    Raises:
        struct.error: If there is none.
    """
    width, height = struct.unpack_from(">II", content, len(SIGNATURE) + 8)
    return int(width * height)


def check_png(content: bytes) -> bytes:
    """Check that a PNG has all its chunks, with their checksums, and return its EXIF.

    Pillow's own check refuses texts above 1 MB and unpacks the picture to find EXIF.

    Raises:
        SyntaxError, OSError, struct.error: If chunks are missing or damaged.
    """
    stream, exif = io.BytesIO(content[len(SIGNATURE) :]), b""
    chunks = PngImagePlugin.ChunkStream(stream)
    while (chunk := chunks.read())[0] != b"IEND":
        kind, _, length = chunk
        data = stream.read(length)
        chunks.crc(kind, data)
        if kind == b"eXIf":
            exif = data
    return exif
