"""What missing bytes leave in the picture of a JPEG whose data decodes as if it were whole.

Where the decoder finds its way back behind a hole, all later blocks keep a wrong brightness, as
each is stored as a difference from the one before.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import simplejpeg
from numpy.typing import NDArray

from mobilestereonet.data.jpeg_files import without_notes

_Grey = NDArray[np.uint8]

_BLOCK_PX = 8
"""Height and width of what a JPEG transforms at a time."""

_CLIPPED = 1.5
_CLIPPED_PER_STEP = 0.2
"""Levels that clipping may change a block's mean by: so many, and for each unit of the mean step
of quantisation. Whole files stay below two thirds of the sum, dots and letters at any quality too.
"""

_DERINGING = 31
_DERINGING_PER_STEP = 2
_DERINGING_MARGIN = 4
"""Levels above white that mozjpeg stores on purpose: at most so many, and for each unit of the
first step of quantisation; with a margin."""

_SEAM = 0.55
"""Share of columns that step the same way along a seam, less the share beside it. It is smaller in
all of 728 photographs and textures of 512 px, and below 0.15 in photos of stereo cameras."""

_SEAM_MARGIN_PX = 64
"""Columns at both ends in which the place of a hole is not looked for."""


def missing_bytes(content: bytes, grey: _Grey, image: Any) -> str:
    """Find the trace of missing bytes in a JPEG that decodes without an error.

    Args:
        content: The file.
        grey: Its brightness (H, W), from `check_jpeg`.
        image: The file as Pillow opens it.

    Returns:
        Description of the trace; empty if there is none, and of a picture in CMYK, whose grey is
        no sum of its channels.
    """
    steps = image.quantization.get(image.layer[0][3])  # of the first component, the brightness
    if image.mode == "CMYK" or steps is None:
        return ""
    means = simplejpeg.decode_jpeg(
        without_notes(content),
        "GRAY",
        min_height=1,
        min_width=1,
        min_factor=_BLOCK_PX,
        strict=False,
    )[..., 0]
    if _has_clipped_blocks(grey, means, steps):
        return "some of its blocks have levels far outside of 0..255"
    if (row := _seam_row(grey, 1 + 2 * steps[0] / _BLOCK_PX)) is not None:
        return f"the brightness of its blocks changes all along row {row}"
    return ""


def _has_clipped_blocks(grey: _Grey, stored_means: _Grey, steps: list[int]) -> bool:
    """Whether the mean of any block differs much from the one that is stored for it.

    A decoder clips levels below 0 and above 255, which moves the mean of their block.
    """
    rows, columns = (size // _BLOCK_PX for size in grey.shape)
    if not rows or not columns:
        return False
    whole = grey[: rows * _BLOCK_PX, : columns * _BLOCK_PX]
    means = cv2.resize(whole, (columns, rows), interpolation=cv2.INTER_AREA).astype(np.int16)
    clipped = means - stored_means[:rows, :columns]  # above 0 at black, below 0 at white
    allowed = _CLIPPED + _CLIPPED_PER_STEP * float(np.mean(steps))
    deringing = min(_DERINGING, _DERINGING_PER_STEP * steps[0]) + _DERINGING_MARGIN
    return bool(clipped.max() > allowed or -clipped.min() > max(allowed, deringing))


def _seam_row(grey: _Grey, least: float) -> int | None:
    """Row in which the blocks behind a hole begin to be of another brightness, or None.

    The first row of blocks that a hole is in steps up or down against the row above it from the
    hole on, and the next row against this one before that column: a staircase of one step on the
    grid of blocks, which hardly any picture has by itself.

    Args:
        grey: Picture (H, W).
        least: Levels that a step is higher than; blocks of a smooth area differ by one or two
            steps of quantisation.
    """
    height, width = grey.shape
    ends = np.arange(_BLOCK_PX, height - 1, _BLOCK_PX)
    splits = np.arange(_SEAM_MARGIN_PX, width - _SEAM_MARGIN_PX + 1, _BLOCK_PX)
    if len(ends) < 3 or not len(splits):
        return None
    over, above, below, under = (grey[ends + at].astype(np.int16) for at in (-2, -1, 0, 1))
    twice = 2 * (below - above) - (under - below + above - over)  # less the slope on both sides
    signs = np.sign(twice) * (np.abs(twice) > 2 * least)
    sums = np.cumsum(signs, axis=1, dtype=np.int32)
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
