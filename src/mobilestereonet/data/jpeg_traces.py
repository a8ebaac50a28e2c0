"""What missing bytes leave in the picture of a JPEG whose data decodes as if it were whole.

Where the decoder finds its way back behind a hole, all later blocks keep a wrong brightness, as
each is stored as a difference from the one before.
"""

from __future__ import annotations

import io

import cv2
import numpy as np
import simplejpeg
from numpy.typing import NDArray
from PIL import Image

from mobilestereonet.data.jpeg_files import without_notes

_Grey = NDArray[np.uint8]

_BLOCK_PX = 8

_CLIPPED = 1.5
_CLIPPED_PER_STEP = 0.2
"""Levels that clipping may change a block's mean by: so many, and for each unit of the mean step
of quantisation. Whole files stay below two thirds of the sum, dots and letters at any quality too.
"""

_SEAM = 0.55
"""Share of columns that step the same way along a seam, more than beside it. Below it in all of
728 photographs and textures of 512 px, and below 0.15 in photos of stereo cameras."""

_SEAM_MARGIN_PX = 64
"""Columns at both ends in which the place of a hole is not looked for."""


def missing_bytes(content: bytes) -> str:
    """Find the trace of missing bytes in a JPEG that decodes without an error.

    Args:
        content: The file, of one channel or three.

    Returns:
        What tells of them, in words; empty if nothing does.
    """
    picture = without_notes(content)
    grey = simplejpeg.decode_jpeg(picture, "GRAY", strict=False)[..., 0]
    means = simplejpeg.decode_jpeg(
        picture, "GRAY", min_height=1, min_width=1, min_factor=_BLOCK_PX, strict=False
    )[..., 0]
    with Image.open(io.BytesIO(content)) as image:
        steps = image.quantization[0]  # type: ignore[attr-defined]
    allowed = _CLIPPED + _CLIPPED_PER_STEP * float(np.mean(steps))
    if _clipped_levels(grey, means) > allowed:
        return "some of its blocks are far brighter or darker than a picture can be"
    if (row := _seam_row(grey, 1 + steps[0] / _BLOCK_PX)) is not None:
        return f"the brightness of its blocks changes all along row {row}"
    return ""


def _clipped_levels(grey: _Grey, stored_means: _Grey) -> int:
    """By how many levels the mean of a block (h, w) differs most from the one stored for it.

    Levels below 0 and above 255 are clipped by the decoder, which changes a block's mean.
    """
    rows, columns = (size // _BLOCK_PX for size in grey.shape)
    if not rows or not columns:
        return 0
    whole = grey[: rows * _BLOCK_PX, : columns * _BLOCK_PX]
    means = cv2.resize(whole, (columns, rows), interpolation=cv2.INTER_AREA).astype(int)
    return int(np.abs(means - stored_means[:rows, :columns]).max())


def _seam_row(grey: _Grey, least: float) -> int | None:
    """Row in which the blocks behind a hole begin to be of another brightness, or None.

    Args:
        grey: Picture (H, W).
        least: Levels that a step is higher than; blocks of a smooth area differ by one step of
            quantisation.

    The first row of blocks that a hole is in steps up or down against the row above it from the
    hole on, and the next row against this one before that column: a staircase of one step on the
    grid of blocks, which hardly any picture has by itself.
    """
    height, width = grey.shape
    ends = np.arange(_BLOCK_PX, height - 1, _BLOCK_PX)
    splits = np.arange(_SEAM_MARGIN_PX, width - _SEAM_MARGIN_PX + 1, _BLOCK_PX)
    if len(ends) < 3 or not len(splits):
        return None
    over, above, below, under = (grey[ends + at].astype(np.float32) for at in (-2, -1, 0, 1))
    step = below - above - (under - below + above - over) / 2
    sums = np.cumsum(np.sign(step) * (np.abs(step) > least), axis=1)
    before = sums[:, splits - 1] / splits
    behind = (sums[:, -1:] - sums[:, splits - 1]) / (width - splits)
    best, row = _SEAM, None
    for blocks in (1, 2):  # per row that is decoded together: two where colours are subsampled
        first, second = behind[:-blocks], before[blocks:]
        along = np.where(first * second > 0, np.minimum(np.abs(first), np.abs(second)), 0)
        beside = np.maximum(np.abs(before[:-blocks]), np.abs(behind[blocks:]))
        seam = along - beside
        if seam.max() > best:
            best, row = seam.max(), int(ends[seam.max(axis=1).argmax()])
    return row
