"""Tiled matching of large pairs: overlapping tiles, blended.

A tile is one window cut out of both views. Left pixels find their partners up to the maximum
disparity further left, so the leftmost columns of a tile that begins inside of the image lack
them: its left margin is wider by that much. All tiles lie on the grid of the engine's downsampling
and search the same disparities, so a tile gives what the whole pair would give, but for what the
network sees farther away than the margins.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import torch
from torch import Tensor

from mobilestereonet.errors import InputError

CONTEXT_PX = 160
"""Margin of a tile that is matched but not used.

``benchmarks/tiling.py`` measures what a border changes, by the distance from it. With the embedded
msnet2d nothing changes 160 px and more away (on the left: 160 px and the maximum disparity), but
for single pixels whose two best matches are equally likely.
"""

BLEND_PX = 64
"""Width of the band beyond ``CONTEXT_PX`` in which one tile fades into the next."""

MAX_UNTILED_PIXELS = 1920 * 1088
"""Pixels of the largest pair (Full HD) that is matched in one piece by default."""

TILE_SIZE = (1088, 1920)
"""Height and width of a larger pair's tiles, in px: they need what Full HD needs in one piece."""


def match_in_tiles(
    match: Callable[[Tensor, Tensor], Tensor],
    left: Tensor,
    right: Tensor,
    *,
    tile: tuple[int, int],
    max_disparity: int,
    multiple: int,
    context: int = CONTEXT_PX,
) -> Tensor:
    """Match a batch of pairs tile by tile.

    Args:
        match: Matches views of any size: (B, 3, h, w) twice to maps (..., h, w). It pads them
            above and on the right to multiples of ``multiple``.
        left: Left views, (B, 3, H, W).
        right: Right views, the same.
        tile: Height and width of a tile in px, margins included. All tiles are of this size but
            for those at the upper and the right border, which padding would fill.
        max_disparity: Disparities that the engine searches, in px.
        multiple: Grid of the engine's downsampling, in px.
        context: Margin of a tile that is matched but not used, in px.

    Returns:
        The maps of the left views, (..., H, W).

    Raises:
        InputError: If the tiles are too small for their margins.
    """
    height, width = left.shape[-2:]
    margin = context + math.ceil(max_disparity / multiple) * multiple
    rows = _spans(height, tile[0], context, multiple, "height")
    columns = _spans(width, tile[1], margin, multiple, "width")
    above = rows[-1][1] - height
    total: Tensor | None = None
    weights = left.new_zeros(height, width, dtype=torch.float32)
    for top, bottom in rows:
        row_weights = _weights(top, bottom, rows[-1][1], context)[max(above - top, 0) :]
        vertical = slice(max(top - above, 0), bottom - above)
        for start, end in columns:
            horizontal = slice(start, min(end, width))
            column_weights = _weights(start, end, columns[-1][1], margin)[: width - start]
            weight = (row_weights[:, None] * column_weights).to(left.device)
            window = (..., vertical, horizontal)
            maps = match(left[window], right[window])
            if total is None:
                total = maps.new_zeros(*maps.shape[:-2], height, width)
            total[window] += weight * maps
            weights[window] += weight
    assert total is not None  # there is at least one tile
    return total / weights


def _spans(length: int, tile: int, margin: int, multiple: int, name: str) -> list[tuple[int, int]]:
    """Start and end of tiles of one size that cover ``length``, padded, and overlap by margins."""
    length, tile = math.ceil(length / multiple) * multiple, tile // multiple * multiple
    if length <= tile:
        return [(0, length)]
    overlap = math.ceil((margin + CONTEXT_PX + BLEND_PX) / multiple) * multiple
    if tile <= overlap:
        raise InputError(
            f"tiles of {name} {tile} are too small: the margins need {overlap} px; take at least "
            f"{2 * overlap}"
        )
    count = math.ceil((length - overlap) / (tile - overlap))
    steps = (length - tile) // multiple
    starts = [i * steps // (count - 1) * multiple for i in range(count)]
    return [(start, start + tile) for start in starts]


def _weights(start: int, end: int, length: int, margin: int) -> Tensor:
    """Weights of a tile's rows or columns: 0 in the margins, then smoothly up to 1."""
    place = torch.arange(end - start) + 0.5
    before = (place - margin) / BLEND_PX if start > 0 else torch.ones_like(place)
    after = (
        (end - start - place - CONTEXT_PX) / BLEND_PX if end < length else torch.ones_like(place)
    )
    ramp = torch.minimum(before, after).clamp(0, 1)
    return ramp * ramp * (3 - 2 * ramp)
