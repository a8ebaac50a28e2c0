"""Images and maps in memory: array types, and conversions between arrays and tensors."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
import torch.nn.functional as F
from numpy.typing import NDArray
from torch import Tensor

from mobilestereonet.errors import InputError

Array = NDArray[Any]
Picture = NDArray[np.uint8]
"""RGB image, (H, W, 3) uint8."""

FloatMap = NDArray[np.float32]
"""Map of one number per pixel, (H, W) float32: disparity, depth or confidence."""

Mask = NDArray[np.bool_]
"""Map of one truth value per pixel, (H, W) bool."""


CAMERA_BITS = (8, 10, 12, 14)
"""Bits per level of cameras whose pictures are often stored as 16 bits without being scaled."""


def white_level(*views: Array) -> int:
    """Level that stands for white in 16-bit views of one scene.

    It is 65535, but where all levels lie below a quarter of that the largest one of a camera with
    the bits that they need: 4095 for the 12 bits of many machine-vision cameras.

    Args:
        views: Images of one scene, of any type and shape.
    """
    deep = [view for view in views if view.dtype == np.uint16 and view.size]
    peak = max((int(view.max()) for view in deep), default=65535)
    return next((2**bits - 1 for bits in CAMERA_BITS if peak < 2**bits), 65535)


def image_to_tensor(image: Array, white: int = 65535) -> Tensor:
    """Convert an image array to a float tensor in 0..1.

    Args:
        image: RGB or grey image of shape (H, W), (H, W, 1), (H, W, 3) or (H, W, 4), the last
            with an alpha channel that is dropped. uint8 is divided by 255 and uint16 by ``white``;
            floating point values must lie in 0..1 already.
        white: Level of white in uint16, see `white_level`.

    Returns:
        Float32 tensor of shape (3, H, W) in 0..1 with memory of its own.

    Raises:
        InputError: If the shape or the dtype is another one, or a value is NaN or outside 0..1.
    """
    if image.ndim == 2:
        image = image[..., None]
    if image.ndim != 3 or image.shape[2] not in (1, 3, 4) or 0 in image.shape:
        raise InputError(f"an image needs shape (H, W), (H, W, 1|3|4), got {image.shape}")
    planes = np.array(image[..., :3].transpose(2, 0, 1), order="C")
    if planes.dtype == np.uint8:
        tensor = torch.from_numpy(planes).float().div_(255)
    elif planes.dtype == np.uint16:
        tensor = torch.from_numpy(planes.astype(np.float32)).div_(white)
    elif np.issubdtype(planes.dtype, np.floating):
        low, high = planes.min(), planes.max()
        if not (low >= 0 and high <= 1):  # also False where a value is NaN
            raise InputError(
                f"a floating point image needs values in 0..1, got {low:.6g} to {high:.6g}: "
                "scale it, or pass uint8 or uint16"
            )
        tensor = torch.from_numpy(planes.astype(np.float32, copy=False))
    else:
        raise InputError(f"an image needs uint8, uint16 or floating point, got {planes.dtype}")
    return tensor.expand(3, -1, -1).contiguous()


def to_picture(view: Tensor) -> Picture:
    """Convert a view to an 8-bit RGB array.

    Args:
        view: (3, H, W) in 0..1; values outside are clipped.

    Returns:
        (H, W, 3) uint8.
    """
    scaled = (view.detach().cpu().float().clamp(0, 1) * 255).round().to(torch.uint8)
    return np.ascontiguousarray(scaled.permute(1, 2, 0).numpy())


def cover_and_crop(view: Tensor, size: tuple[int, int]) -> Tensor:
    """Scale a view until it covers a size, then crop its middle.

    Args:
        view: (3, H, W) in 0..1.
        size: Height and width of the result.

    Returns:
        (1, 3, height, width) in 0..1.
    """
    height, width = view.shape[-2:]
    scale = max(size[0] / height, size[1] / width)
    scaled = (max(round(scale * height), size[0]), max(round(scale * width), size[1]))
    top, left = ((have - want) // 2 for have, want in zip(scaled, size, strict=True))
    view = F.interpolate(view[None], scaled, mode="bilinear", antialias=True)
    return view[..., top : top + size[0], left : left + size[1]].clamp(0, 1).contiguous()


def pad(view: Tensor, height: int, width: int, *, zeros: bool = False) -> Tensor:
    """Pad above and on the right, where the authors' evaluation pads, too.

    Columns without a partner at the left border stay at the border, as in training.

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
