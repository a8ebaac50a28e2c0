"""Sizes of pictures, width and height in px: what is said where two differ."""

from __future__ import annotations

from mobilestereonet.errors import InputError


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


def same_shape(own: tuple[int, int], size: tuple[int, int]) -> bool:
    """Whether one size is the other one resized, up to a pixel."""
    return abs(size[1] - size[0] / own[0] * own[1]) <= 1
