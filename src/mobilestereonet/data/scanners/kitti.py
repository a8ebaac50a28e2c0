"""KITTI 2012, KITTI 2015 and Virtual KITTI 2."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import ClassVar

from mobilestereonet.data.calibration import read_calibration
from mobilestereonet.data.disparity_files import read_disparity_png, read_levels
from mobilestereonet.data.encoded_disparities import read_depth_as_disparity
from mobilestereonet.data.images import FloatMap, Mask
from mobilestereonet.data.sample import Calibration
from mobilestereonet.data.scanners.base import Frame, StereoDataSet, occlusion_from_right_view
from mobilestereonet.data.scanners.registry import register_data_set
from mobilestereonet.errors import InputError


class _Kitti(StereoDataSet):
    """Base of KITTI 2012 and 2015: folders beside one another, one file per frame in each."""

    withheld = frozenset({"testing"})
    left_folder: str
    right_folder: str
    truth_folder: str
    visible_truth_folder: str
    calibration_folder: str
    cameras: tuple[int, int] = (2, 3)

    def patterns(self) -> Sequence[str]:
        """Globs of the left views: each frame's first time step, the one with ground truth."""
        folder = "testing" if self.split == "testing" else "training"
        return [f"{folder}/{self.left_folder}/{'[0-9]' * 6}_10.png"]

    def frame(self, left: Path) -> Frame:
        """Paths of the files of the same name in the folders beside the left view's."""
        folders = left.parents[1]
        return Frame(
            name=left.stem,
            left=left,
            right=folders / self.right_folder / left.name,
            disparity=folders / self.truth_folder / left.name,
        )

    def read_disparity(self, truth: Path) -> tuple[FloatMap, Mask]:
        """Read the laser's sparse disparity, occluded pixels included (``disp_occ``)."""
        return read_disparity_png(truth)

    def read_occluded(self, truth: Path, disparity: FloatMap, valid: Mask) -> Mask | None:
        """Read the mask of pixels with ground truth in ``disp_occ`` but not in ``disp_noc``."""
        visible = truth.parents[1] / self.visible_truth_folder / truth.name
        return ~read_disparity_png(visible)[1] if visible.is_file() else None

    def read_calibration(self, left: Path) -> Calibration | None:
        """Read the frame's calibration, if that archive was unpacked too."""
        path = left.parents[1] / self.calibration_folder / f"{left.stem[:6]}.txt"
        return read_calibration(path, self.cameras) if path.is_file() else None


@register_data_set("kitti2012")
class KITTI2012(_Kitti):
    """KITTI 2012: 194 street scenes with the laser's ground truth, 195 without.

    ::

        root
        ├── training
        │   ├── colored_0/000000_10.png   left (grey cameras: image_0)
        │   ├── colored_1/000000_10.png   right (image_1)
        │   ├── disp_occ/000000_10.png    ground truth, uint16 / 256, 0 = unknown
        │   ├── disp_noc/000000_10.png    the same without occluded pixels (optional)
        │   └── calib/000000.txt          P0 to P3 (optional)
        └── testing
            ├── colored_0, colored_1, image_0, image_1
            └── calib

    Args:
        split: ``training`` or ``testing``; the latter has no ground truth.
        grey: If True, the views of the grey cameras instead of the colour cameras.

    The other arguments and the errors are those of `StereoDataSet`.
    """

    splits: ClassVar = {"training": 194, "testing": 195}
    truth_folder = "disp_occ"
    visible_truth_folder = "disp_noc"
    calibration_folder = "calib"

    def __init__(
        self,
        root: str | Path,
        split: str | None = None,
        *,
        grey: bool = False,
        strict: bool = False,
    ) -> None:
        self.left_folder, self.right_folder = (
            ("image_0", "image_1") if grey else ("colored_0", "colored_1")
        )
        self.cameras = (0, 1) if grey else (2, 3)
        super().__init__(root, split, strict=strict)


