"""Middlebury 2003, 2005 and 2006: ground truth in grey levels."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import ClassVar

from mobilestereonet.data.disparity_files import read_disparity_png
from mobilestereonet.data.image_files import decode_image
from mobilestereonet.data.images import FloatMap, Mask
from mobilestereonet.data.scanners.base import Frame, StereoDataSet, occlusion_from_right_view
from mobilestereonet.data.scanners.registry import register_data_set
from mobilestereonet.errors import InputError


class _GreyLevelScenes(StereoDataSet):
    """Base of Middlebury 2003, 2005 and 2006: 8-bit maps, scaled by the archive's size.

    The levels are disparities at full size in every archive, so the scale is how many times
    smaller the images are.
    """

    left_name = "view1.png"
    right_name = "view5.png"
    left_truth = "disp1.png"
    right_truth = "disp5.png"
    full_height = 1110
    reductions: ClassVar = (3, 2, 1)

    def __init__(
        self,
        root: str | Path,
        split: str | None = None,
        *,
        scale: float | None = None,
        strict: bool = False,
    ) -> None:
        self.scale = scale
        super().__init__(root, split, strict=strict)

    def patterns(self) -> Sequence[str]:
        """Globs of the left views, one folder per scene."""
        return [f"*/{self.left_name}"]

    def frame(self, left: Path) -> Frame:
        """Paths of the other files in the scene's folder."""
        return Frame(
            name=left.parent.name,
            left=left,
            right=left.with_name(self.right_name),
            disparity=left.with_name(self.left_truth),
        )

    def read_disparity(self, truth: Path) -> tuple[FloatMap, Mask]:
        """Read disparity from grey levels, 0 = unknown."""
        scale = self.scale
        if scale is None:
            height = decode_image(truth).shape[0]
            scale = next((n for n in self.reductions if height == self.full_height // n), None)
            if scale is None:
                sizes = ", ".join(str(self.full_height // n) for n in self.reductions)
                raise InputError(
                    f"{truth}: {height} rows, the official sizes have {sizes}: "
                    "tell the levels per pixel of disparity by scale=..."
                )
        return read_disparity_png(truth, scale, bits=8)

    def read_occluded(self, truth: Path, disparity: FloatMap, valid: Mask) -> Mask | None:
        """Compute occlusion, if the right view's ground truth is there too."""
        right = truth.with_name(self.right_truth)
        if not right.is_file():
            return None
        return occlusion_from_right_view(disparity, valid, *self.read_disparity(right))


@register_data_set("middlebury2003")
class Middlebury2003(_GreyLevelScenes):
    """Middlebury 2003: the scenes cones and teddy.

    ::

        root
        └── {cones,teddy}
            ├── im2.png     left
            ├── im6.png     right
            ├── disp2.png   ground truth, uint8 / scale, 0 = unknown
            └── disp6.png   ground truth of the right view (optional, for occlusion)

    Args:
        scale: Grey levels per pixel of disparity. If left out it follows from the height: 4 for
            the quarter size (450x375), 2 for the half, 1 for the full size.

    The other arguments and the errors are those of `StereoDataSet`.
    """

    splits: ClassVar = {"training": 2}
    left_name = "im2.png"
    right_name = "im6.png"
    left_truth = "disp2.png"
    right_truth = "disp6.png"
    full_height = 1500
    reductions = (4, 2, 1)


@register_data_set("middlebury2005")
class Middlebury2005(_GreyLevelScenes):
    """Middlebury 2005: nine scenes, six of them with public ground truth.

    ::

        root
        └── {Art,Books,Dolls,Laundry,Moebius,Reindeer}   (Computer, Drumsticks, Dwarves)
            ├── view1.png   left
            ├── view5.png   right
            ├── disp1.png   ground truth, uint8 / scale, 0 = unknown
            └── disp5.png   ground truth of the right view (optional, for occlusion)

    Samples have no calibration: the views were cropped by an offset (``dmin.txt``), and whether
    the reduced sizes state it in their own pixels is not known to us.

    Args:
        split: ``training``, or ``test`` for the three scenes without ground truth.
        scale: Grey levels per pixel of disparity. If left out it follows from the height: 3 for
            the third size (370 rows), 2 for the half, 1 for the full size.

    The other arguments and the errors are those of `StereoDataSet`.
    """

    splits: ClassVar = {"training": 6, "test": 3}
    withheld = frozenset({"test"})
    without_truth: ClassVar = ("Computer", "Drumsticks", "Dwarves")

    def left_views(self) -> list[Path]:
        """Paths of the left views with, or without, public ground truth."""
        wanted = self.split == "test"
        views = super().left_views()
        return [view for view in views if (view.parent.name in self.without_truth) == wanted]


@register_data_set("middlebury2006")
class Middlebury2006(_GreyLevelScenes):
    """Middlebury 2006: 21 scenes, with the files of 2005.

    ::

        root
        └── {Aloe,Baby1,...,Wood2}
            ├── view1.png   left
            ├── view5.png   right
            ├── disp1.png   ground truth, uint8 / scale, 0 = unknown
            └── disp5.png   ground truth of the right view (optional, for occlusion)

    Args:
        scale: As for `Middlebury2005`.

    The other arguments and the errors are those of `StereoDataSet`.
    """

    splits: ClassVar = {"training": 21}
