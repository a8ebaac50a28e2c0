"""Stereo pairs from files, arrays, tensors or PIL images: read, checked and converted once."""

from __future__ import annotations

import sys
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from mobilestereonet.data.files import read_image
from mobilestereonet.data.images import Picture, image_to_tensor, to_picture
from mobilestereonet.errors import InputError

if TYPE_CHECKING:
    from PIL.Image import Image as PILImage

ImageLike: TypeAlias = "str | Path | NDArray[Any] | Tensor | PILImage"
"""One image of a pair: a file, an array, a tensor or a PIL image; `load_pair` says which ones."""


@dataclass(frozen=True, eq=False)
class StereoPair:
    """A rectified pair that has passed `load_pair`'s checks.

    Attributes:
        left: Left view, (3, H, W) float32 RGB in 0..1, on the device that it came on.
        right: Right view, likewise.
        left_image: Left view for pictures, (H, W, 3) uint8 RGB.
        right_image: Right view, likewise.
    """

    left: Tensor
    right: Tensor
    left_image: Picture
    right_image: Picture

    @property
    def height(self) -> int:
        """Height of both views in px."""
        return self.left.shape[-2]

    @property
    def width(self) -> int:
        """Width of both views in px."""
        return self.left.shape[-1]


def load_pair(left: ImageLike, right: ImageLike) -> StereoPair:
    """Read and check a pair.

    Args:
        left: Left view, one of: the path of an image; an array (H, W) or (H, W, 1|3|4) in RGB
            order; a tensor (1|3|4, H, W), also with a batch dimension of 1; a PIL image of any
            mode that has a colour or grey meaning. uint8 is divided by 255 and uint16 by 65535;
            floating point must lie in 0..1. An alpha channel is dropped.
        right: Right view, likewise.

    Returns:
        The pair.

    Raises:
        FileNotFoundError: If a file does not exist.
        InputError: If a view is no image, has another shape or type, is smaller than 2 x 2, has
            values that are NaN or out of range, or if the sizes differ.
    """
    names = [
        str(view) if isinstance(view, str | Path) else f"{side} view"
        for view, side in ((left, "left"), (right, "right"))
    ]
    (left, left_image), (right, right_image) = (
        _load(view, name) for view, name in zip((left, right), names, strict=True)
    )
    if left.shape != right.shape:
        sizes = [f"{view.shape[-1]}x{view.shape[-2]}" for view in (left, right)]
        raise InputError(
            f"the two views must have one size (width x height): {names[0]} has {sizes[0]}, "
            f"{names[1]} has {sizes[1]}"
        )
    return StereoPair(left, right, left_image, right_image)


def load_batch(pairs: Iterable[tuple[ImageLike, ImageLike] | StereoPair]) -> list[StereoPair]:
    """Read and check pairs of one size; see `load_pair`.

    Raises:
        FileNotFoundError: If a file does not exist.
        InputError: If one is no pair, a view is not as it should be, or the sizes differ.
    """
    loaded = []
    for pair in pairs:
        if not isinstance(pair, StereoPair):
            if not (isinstance(pair, tuple | list) and len(pair) == 2):
                raise InputError(
                    f"a batch is a list of pairs (left, right), got {type(pair).__name__} in it; "
                    "two tensors (B, 3, H, W) go in as zip(left, right)"
                )
            pair = load_pair(*pair)
        loaded.append(pair)
    sizes = {f"{pair.width}x{pair.height}" for pair in loaded}
    if len(sizes) > 1:
        raise InputError(
            f"a batch needs pairs of one size, got {', '.join(sorted(sizes))}: match them one by "
            "one"
        )
    return loaded


