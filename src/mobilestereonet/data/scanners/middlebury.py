"""Middlebury 2014, 2021 and MiddEval3, and ETH3D, which follows them: PFM and calib.txt."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import ClassVar

from mobilestereonet.data.calibration import read_calibration
from mobilestereonet.data.disparity_files import read_disparity_pfm, read_levels
from mobilestereonet.data.images import FloatMap, Mask
from mobilestereonet.data.sample import Calibration
from mobilestereonet.data.scanners.base import Frame, StereoDataSet, occlusion_from_right_view
from mobilestereonet.data.scanners.registry import register_data_set
from mobilestereonet.errors import InputError


class _CalibratedScenes(StereoDataSet):
    """Base of Middlebury 2014, 2021, MiddEval3 and ETH3D: folder per scene, PFM, calib.txt."""

    right_name: str = "im1.png"
    truth_name: ClassVar[str] = "disp0.pfm"

    def frame(self, left: Path) -> Frame:
        """Paths of the other files in the scene's folder."""
        return Frame(
            name=left.parent.name,
            left=left,
            right=left.with_name(self.right_name),
            disparity=left.with_name(self.truth_name),
        )

    def read_disparity(self, truth: Path) -> tuple[FloatMap, Mask]:
        """Read disparity, unknown where infinite."""
        return read_disparity_pfm(truth)

    def read_occluded(self, truth: Path, disparity: FloatMap, valid: Mask) -> Mask | None:
        """Read occlusion from the set's mask or, without one, from the right ground truth."""
        mask, right = truth.with_name("mask0nocc.png"), truth.with_name("disp1.pfm")
        if mask.is_file():  # 255: seen by both views, 128: by the left one only, 0: unknown
            occluded: Mask = read_levels(mask) != 255
            return occluded
        if right.is_file():
            return occlusion_from_right_view(disparity, valid, *read_disparity_pfm(right))
        return None

    def read_calibration(self, left: Path) -> Calibration | None:
        """Read the scene's calib.txt, if it is there."""
        path = left.with_name("calib.txt")
        return read_calibration(path) if path.is_file() else None


@register_data_set("middlebury2014")
class Middlebury2014(_CalibratedScenes):
    """Middlebury 2014: 23 indoor scenes of 6 megapixels with public ground truth.

    ::

        root
        └── {Adirondack,...,Vintage}-{perfect,imperfect}
            ├── im0.png     left
            ├── im1.png     right (im1E.png: other exposure, im1L.png: other lighting)
            ├── disp0.pfm   ground truth, inf = unknown
            ├── disp1.pfm   ground truth of the right view (optional, for occlusion)
            └── calib.txt   (optional)

    Args:
        rectification: ``perfect`` or ``imperfect`` (with a vertical error as in practice).
        right: ``im1``, ``im1E`` or ``im1L``.

    The other arguments and the errors are those of `StereoDataSet`.
    """

    splits: ClassVar = {"training": 23}

    def __init__(
        self,
        root: str | Path,
        split: str | None = None,
        *,
        rectification: str = "perfect",
        right: str = "im1",
        strict: bool = False,
    ) -> None:
        if rectification not in ("perfect", "imperfect"):
            raise InputError(
                f"Middlebury2014: rectification must be perfect or imperfect, got {rectification!r}"
            )
        if right not in ("im1", "im1E", "im1L"):
            raise InputError(f"Middlebury2014: right must be im1, im1E or im1L, got {right!r}")
        self.rectification = rectification
        self.right_name = f"{right}.png"
        super().__init__(root, split, strict=strict)

    def patterns(self) -> Sequence[str]:
        """Globs of the left views, one folder per scene and rectification."""
        return [f"*-{self.rectification}/im0.png"]


@register_data_set("middlebury2021")
class Middlebury2021(_CalibratedScenes):
    """Middlebury 2021: 24 indoor scenes taken with a mobile phone on a robot arm.

    ::

        root
        └── {artroom1,...,traproom2}   (in the archive below a folder data)
            ├── im0.png     left
            ├── im1.png     right
            ├── disp0.pfm   ground truth, inf = unknown
            ├── disp1.pfm   ground truth of the right view (optional, for occlusion)
            └── calib.txt   (optional)

    The other arguments and the errors are those of `StereoDataSet`.
    """

    splits: ClassVar = {"training": 24}

    def patterns(self) -> Sequence[str]:
        """Globs of the left views, one folder per scene."""
        return ["*/im0.png", "data/*/im0.png"]


@register_data_set("middeval3")
class MiddEval3(_CalibratedScenes):
    """Middlebury's third evaluation: 15 training scenes, 15 test scenes, in three sizes.

    ::

        root                           (or the folder MiddEval3 of the archive below it)
        ├── training{Q,H,F}
        │   └── {Adirondack,...,Vintage}
        │       ├── im0.png, im1.png
        │       ├── disp0GT.pfm        ground truth, inf = unknown
        │       ├── mask0nocc.png      255 seen by both, 128 occluded, 0 unknown (optional)
        │       └── calib.txt          (optional)
        └── test{Q,H,F}
            └── {Australia,...,Staircase}
                └── im0.png, im1.png, calib.txt

    Args:
        split: ``training`` or ``test``; the latter has no ground truth.
        size: ``Q``, ``H`` or ``F``: quarter, half or full.

    The other arguments and the errors are those of `StereoDataSet`.
    """

    splits: ClassVar = {"training": 15, "test": 15}
    withheld = frozenset({"test"})
    truth_name = "disp0GT.pfm"

    def __init__(
        self,
        root: str | Path,
        split: str | None = None,
        *,
        size: str = "Q",
        strict: bool = False,
    ) -> None:
        if size not in ("Q", "H", "F"):
            raise InputError(f"MiddEval3: size must be Q, H or F, got {size!r}")
        self.size = size
        super().__init__(root, split, strict=strict)

    def patterns(self) -> Sequence[str]:
        """Globs of the left views, one folder per scene, below one per split and size."""
        inner = f"{self.split}{self.size}/*/im0.png"
        return [inner, f"MiddEval3/{inner}"]


@register_data_set("eth3d")
class ETH3D(_CalibratedScenes):
    """ETH3D two-view: 27 grey pairs with the laser's ground truth, 20 without.

    ::

        root
        ├── two_view_training
        │   └── {delivery_area_1l,...}
        │       ├── im0.png, im1.png
        │       └── calib.txt          (optional)
        ├── two_view_training_gt
        │   └── {delivery_area_1l,...}
        │       ├── disp0GT.pfm        ground truth, inf = unknown
        │       └── mask0nocc.png      255 seen by both, 128 occluded, 0 unknown (optional)
        └── two_view_test
            └── {lakeside_1l,...}
                └── im0.png, im1.png, calib.txt

    Args:
        split: ``training`` or ``test``; the latter has no ground truth.

    The other arguments and the errors are those of `StereoDataSet`.
    """

    splits: ClassVar = {"training": 27, "test": 20}
    withheld = frozenset({"test"})
    truth_name = "disp0GT.pfm"

    def patterns(self) -> Sequence[str]:
        """Globs of the left views, one folder per scene."""
        return [f"two_view_{self.split}/*/im0.png"]

    def frame(self, left: Path) -> Frame:
        """Paths of the right view, beside the left one, and of the ground truth's folder."""
        name = left.parent.name
        return Frame(
            name=name,
            left=left,
            right=left.with_name(self.right_name),
            disparity=self.root / "two_view_training_gt" / name / self.truth_name,
        )
