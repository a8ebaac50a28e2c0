"""Stereo pairs from files, arrays, tensors or PIL images: read, checked and converted once."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import torch
from numpy.typing import NDArray
from PIL.Image import Image as PILImage
from torch import Tensor

from mobilestereonet.data.image_files import read_frames, read_image_file, upright
from mobilestereonet.data.images import Picture, image_to_tensor, to_picture, white_level
from mobilestereonet.data.sample import Calibration
from mobilestereonet.errors import InputError
from mobilestereonet.inference.finding import Finding

LAYOUTS = ("side-by-side", "top-bottom")
"""How both views may lie in one picture."""

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
        findings: What was put right while the views were read.
        layout: How both views lay in the one picture that was split into them, one of `LAYOUTS`;
            empty if two pictures were given.
        calibration: Geometry of the views, if a rig tells it.
    """

    left: Tensor
    right: Tensor
    left_image: Picture
    right_image: Picture
    findings: tuple[Finding, ...] = ()
    layout: str = ""
    calibration: Calibration | None = None

    @property
    def height(self) -> int:
        """Height of both views in px."""
        return self.left.shape[-2]

    @property
    def width(self) -> int:
        """Width of both views in px."""
        return self.left.shape[-1]


def load_pair(
    left: ImageLike, right: ImageLike | None = None, *, layout: str | None = None
) -> StereoPair:
    """Read and check a pair.

    Args:
        left: Left view, one of: the path of an image; an array (H, W) or (H, W, 1|3|4) in RGB
            order; a tensor (1|3|4, H, W), also with a batch dimension of 1; a PIL image of any
            mode that has a colour or grey meaning. uint8 is divided by 255 and uint16 by 65535,
            or by what `white_level` finds for both views; floating point must lie in 0..1. An
            alpha channel is dropped. Files and PIL images are turned as their EXIF asks.
        right: Right view, likewise. Without it ``left`` has both views: an MPO, or one picture
            with both.
        layout: How both views lie in one picture, one of `LAYOUTS`; by default side by side.

    Returns:
        The pair; its findings say what was put right.

    Raises:
        FileNotFoundError: If a file does not exist.
        InputError: If there is no such layout, a view is no image, has another shape or type, is
            smaller than 2 x 2, has values that are NaN or out of range, or if the sizes differ.
    """
    _check_layout(layout)
    if right is None:
        return _load_joined(left, layout)
    names = [
        str(view) if isinstance(view, str | Path) else f"{side} view"
        for view, side in ((left, "left"), (right, "right"))
    ]
    views = [_read(view, name) for view, name in zip((left, right), names, strict=True)]
    white = _white_level(views)
    (left, left_image), (right, right_image) = (_convert(view, white) for view in views)
    if left.shape != right.shape:
        sizes = [f"{view.shape[-1]}x{view.shape[-2]}" for view in (left, right)]
        raise InputError(
            f"the two views must have one size (width x height): {names[0]} has {sizes[0]}, "
            f"{names[1]} has {sizes[1]}"
        )
    return StereoPair(left, right, left_image, right_image, tuple(_put_right(views, white)))


def _load_joined(both: ImageLike, layout: str | None) -> StereoPair:
    """Read a pair from one file or picture."""
    if isinstance(both, str | Path):
        frames = read_frames(both)
        if len(frames) > 1:
            return load_pair(frames[0], frames[1])
    view = _read(both, str(both) if isinstance(both, str | Path) else "the picture")
    levels = view.levels
    rows = levels.ndim - 2 if isinstance(levels, Tensor) else 0
    height, width = levels.shape[rows : rows + 2] if levels.ndim > 1 else (0, 0)
    found = layout_of((width, height), layout, view.name)
    axis = rows if found == "top-bottom" else rows + 1
    left, right = levels.chunk(2, axis) if isinstance(levels, Tensor) else np.split(levels, 2, axis)
    pair = load_pair(left, right)
    findings = (*_put_right([view], 65535), *pair.findings)
    return replace(pair, findings=findings, layout=found)


def _check_layout(layout: str | None) -> None:
    if layout is not None and layout not in LAYOUTS:
        raise InputError(f"layout is one of {', '.join(LAYOUTS)}; got {layout!r}")


