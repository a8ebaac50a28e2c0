"""Contact sheets: pictures in rows, with titles on a dark ground that fits light and dark pages."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from mobilestereonet.data.images import Picture

GROUND, TEXT = (38, 50, 56), (236, 239, 241)
GAP_PX, LINE_SPACE_PX = 6, 11


def sheet(
    rows: Sequence[Sequence[Picture]],
    *,
    width: int,
    titles: Sequence[str] = (),
    captions: Sequence[str | Sequence[str]] = (),
    text_px: int = 15,
) -> Picture:
    """Put pictures into rows of one size.

    Args:
        rows: Pictures, as many in each row; all are scaled to the first one's shape.
        width: Width of a picture in the sheet, in px.
        titles: A line above each column.
        captions: A line above each row, or one for each of its columns.
        text_px: Size of the text, in px.
    """
    line = text_px + LINE_SPACE_PX
    height, wide = rows[0][0].shape[:2]
    height = round(height * width / wide)
    top = line if titles else GAP_PX
    pitch = height + (line if captions else GAP_PX)
    first = top + (line if captions else 0)
    bottom = first + len(rows) * pitch - (line - GAP_PX if captions else 0)
    size = (len(rows[0]) * (width + GAP_PX) + GAP_PX, bottom)
    canvas = Image.new("RGB", size, GROUND)
    draw = ImageDraw.Draw(canvas)
    font = ImageFont.load_default(text_px)
    for column, title in enumerate(titles):
        draw.text((GAP_PX + column * (width + GAP_PX) + 2, 4), title, TEXT, font)
    for index, row in enumerate(rows):
        y = first + index * pitch
        if captions:
            caption = captions[index]
            for column, text in enumerate([caption] if isinstance(caption, str) else caption):
                draw.text((GAP_PX + column * (width + GAP_PX) + 2, y - line + 4), text, TEXT, font)
        for column, picture in enumerate(row):
            small = cv2.resize(picture, (width, height), interpolation=cv2.INTER_AREA)
            canvas.paste(Image.fromarray(small), (GAP_PX + column * (width + GAP_PX), y))
    return np.asarray(canvas)


def write(path: Path, picture: Picture) -> None:
    """Write a sheet as a JPEG."""
    Image.fromarray(picture).save(path, quality=84, optimize=True)
