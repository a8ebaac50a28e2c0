"""What every source gives: stereo frames, one after the other."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from torch import Tensor

from mobilestereonet.data.sample import Calibration
from mobilestereonet.errors import InputError
from mobilestereonet.inference.prepare import load_pair
from mobilestereonet.plots import Picture


@dataclass(frozen=True)
class StereoFrame:
    """One moment of a stream.

    Attributes:
        index: Its number, from 0. A gap is a frame that a live capture passed over.
        name: What to call it in reports and file names; may hold slashes.
        seconds: When it is shown.
        views: Left and right view, each (3, H, W) float32 in 0..1; None if they cannot be read.
        problem: Why not; empty if they can.
        calibration: Geometry of the pair, if the source knows it.
    """

    index: int
    name: str
    seconds: float
    views: tuple[Tensor, Tensor] | None
    problem: str = ""
    calibration: Calibration | None = None


@dataclass(frozen=True)
class Stream:
    """A source of frames.

    Attributes:
        frames: The frames; they can be gone through once.
        total: How many there are; None if that is not known.
        live: Whether they come from a camera, so that they are other ones the next time.
    """

    frames: Iterable[StereoFrame]
    total: int | None
    live: bool = False


def make_frame(index: int, seconds: float, pictures: Sequence[Picture | None]) -> StereoFrame:
    """A frame of the pictures that one or two cameras took at a moment.

    Args:
        index: Its number.
        seconds: When it is shown.
        pictures: Both views, (H, W, 3) uint8 RGB, or one picture with both side by side; None
            where it cannot be read.

    Raises:
        InputError: If the views differ in size, or a side-by-side picture has an odd width.
    """
    name = f"{index:06d}"
    views = [picture for picture in pictures if picture is not None]
    if len(views) < len(pictures):
        return StereoFrame(index, name, seconds, None, "the picture is damaged")
    left, right = views if len(views) == 2 else split_views(views[0])
    return StereoFrame(index, name, seconds, load_pair(left, right))


def split_views(picture: Picture) -> tuple[Picture, Picture]:
    """Left and right view of a side-by-side picture.

    Raises:
        InputError: If its width is odd.
    """
    width = picture.shape[1]
    check_even(width)
    return picture[:, : width // 2], picture[:, width // 2 :]


def check_even(width: int, name: str = "this video") -> None:
    """Refuse a width that has no middle.

    Raises:
        InputError: If the width is odd.
    """
    if width % 2:
        raise InputError(
            f"{name} is {width} px wide, and two views side by side need an even width: give the "
            "right camera's video, too, if this is the left one's"
        )
