"""How the views lie in what was given, and what puts them right: turned, mirrored, swapped."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np
import torch
from torch import Tensor

from mobilestereonet.data.images import Picture
from mobilestereonet.data.sample import Calibration
from mobilestereonet.errors import InputError
from mobilestereonet.inference.features import Matches, Points
from mobilestereonet.inference.pair import StereoPair, layout_of


@dataclass(frozen=True)
class Turn:
    """What is done to one view: mirrored first, then turned.

    Attributes:
        degrees: Clockwise, a multiple of 90.
        mirrored: Whether left and right change places.
    """

    degrees: int = 0
    mirrored: bool = False

    def __bool__(self) -> bool:
        return bool(self.degrees or self.mirrored)

    @property
    def undone(self) -> str:
        """What it puts right, in words."""
        words = ["mirrored"] if self.mirrored else []
        if self.degrees:
            words.append("upside down" if self.degrees == 180 else "on its side")
        return " and ".join(words)

    def view(self, view: Tensor) -> Tensor:
        """Turn a view (3, H, W)."""
        view = view.flip(-1) if self.mirrored else view
        return torch.rot90(view, -self.degrees // 90, (-2, -1))

    def picture(self, picture: Picture) -> Picture:
        """Turn a picture (H, W, 3)."""
        picture = picture[:, ::-1] if self.mirrored else picture
        return np.ascontiguousarray(np.rot90(picture, -self.degrees // 90))

    def points(self, points: Points, size: tuple[int, int]) -> Points:
        """Places (N, 2) in a view of a width and height, once it is turned."""
        width, height = size
        x, y = points.T
        x = width - 1 - x if self.mirrored else x
        for _ in range(self.degrees // 90 % 4):
            x, y = height - 1 - y, x
            width, height = height, width
        return np.stack((x, y), axis=1)


@dataclass(frozen=True)
class Arrangement:
    """What is done to a pair before it is matched.

    Attributes:
        top_bottom: One picture has the left view above the right one, not beside it.
        left: What is done to the left view.
        right: What is done to the right view.
        swapped: Whether the views change places, after that.
    """

    top_bottom: bool = False
    left: Turn = field(default_factory=Turn)
    right: Turn = field(default_factory=Turn)
    swapped: bool = False

    def __call__(self, pair: StereoPair) -> StereoPair:
        """The pair, put right, with its calibration.

        Raises:
            InputError: If a picture with one view above the other has an odd height, or a
                calibration cannot follow.
        """
        if self == AS_GIVEN:
            return pair
        left, right = pair.left, pair.right
        pictures = pair.left_image, pair.right_image
        layout = pair.layout
        if self.top_bottom and layout == "side-by-side":
            layout = layout_of((2 * pair.width, pair.height), "top-bottom", "the picture")
            left, right = torch.cat((left, right), dim=-1).chunk(2, dim=-2)
            halves = np.array_split(np.concatenate(pictures, axis=1), 2)
            pictures = halves[0], halves[1]
        width, height = left.shape[-1], left.shape[-2]
        views = [
            (turn.view(view).contiguous(), turn.picture(picture))
            for turn, view, picture in zip(
                (self.left, self.right), (left, right), pictures, strict=True
            )
        ]
        (left, left_image), (right, right_image) = views[::-1] if self.swapped else views
        calibration = pair.calibration and self.calibration(pair.calibration, (width, height))
        return replace(
            pair,
            left=left,
            right=right,
            left_image=left_image,
            right_image=right_image,
            layout=layout,
            calibration=calibration,
        )

    def calibration(self, given: Calibration, size: tuple[int, int]) -> Calibration:
        """Calibration of the views once they are put right.

        Args:
            given: Calibration of the views as they came.
            size: Their width and height.

        Raises:
            InputError: If a view is turned by 90 degrees: the calibration is of cameras side by
                side.
        """
        if self.left.degrees % 180 or self.right.degrees % 180:
            raise InputError(
                "the calibration is of the views as they came, and does not fit once they are "
                "turned by 90 degrees: give --rotate 0, or the calibration of the turned views"
            )
        column, row = given.principal_point(*size)
        places = np.array([[column, row]]), np.array([[column + given.doffs, row]])
        turned = self.left.points(places[0], size), self.right.points(places[1], size)
        left, right = turned[::-1] if self.swapped else turned
        return replace(
            given,
            doffs=float(right[0, 0] - left[0, 0]),
            cx=None if given.cx is None else float(left[0, 0]),
            cy=None if given.cy is None else float(left[0, 1]),
        )

    def points(self, seen: Matches, size: tuple[int, int]) -> tuple[Points, Points]:
        """Places of matches in the left and the right view, once they are put right."""
        places = self.left.points(seen.left, size), self.right.points(seen.right, size)
        return places[::-1] if self.swapped else places


AS_GIVEN = Arrangement()
"""The left view first, upright."""


def find_turns(
    seen: Matches, mirrored: bool, size: tuple[int, int], lowest: float = 0.0
) -> Arrangement:
    """The turns that bring both views into one direction, cameras side by side, left one first.

    Args:
        seen: What both views show.
        mirrored: Whether one view is mirrored against the other.
        size: Width and height of the views.
        lowest: Disparity in px below which nothing is in front of the cameras.

    Returns:
        The turns; none where nothing is to be turned, or turning would not help.
    """
    candidates = list(_candidates(seen, mirrored, size))
    if not candidates:
        return AS_GIVEN
    return max(candidates, key=lambda turns: _share_in_front(turns, seen, size, lowest))


def _candidates(seen: Matches, mirrored: bool, size: tuple[int, int]) -> Iterator[Arrangement]:
    """Turns of which one is right, if any is."""
    if seen.turn % 180 and size[0] != size[1]:
        return  # a view that lies on its side, and has been cut or scaled to the other's size
    if mirrored or seen.turn:
        back = -seen.turn % 360
        yield Arrangement(right=Turn(back, mirrored))
        # A mirror reverses the direction of a turn.
        yield Arrangement(left=Turn(back if mirrored else seen.turn, mirrored))
    elif above_each_other(*(seen.left - seen.right).T):
        for degrees in (90, 270):
            yield Arrangement(left=Turn(degrees), right=Turn(degrees))


def _share_in_front(
    turns: Arrangement, seen: Matches, size: tuple[int, int], lowest: float
) -> float:
    left, right = turns.points(seen, size)
    return float(np.mean(left[:, 0] - right[:, 0] > lowest))


def above_each_other(disparity: Points, vertical: Points) -> bool:
    """Whether the vertical disparity, not the horizontal one, depends on the depth."""
    differ = float(np.median(np.abs(vertical - np.median(vertical)))) > 0.5
    horizontal = float(np.percentile(np.abs(disparity), 95))
    return differ and float(np.median(np.abs(vertical))) > 4 * horizontal


def is_swapped(disparity: Points) -> bool:
    """Whether most features move to the right, seen from the left view.

    Args:
        disparity: Above the lowest one that there is: 0 px but for cameras that converge.
    """
    negative, positive = float(np.mean(disparity < -1)), float(np.mean(disparity > 1))
    return negative > max(0.3, 4 * positive)