def layout_of(size: tuple[int, int], layout: str | None, name: str) -> str:
    """How one picture of a width and height is split into both views, one of `LAYOUTS`.

    Args:
        size: Width and height in px.
        layout: How the user says; by default side by side.
        name: What messages call the picture.

    Raises:
        InputError: If there is no such layout, or the side that is halved is odd.
    """
    _check_layout(layout)
    layout = layout or "side-by-side"
    stacked = layout == "top-bottom"
    side, other = size[::-1] if stacked else size
    if side % 2 or not side:
        text, need = f"{side} px wide", "side by side need an even width"
        hint = "--layout top-bottom says that one is above the other"
        if stacked:
            text, need = f"{side} px high", "one above the other need an even height"
            hint = "--layout side-by-side says that they are beside each other"
        or_so = "" if other % 2 else f"; {hint}"
        raise InputError(
            f"{name} is {text}, and two views {need}: give the right view, too, if this is the "
            f"left one{or_so}"
        )
    return layout


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


@dataclass(frozen=True)
class _View:
    """A view as it was given: its levels, what messages call it, and how it was turned."""

    levels: Tensor | NDArray[Any]
    name: str
    turned: str = ""


def _read(view: ImageLike, name: str) -> _View:
    if isinstance(view, str | Path):
        content = read_image_file(view)  # its errors name the file
        return _View(content.pixels, name, content.turned)
    try:
        if isinstance(view, Tensor):
            return _View(_one_view(view), name)
        if isinstance(view, PILImage):
            image, turned = upright(view)
            return _View(_from_pil(image), name, turned)
    except InputError as error:
        raise InputError(f"{name}: {error}") from None
    if not hasattr(view, "__array__"):
        raise InputError(
            f"{name}: an image is a path, an array, a tensor or a PIL image, got "
            f"{type(view).__name__}"
        )
    levels = np.asarray(view)
    return _View(levels.astype(levels.dtype.newbyteorder("="), copy=False), name)


def _white_level(views: Sequence[_View]) -> int:
    levels = (view.levels for view in views)
    return white_level(
        *(
            each.cpu().numpy() if isinstance(each, Tensor) else each
            for each in levels
            if str(each.dtype).endswith("uint16")
        )
    )


def _put_right(views: Sequence[_View], white: int) -> list[Finding]:
    """What `load_pair` has changed, for the user to know."""
    findings = []
    turned = [f"{view.name} is {view.turned}" for view in views if view.turned]
    if turned:
        text = f"{' and '.join(turned)}, as the file asks (EXIF)"
        advice = "a calibration of the pixels as they are stored does not fit"
        findings.append(Finding("orientation", "fixed", text, advice))
    if white < 65535:
        bits = white.bit_length()
        text = f"the 16-bit views use {bits} bits: {white} is taken for white in both"
        findings.append(Finding("levels", "fixed", text))
    return findings


def _convert(view: _View, white: int) -> tuple[Tensor, Picture]:
    """A view as (3, H, W) float32 and as (H, W, 3) uint8."""
    levels = view.levels
    try:
        tensor = (
            _scale(levels, white) if isinstance(levels, Tensor) else image_to_tensor(levels, white)
        )
    except InputError as error:
        raise InputError(f"{view.name}: {error}") from None
    if min(tensor.shape[-2:]) < 2:
        size = f"{tensor.shape[-1]}x{tensor.shape[-2]}"
        raise InputError(f"{view.name}: an image needs at least 2x2 pixels, got {size}")
    if isinstance(levels, Tensor) or levels.dtype != np.uint8:
        return tensor, to_picture(tensor)
    rgb = np.atleast_3d(levels)[..., :3]
    # The caller's array may change later: a copy.
    return tensor, np.array(np.broadcast_to(rgb, (*rgb.shape[:2], 3)), order="C")


def _one_view(view: Tensor) -> Tensor:
    if view.ndim == 4 and len(view) == 1:
        view = view[0]
    if view.ndim != 3 or view.shape[0] not in (1, 3, 4) or not view.numel():
        many = ": several pairs go to StereoMatcher.batch or infer" if view.ndim == 4 else ""
        raise InputError(f"a tensor needs shape (3, H, W), got {tuple(view.shape)}{many}")
    return view.detach()[:3]


def _scale(view: Tensor, white: int) -> Tensor:
    if view.dtype in (torch.uint8, torch.uint16):
        view = view.float() / (255 if view.dtype == torch.uint8 else white)
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
    try:
        return np.asarray(image.convert("RGB"))
    except ValueError as error:  # LAB
        raise InputError(f"a PIL image of mode {mode}: {error}; convert it to RGB") from None
