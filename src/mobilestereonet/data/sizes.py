"""Sizes of pictures, width and height in px: what is said where a calibration is of others."""

from __future__ import annotations

import math

from mobilestereonet.errors import InputError

MAX_SCALE_DOUBT = 1.15
"""Factor by which a principal point may say that pictures were resized before it is told."""

MAX_SCALE = 1.4
"""Factor from which on such a calibration is refused."""

_SAME_SCALE = 1.25
"""Largest ratio of the factors of width and height that are those of one resizing."""


def wrong_size(own: tuple[int, int], size: tuple[int, int], what: str) -> InputError:
    """The error that pictures have another size than the calibration's.

    Args:
        own: The calibration's.
        size: That of the pictures.
        what: What has the calibration's size, in words that end before it.
    """
    message = (
        f"{what} {own[0]}x{own[1]}, these have {size[0]}x{size[1]} (width x height): give the "
        "calibration of these views"
    )
    if same_shape(own, size):
        factor = f"{size[0] / own[0]:.6g}"
        message += (
            f"; --resized says that they were only resized, here by {factor}, and in Python "
            f".resized(({size[0]}, {size[1]})) does"
        )
    elif own == size[::-1]:
        message += "; the file's size is height, width: write the width first"
    return InputError(message)


def told_scale(cx: float, cy: float, size: tuple[int, int]) -> float:
    """Factor of the pictures that a principal point is in the middle of, to those of a size.

    Args:
        cx: Column of the principal point in px.
        cy: Its row.
        size: Width and height of the pictures.

    Returns:
        The factor; 1 where width and height do not tell the same.
    """
    factors = 2 * cx / size[0], 2 * cy / size[1]
    if min(factors) <= 0 or max(factors) > _SAME_SCALE * min(factors):
        return 1.0
    return math.sqrt(factors[0] * factors[1])


def check_untold_size(cx: float, cy: float, size: tuple[int, int]) -> str:
    """Check that a calibration that tells no size can be of pictures of one.

    Args:
        cx: Column of its principal point in px.
        cy: Its row.
        size: Width and height of the pictures.

    Returns:
        What is to be told; empty if nothing is.

    Raises:
        InputError: If the principal point says that the pictures have clearly another size.
    """
    factor = told_scale(cx, cy, size)
    distance = max(factor, 1 / factor)
    if distance < MAX_SCALE_DOUBT:
        return ""
    text = (
        f"the principal point ({cx:g}, {cy:g}) is the middle of pictures of about "
        f"{2 * cx:.0f}x{2 * cy:.0f}, these have {size[0]}x{size[1]} (width x height)"
    )
    if distance >= MAX_SCALE:
        raise InputError(
            f"{text}: give the calibration of these views, or write the size that it is of into "
            "the file (width and height; with it --resized helps where they were only resized)"
        )
    return f"{text}: depth is wrong by as much if they were resized after the calibration"


def same_shape(own: tuple[int, int], size: tuple[int, int]) -> bool:
    """Whether one size is the other one resized, up to a pixel."""
    return abs(size[1] - size[0] / own[0] * own[1]) <= 1