@register_data_set("kitti2015")
class KITTI2015(_Kitti):
    """KITTI 2015: 200 street scenes with ground truth of laser and car models, 200 without.

    ::

        root
        ├── training
        │   ├── image_2/000000_10.png       left
        │   ├── image_3/000000_10.png       right
        │   ├── disp_occ_0/000000_10.png    ground truth, uint16 / 256, 0 = unknown
        │   ├── disp_noc_0/000000_10.png    the same without occluded pixels (optional)
        │   ├── obj_map/000000_10.png       foreground objects, 0 = background (optional)
        │   └── calib_cam_to_cam/000000.txt (optional)
        └── testing
            ├── image_2, image_3
            └── calib_cam_to_cam

    ``train`` and ``val`` are the paper's parts of ``training``, 160 and 40 frames.

    Args:
        split: ``training``, ``train``, ``val`` or ``testing``; the last has no ground truth.

    The other arguments and the errors are those of `StereoDataSet`.
    """

    splits: ClassVar = {"training": 200, "train": 160, "val": 40, "testing": 200}
    left_folder = "image_2"
    right_folder = "image_3"
    truth_folder = "disp_occ_0"
    visible_truth_folder = "disp_noc_0"
    calibration_folder = "calib_cam_to_cam"
    # The validation frames of the paper's authors.
    # fmt: off
    validation: ClassVar = frozenset({
        2, 6, 8, 9, 10, 13, 17, 18, 23, 25, 33, 43, 45, 57, 59, 66, 67, 73, 74, 78, 87, 90, 110,
        119, 120, 123, 132, 133, 137, 144, 147, 150, 158, 159, 160, 163, 169, 171, 182, 198,
    })
    # fmt: on

    def left_views(self) -> list[Path]:
        """Paths of the left views of the archive, or of the paper's part of it."""
        views = super().left_views()
        if self.split not in ("train", "val"):
            return views
        wanted = self.split == "val"
        return [view for view in views if (int(view.name[:6]) in self.validation) == wanted]

    def read_foreground(self, truth: Path) -> Mask | None:
        """Read the mask of pixels that the object map gives to any object."""
        path = truth.parents[1] / "obj_map" / truth.name
        return read_levels(path) > 0 if path.is_file() else None


@register_data_set("vkitti2")
class VirtualKITTI2(StereoDataSet):
    """Virtual KITTI 2: five KITTI drives rendered in ten variations, 21,260 pairs.

    The rgb and the depth archive are unpacked in one folder::

        root
        └── Scene{01,02,06,18,20}
            └── {15-deg-left,...,clone,fog,morning,overcast,rain,sunset}/frames
                ├── rgb/Camera_{0,1}/rgb_00000.jpg
                └── depth/Camera_{0,1}/depth_00000.png   centimetres, uint16

    Disparity comes from depth and the set's fixed geometry, occlusion from the depth of both
    cameras. What lies beyond 655 m, above all the sky, counts as unknown.

    Args:
        variation: One of the ten, such as ``clone``; all if left out.

    The other arguments and the errors are those of `StereoDataSet`.
    """

    splits: ClassVar = {"all": 21260}
    variations: ClassVar = (
        *("15-deg-left", "15-deg-right", "30-deg-left", "30-deg-right", "clone"),
        *("fog", "morning", "overcast", "rain", "sunset"),
    )
    calibration: ClassVar = Calibration(focal=725.0087, baseline=0.532725, cx=620.5, cy=187.0)

    def __init__(
        self,
        root: str | Path,
        split: str | None = None,
        *,
        variation: str | None = None,
        strict: bool = False,
    ) -> None:
        if variation is not None and variation not in self.variations:
            names = ", ".join(self.variations)
            raise InputError(f"VirtualKITTI2: variation must be one of {names}, got {variation!r}")
        self.variation = variation
        super().__init__(root, split, strict=strict)

    def official_count(self) -> int | None:
        """Number of frames of the complete set or of one variation."""
        return self.splits["all"] if self.variation is None else 2126

    def patterns(self) -> Sequence[str]:
        """Globs of the left camera's images."""
        return [f"Scene[0-9][0-9]/{self.variation or '*'}/frames/rgb/Camera_0/rgb_*.jpg"]

    def frame(self, left: Path) -> Frame:
        """Paths of the right camera's image and of the left camera's depth."""
        scene, variation = left.relative_to(self.root).parts[:2]
        number = left.stem.removeprefix("rgb_")
        return Frame(
            name=f"{scene}/{variation}/{number}",
            left=left,
            right=left.parents[1] / "Camera_1" / left.name,
            disparity=left.parents[2] / "depth" / "Camera_0" / f"depth_{number}.png",
        )

    def read_disparity(self, truth: Path) -> tuple[FloatMap, Mask]:
        """Read dense disparity, unknown in the sky."""
        return read_depth_as_disparity(truth, self.calibration, levels_per_metre=100)

    def read_occluded(self, truth: Path, disparity: FloatMap, valid: Mask) -> Mask | None:
        """Compute occlusion, if the right camera's depth is there too."""
        right = truth.parents[1] / "Camera_1" / truth.name
        if not right.is_file():
            return None
        return occlusion_from_right_view(disparity, valid, *self.read_disparity(right))

    def read_calibration(self, left: Path) -> Calibration:
        """Calibration of all frames."""
        return self.calibration