def check_tensors(left: Tensor, right: Tensor) -> None:
    """Check the shapes and types of two batches of views.

    Raises:
        InputError: If they are not of one shape (B, 3, H, W), or not floating point.
    """
    if left.shape != right.shape or left.ndim != 4 or left.shape[1] != 3:
        raise InputError(
            "left and right must both be (B, 3, H, W), "
            f"got {tuple(left.shape)} and {tuple(right.shape)}"
        )
    if not (left.is_floating_point() and right.is_floating_point()):
        raise InputError(
            f"tensors must be floating point in 0..1, got {left.dtype} and {right.dtype}: "
            "divide by the largest value"
        )


def _load(view: ImageLike, name: str) -> tuple[Tensor, Picture]:
    """A view as (3, H, W) float32 and as (H, W, 3) uint8."""
    image = read_image(view) if isinstance(view, str | Path) else None  # its errors name the file
    try:
        if isinstance(view, Tensor):
            tensor, array = _from_tensor(view), None
        else:
            array = image if image is not None else _to_array(view)
            tensor = image_to_tensor(array)
    except InputError as error:
        raise InputError(f"{name}: {error}") from None
    if min(tensor.shape[-2:]) < 2:
        size = f"{tensor.shape[-1]}x{tensor.shape[-2]}"
        raise InputError(f"{name}: an image needs at least 2x2 pixels, got {size}")
    if array is None or array.dtype != np.uint8:
        return tensor, to_picture(tensor)
    rgb = np.atleast_3d(array)[..., :3]
    # The caller's array may change later: a copy.
    return tensor, np.array(np.broadcast_to(rgb, (*rgb.shape[:2], 3)), order="C")


def _from_tensor(view: Tensor) -> Tensor:
    if view.ndim == 4 and len(view) == 1:
        view = view[0]
    if view.ndim != 3 or view.shape[0] not in (1, 3, 4) or not view.numel():
        many = ": several pairs go to StereoMatcher.batch or infer" if view.ndim == 4 else ""
        raise InputError(f"a tensor needs shape (3, H, W), got {tuple(view.shape)}{many}")
    view = view.detach()[:3]
    if view.dtype in (torch.uint8, torch.uint16):
        view = view.float() / (255 if view.dtype == torch.uint8 else 65535)
    elif view.is_floating_point():
        low, high = (float(value) for value in view.aminmax())
        if not (low >= 0 and high <= 1):  # also False where a value is NaN
            raise InputError(
                f"a floating point tensor needs values in 0..1, got {low:.6g} to {high:.6g}: "
                "scale it, or pass uint8 or uint16"
            )
    else:
        raise InputError(f"a tensor needs uint8, uint16 or floating point, got {view.dtype}")
    return view.float().expand(3, -1, -1)


def _to_array(view: Any) -> NDArray[Any]:
    # Who has a PIL image has imported PIL; nobody else needs it.
    pil = sys.modules.get("PIL.Image")
    if pil is not None and isinstance(view, pil.Image):
        return _from_pil(view)
    if not hasattr(view, "__array__"):
        raise InputError(
            f"an image is a path, an array, a tensor or a PIL image, got {type(view).__name__}"
        )
    return np.asarray(view)


# Premultiplied alpha: PIL converts it to grey or colour by way of plain alpha only.
_PLAIN_ALPHA = {"La": "LA", "RGBa": "RGBA"}


def _from_pil(image: PILImage) -> NDArray[Any]:
    """An array with the meaning of the image's mode: a palette's colours, not its indices."""
    mode = image.mode
    if mode == "F":
        return np.asarray(image)
    if mode == "I" or mode.startswith("I;16"):
        levels = np.asarray(image)
        if mode == "I" and levels.size and not (levels.min() >= 0 and levels.max() <= 65535):
            raise InputError(
                f"a PIL image of mode I needs values in 0..65535, got {levels.min()} to "
                f"{levels.max()}"
            )
        return levels.astype(np.uint16)
    if mode in _PLAIN_ALPHA:
        image = image.convert(_PLAIN_ALPHA[mode])
    return np.asarray(image.convert("RGB"))
