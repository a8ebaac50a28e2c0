"""Depth map files: 16-bit PNG, NumPy and TIFF."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from mobilestereonet.atomic import write_atomically
from mobilestereonet.data.files import write_npy, write_png
from mobilestereonet.data.images import Array
from mobilestereonet.errors import InputError

DEPTH_FORMATS = (".png", ".npy", ".tif", ".tiff")

_MAX_PNG_DEPTH_M = 65.535


def check_depth_file(path: str | Path) -> Path:
    """Check that depth can be written in the format that a path's ending names.

    Raises:
        InputError: If it can't.
    """
    path = Path(path)
    if path.suffix.lower() not in DEPTH_FORMATS:
        raise InputError(f"{path}: depth is written as {', '.join(DEPTH_FORMATS)}")
    return path


def write_depth(path: str | Path, depth: Array) -> None:
    """Write a depth map atomically, in the format that the path's ending names.

    Args:
        path: ``.png``: 16-bit millimetres, 0 where unknown or beyond 65.535 m. ``.npy``, ``.tif``
            or ``.tiff``: float32 metres, 0 where unknown.
        depth: (H, W) in metres, 0 where unknown.

    Raises:
        InputError: If the ending is another one.
    """
    path = check_depth_file(path)
    suffix = path.suffix.lower()
    if suffix == ".png":
        storable = np.where(depth <= _MAX_PNG_DEPTH_M, depth, 0)
        # A known depth that rounds to 0 would read as unknown.
        levels = np.where(storable > 0, np.rint(storable * 1000).clip(1), 0)
        write_png(path, levels.astype(np.uint16))
    elif suffix == ".npy":
        write_npy(path, depth.astype(np.float32))
    else:
        _, content = cv2.imencode(".tiff", depth.astype(np.float32))
        write_atomically(path, lambda temporary: temporary.write_bytes(content.tobytes()))
