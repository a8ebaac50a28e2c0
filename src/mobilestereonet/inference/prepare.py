"""From what a user has to what an engine takes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import torch.nn.functional as F
from numpy.typing import NDArray
from torch import Tensor

from mobilestereonet.data.files import read_image
from mobilestereonet.data.images import image_to_tensor
from mobilestereonet.errors import InputError

View = str | Path | NDArray[Any] | Tensor
"""One image of a pair: a file, an array or a tensor; `load_pair` says which ones."""


def load_pair(left: View, right: View) -> tuple[Tensor, Tensor]:
    """Read and check a pair.

    Args:
        left: Left view: the path of an image; an array (H, W) or (H, W, 1|3|4) in RGB order; or
            a tensor (1|3|4, H, W), also with a batch dimension of 1. uint8 is divided by 255 and
            uint16 by 65535; floating point must lie in 0..1. An alpha channel is dropped.
        right: Right view, likewise.

    Returns:
        Left and right view, each (3, H, W) float32 in 0..1.

    Raises:
        FileNotFoundError: If a file does not exist.
        InputError: If a view is no image, has another shape or type, is smaller than 2 x 2, has
            values that are NaN or out of range, or if the sizes differ.
    """
    names = [
        str(view) if isinstance(view, str | Path) else f"{side} view"
        for view, side in ((left, "left"), (right, "right"))
    ]
    views = [_load(view, name) for view, name in zip((left, right), names, strict=True)]
    if views[0].shape != views[1].shape:
        sizes = [f"{view.shape[-1]}x{view.shape[-2]}" for view in views]
        raise InputError(
            f"the two views must have one size (width x height): {names[0]} has {sizes[0]}, "
            f"{names[1]} has {sizes[1]}"
        )
    return views[0], views[1]


def _load(view: View, name: str) -> Tensor:
    if isinstance(view, str | Path):
        array = read_image(view)
    elif isinstance(view, Tensor):
        array = _channels_last(view, name)
    else:
        array = np.asarray(view)
    try:
        tensor = image_to_tensor(array)
    except InputError as error:
        raise InputError(f"{name}: {error}") from None
    if min(tensor.shape[-2:]) < 2:
        size = f"{tensor.shape[-1]}x{tensor.shape[-2]}"
        raise InputError(f"{name}: an image needs at least 2x2 pixels, got {size}")
    return tensor


def _channels_last(view: Tensor, name: str) -> NDArray[Any]:
    if view.ndim == 4 and len(view) == 1:
        view = view[0]
    if view.ndim != 3 or view.shape[0] not in (1, 3, 4):
        raise InputError(
            f"{name}: a tensor needs shape (3, H, W), got {tuple(view.shape)}; several pairs go "
            "to StereoMatcher.batch"
        )
    view = view.detach().cpu()
    if view.is_floating_point():
        view = view.float()  # NumPy has no bfloat16
    array: NDArray[Any] = view.permute(1, 2, 0).numpy()
    return array


def pad(view: Tensor, height: int, width: int, *, zeros: bool = False) -> Tensor:
    """Pad above and on the right, where the authors' evaluation pads, too.

    What was columns without a partner at the left border stays that: there is nothing further
    left to match with, as in training.

    Args:
        view: (B, C, H, W).
        height: Height to reach.
        width: Width to reach.
        zeros: True pads with zeros, as the authors do: the mean colour once a view is normalised.
            False repeats the border's pixels, which disturbs what is beside them less.

    Returns:
        (B, C, height, width).
    """
    around = (0, width - view.shape[-1], height - view.shape[-2], 0)
    return F.pad(view, around, mode="constant" if zeros else "replicate")


def unpad(map_: Tensor, height: int, width: int) -> Tensor:
    """Undo `pad`: (..., padded height, padded width) -> (..., height, width)."""
    return map_[..., map_.shape[-2] - height :, :width]
