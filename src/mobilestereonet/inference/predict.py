"""Prediction for a batch of views of any size: preprocess, pad or tile, match, refine, check.

Everything happens on the engine's device.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, Literal, TypeAlias

import torch
import torch.nn.functional as F
from numpy.typing import NDArray
from torch import Tensor

from mobilestereonet.data.images import pad, unpad
from mobilestereonet.engines.base import Engine
from mobilestereonet.engines.scaled import ScaledEngine
from mobilestereonet.engines.threads import use_threads
from mobilestereonet.errors import InputError
from mobilestereonet.inference.consistency import occluded_pixels
from mobilestereonet.inference.pair import StereoPair
from mobilestereonet.inference.refine import refine_disparity
from mobilestereonet.inference.subpixel import fit_subpixel
from mobilestereonet.inference.tiling import (
    CONTEXT_PX,
    MAX_UNTILED_PIXELS,
    TILE_SIZE,
    match_in_tiles,
)
from mobilestereonet.nets.model import Prediction

HeightWidth: TypeAlias = tuple[int, int]
"""Height and width in px."""

Tile: TypeAlias = HeightWidth | Literal["auto"] | None
"""Size of tiles; None for none, "auto" for `TILE_SIZE` above `MAX_UNTILED_PIXELS`."""


def predict_disparity(
    engine: Engine,
    left: Tensor,
    right: Tensor,
    *,
    padding: HeightWidth | None,
    tile: Tile,
    refine: bool,
    confidence: bool,
) -> Prediction:
    """Match a batch of pairs of any size.

    Args:
        engine: The engine.
        left: Left views, (B, 3, H, W) float32, RGB in 0..1, on the engine's device.
        right: Right views, likewise.
        padding: Size to which views are padded with zeros; None repeats their border up to the
            next size that the engine takes.
        tile: Size of the tiles.
        refine: Refine the disparity, see `refine_disparity` and `fit_subpixel`; the engine must
            have a confidence.
        confidence: Predict the confidence as well, where the engine has one.

    Returns:
        Disparity in px and, if asked for, confidence in 0..1, (B, H, W) float32 each, on the
        engine's device.

    Raises:
        InputError: If the views are larger than ``padding``, or the tiles too small for their
            margins.
    """

    def match(left: Tensor, right: Tensor) -> Tensor:
        return _match_padded(engine, left, right, padding, confidence or refine)

    height, width = left.shape[-2:]
    scale = engine.scale if isinstance(engine, ScaledEngine) else 1.0
    if tile == "auto":
        large = padding is None and height * width * scale**2 > MAX_UNTILED_PIXELS
        tile = TILE_SIZE if large else None
    if tile is None:
        maps = match(left, right)
    else:
        maps = match_in_tiles(
            match,
            left,
            right,
            tile=tile,
            max_disparity=engine.max_disparity,
            multiple=engine.size_multiple,
            context=round(CONTEXT_PX / scale),
        )
    disparity, *more = maps
    if refine:
        with use_threads(engine.threads):
            disparity = refine_disparity(disparity, more[0], left, right)
            disparity = fit_subpixel(disparity, left, right)
    return Prediction(disparity, more[0] if confidence and more else None)


def shifted(view: Tensor, shift: int) -> Tensor:
    """Views moved to the right by some pixels (to the left if negative), their border repeated.

    Raises:
        InputError: If nothing of them is left.
    """
    width = view.shape[-1]
    if abs(shift) >= width:
        raise InputError(f"a shift of {shift} px moves views of {width} px width out of sight")
    left, right = max(shift, 0), max(-shift, 0)
    return F.pad(view[..., right : width - left], (left, right, 0, 0), mode="replicate")


def match_pairs(
    predict: Callable[[Tensor, Tensor, bool], Prediction],
    pairs: Sequence[StereoPair],
    device: torch.device,
    *,
    confidence: bool,
    left_right: bool,
) -> dict[str, NDArray[Any]]:
    """Match pairs of one size: to the device, through the engine, and back as arrays once.

    Args:
        predict: Matches batches of views, with or without a confidence.
        pairs: The pairs.
        device: Device of the engine.
        confidence: Predict the confidence.
        left_right: Match the mirrored pairs as well, and check the one against the other.

    Returns:
        Maps (B, H, W) by the names that `StereoResult` has for them.
    """
    with torch.inference_mode():
        left = torch.stack([pair.left.to(device) for pair in pairs])
        right = torch.stack([pair.right.to(device) for pair in pairs])
        disparity, sure = predict(left, right, confidence)
        maps = {"disparity": disparity}
        if sure is not None:
            maps["confidence"] = sure
        if left_right:
            # Mirrored, and in each other's place.
            mirrored = predict(right.flip(-1), left.flip(-1), False).disparity.flip(-1)
            maps["right_disparity"] = mirrored
            maps["occluded"] = occluded_pixels(disparity, mirrored)
    return {name: map_.cpu().contiguous().numpy() for name, map_ in maps.items()}


def _match_padded(
    engine: Engine, left: Tensor, right: Tensor, padding: HeightWidth | None, confidence: bool
) -> Tensor:
    """Preprocess, pad, match, unpad: (1 or 2, B, H, W), disparity and confidence."""
    height, width = left.shape[-2:]
    padded = _padded_size(height, width, padding, engine)
    left, right = (
        pad(engine.preprocessing(view), *padded, zeros=padding is not None)
        for view in (left, right)
    )
    prediction = engine(left, right, confidence)
    maps = torch.stack([map_ for map_ in prediction if map_ is not None])
    return unpad(maps, height, width)


def _padded_size(
    height: int, width: int, padding: HeightWidth | None, engine: Engine
) -> HeightWidth:
    if padding is None:
        multiple, least = engine.size_multiple, engine.min_side
        height, width = (math.ceil(max(side, least) / multiple) for side in (height, width))
        return height * multiple, width * multiple
    if height > padding[0] or width > padding[1]:
        raise InputError(
            f"views of {height} x {width} (height x width) are larger than the padding to "
            f"{padding[0]} x {padding[1]}"
        )
    return padding
