"""Files of a result: its maps in the formats of the field, and a picture."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mobilestereonet.data.disparity_files import KITTI_SCALE, write_disparity_png
from mobilestereonet.data.files import write_npy, write_pfm, write_png
from mobilestereonet.data.images import FloatMap, Mask, Picture

MAP_FILES = {
    "png": "disparity.png",
    "pfm": "disparity.pfm",
    "npy": "disparity.npy",
    "picture": "picture.png",
    "confidence": "confidence.png",
    "confidence_npy": "confidence.npy",
    "right_png": "right_disparity.png",
    "right_npy": "right_disparity.npy",
    "occluded": "occluded.png",
}
"""Ends of the names of all files that `StereoResult.save` may write, by kind."""

MAX_PNG_DISPARITY_PX = 65535 / KITTI_SCALE
"""Largest disparity that a 16-bit PNG holds."""


def save_maps(
    folder: Path,
    stem: str,
    *,
    disparity: FloatMap,
    picture: Picture,
    confidence: FloatMap | None,
    right_disparity: FloatMap | None,
    occluded: Mask | None,
) -> dict[str, Path]:
    """Write the maps of a result, each file atomically; `StereoResult` has them by these names.

    Args:
        folder: Folder to write to.
        stem: How the files' names begin.
        disparity: (H, W) in px, infinite where it is not known.
        picture: What shows it.
        confidence: (H, W) in 0..1, if it is known.
        right_disparity: (H, W) in px, if it is known.
        occluded: (H, W), if it is known.

    Returns:
        The paths by the kinds of `MAP_FILES`.
    """
    files: dict[str, tuple[Callable[[Path, NDArray[Any]], None], NDArray[Any]]] = {
        "png": (_write_storable, disparity),
        "pfm": (write_pfm, disparity),
        "npy": (write_npy, disparity),
        "picture": (write_png, picture),
    }
    if confidence is not None:
        grey = np.rint(255 * confidence).astype(np.uint8)
        files["confidence"] = (write_png, grey)
        files["confidence_npy"] = (write_npy, confidence)
    if right_disparity is not None:
        files["right_png"] = (_write_storable, right_disparity)
        files["right_npy"] = (write_npy, right_disparity)
    if occluded is not None:
        files["occluded"] = (write_png, np.uint8(255) * occluded)
    paths = {}
    for kind, (write, values) in files.items():
        paths[kind] = folder / f"{stem}_{MAP_FILES[kind]}"
        write(paths[kind], values)
    return paths


def _write_storable(path: Path, disparity: FloatMap) -> None:
    write_disparity_png(path, disparity, disparity <= MAX_PNG_DISPARITY_PX)
