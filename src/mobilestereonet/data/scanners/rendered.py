"""Rendered data sets that present networks are trained on."""

from __future__ import annotations

from pathlib import Path
from typing import Any, ClassVar

from mobilestereonet.data.disparity_files import read_disparity_npy, read_disparity_png
from mobilestereonet.data.encoded_disparities import (
    read_depth_as_disparity,
    read_disparity_exr,
    read_disparity_fsd,
    read_disparity_hdf5,
)
from mobilestereonet.data.images import FloatMap, Mask
from mobilestereonet.data.sample import Calibration
from mobilestereonet.data.scanners.patterns import PatternDataSet
from mobilestereonet.data.scanners.registry import register_data_set
from mobilestereonet.errors import InputError
from mobilestereonet.text import read_json


@register_data_set("crestereo")
class CREStereo(PatternDataSet):
    """CREStereo's training set: rendered objects, holes, trees and reflections.

    ::

        root
        └── {tree,shapenet,reflective,hole}/...
            ├── 0001_left.jpg
            ├── 0001_right.jpg
            ├── 0001_left.disp.png      uint16 / 32, 0 = unknown
            └── 0001_right.disp.png     (optional, for occlusion)

    Source: the README of megvii-research/CREStereo (format), torchvision's documentation of its
    class ``CREStereo`` (layout). The arguments and the errors are those of `StereoDataSet`.
    """

    splits: ClassVar = {"all": None}
    left, right = "**/*_left.jpg", "**/*_right.jpg"
    disparity, right_disparity = "**/*_left.disp.png", "**/*_right.disp.png"

    def read_disparity(self, truth: Path) -> tuple[FloatMap, Mask]:
        """Read dense disparity in 1/32 px."""
        return read_disparity_png(truth, 32.0)


@register_data_set("fallingthings")
class FallingThings(PatternDataSet):
    """Falling Things: household objects that fall through rooms and parks, 61,500 pairs.

    ::

        root
        └── fat
            ├── single/002_master_chef_can_16k/kitchen_0
            │   ├── 000000.left.jpg, 000000.right.jpg
            │   ├── 000000.left.depth.png        uint16, 0.1 mm
            │   ├── 000000.right.depth.png       (optional, for occlusion)
            │   └── _camera_settings.json        focal length and principal point, in px
            └── mixed/kitchen_0/...

    The cameras are 6 cm apart. Depth ends at 6.5534 m: what is farther counts as unknown.

    Source: Tremblay et al., CVPR Workshops 2018; the layout is that of torchvision's
    documentation of ``FallingThingsStereo``, and was not compared with the release. The arguments
    and the errors are those of `StereoDataSet`.

    Args:
        split: ``all``, ``single`` (one object falls) or ``mixed`` (2 to 10).
    """

    splits: ClassVar = {"all": 61500, "single": None, "mixed": None}
    split_texts: ClassVar = {"all": "", "single": "single/", "mixed": "mixed/"}
    archive = "fat"
    left, right = "{split}**/*.left.jpg", "{split}**/*.right.jpg"
    disparity, right_disparity = "{split}**/*.left.depth.png", "{split}**/*.right.depth.png"

    BASELINE_M: ClassVar[float] = 0.06
    LEVELS_PER_METRE: ClassVar[float] = 10_000.0

    def read_disparity(self, truth: Path) -> tuple[FloatMap, Mask]:
        """Read depth, which the folder's camera settings turn into disparity."""
        return read_depth_as_disparity(truth, self.read_calibration(truth), self.LEVELS_PER_METRE)

    def read_calibration(self, left: Path) -> Calibration:
        """Read the camera settings beside a file."""
        path = left.with_name("_camera_settings.json")
        record: Any = read_json(path)
        try:
            values = record["camera_settings"][0]["intrinsic_settings"]
            focal, cx, cy = (float(values[name]) for name in ("fx", "cx", "cy"))
        except (KeyError, IndexError, TypeError, ValueError):
            raise InputError(
                f"{path}: no camera settings of Falling Things: it lacks camera_settings with "
                "intrinsic_settings fx, cx and cy"
            ) from None
        return Calibration(focal=focal, baseline=self.BASELINE_M, cx=cx, cy=cy)


@register_data_set("tartanair")
class TartanAir(PatternDataSet):
    """TartanAir: flights through rendered places in all weathers, 640 x 480.

    ::

        root
        └── abandonedfactory/{Easy,Hard}/P001
            ├── image_left/000000_left.png
            ├── image_right/000000_right.png
            ├── depth_left/000000_left_depth.npy      float, metres
            └── depth_right/000000_right_depth.npy    (optional, for occlusion)

    Source: ``data_type.md`` of castacks/tartanair_tools: a focal length of 320 px and cameras
    0.25 m apart, so that disparity is 80 over depth. The arguments and the errors are those of
    `StereoDataSet`.
    """

    splits: ClassVar = {"all": None}
    left, right = "**/image_left/*_left.png", "**/image_right/*_right.png"
    disparity = "**/depth_left/*_left_depth.npy"
    right_disparity = "**/depth_right/*_right_depth.npy"
    calibration: ClassVar = Calibration(focal=320.0, baseline=0.25, cx=320.0, cy=240.0)

    def read_disparity(self, truth: Path) -> tuple[FloatMap, Mask]:
        """Read depth, which the set's fixed geometry turns into disparity."""
        return read_depth_as_disparity(truth, self.calibration)

    def read_calibration(self, left: Path) -> Calibration:
        """Calibration of all frames."""
        return self.calibration


@register_data_set("irs")
class IRS(PatternDataSet):
    """IRS: rendered homes, offices, restaurants and stores, 103,316 pairs.

    ::

        root
        └── IRSDataset
            └── {Home,Office,Restaurant,Store}/SCLRestaurant001_NightFall
                ├── l_377.png       left
                ├── r_377.png       right
                └── d_377.exr       disparity in px

    Disparity needs OpenEXR (the extra ``data``). A few maps of the release have another size than
    their views (its issue 3): they are refused when they are read.

    Source: README and issues of blackjack2015/IRS. The arguments and the errors are those of
    `StereoDataSet`.
    """

    splits: ClassVar = {"all": 103316}
    archive = "IRSDataset"
    left, right, disparity = "*/*/l_*.png", "*/*/r_*.png", "*/*/d_*.exr"

    def read_disparity(self, truth: Path) -> tuple[FloatMap, Mask]:
        """Read dense disparity."""
        return read_disparity_exr(truth)


@register_data_set("spring")
class Spring(PatternDataSet):
    """Spring: 47 sequences of an animated film in Full HD, 5,000 pairs with ground truth.

    ::

        root
        └── spring
            ├── train/0001
            │   ├── frame_left/frame_left_0001.png
            │   ├── frame_right/frame_right_0001.png
            │   ├── disp1_left/disp1_left_0001.dsp5      HDF5, array "disparity"
            │   ├── disp1_right/disp1_right_0001.dsp5    (optional, for occlusion)
            │   └── cam_data/intrinsics.txt              fx fy cx cy, a line per frame (optional)
            └── test/0003/{frame_left,frame_right}

    The ground truth has twice the height and width of the views (3840 x 2160), in pixels of the
    views: every second row and column is read. It needs h5py (the extra ``data``). The cameras are
    6.5 cm apart.

    Source: Mehl et al., CVPR 2023; the layout was not compared with the release. The
    arguments and the errors are those of `StereoDataSet`.

    Args:
        split: ``train`` or ``test``; the latter has no ground truth.
    """

    splits: ClassVar = {"train": 5000, "test": 1000}
    withheld = frozenset({"test"})
    archive = "spring"
    left = "{split}/*/frame_left/frame_left_*.png"
    right = "{split}/*/frame_right/frame_right_*.png"
    disparity = "{split}/*/disp1_left/disp1_left_*.dsp5"
    right_disparity = "{split}/*/disp1_right/disp1_right_*.dsp5"

    BASELINE_M: ClassVar[float] = 0.065

    def read_disparity(self, truth: Path) -> tuple[FloatMap, Mask]:
        """Read dense disparity at the pixels of the views."""
        return read_disparity_hdf5(truth, step=2)

    def read_calibration(self, left: Path) -> Calibration | None:
        """Read the frame's line of the sequence's intrinsics, if they were unpacked too."""
        path = left.parents[1] / "cam_data" / "intrinsics.txt"
        if not path.is_file():
            return None
        lines = [line for line in path.read_text().splitlines() if line.strip()]
        number = int(left.stem.rpartition("_")[2])
        try:
            focal, _, cx, cy = map(float, lines[number - 1].split())
        except (IndexError, ValueError):
            raise InputError(
                f"{path}: line {number} must hold fx, fy, cx and cy of {left.name}"
            ) from None
        return Calibration(focal=focal, baseline=self.BASELINE_M, cx=cx, cy=cy)


@register_data_set("unrealstereo4k")
class UnrealStereo4K(PatternDataSet):
    """UnrealStereo4K: rendered rooms and streets at 3840 x 2160.

    ::

        root
        └── 00000
            ├── Image0/00000.png     left
            ├── Image1/00000.png     right
            ├── Disp0/00000.npy      disparity in px
            └── Disp1/00000.npy      the same of the right view (optional, for occlusion)

    Source: Tosi et al. (SMD-Nets), CVPR 2021, and README and issues of fabiotosi92/SMD-Nets. The
    arguments and the errors are those of `StereoDataSet`.
    """

    splits: ClassVar = {"all": None}
    left, right = "**/Image0/*.[jp][pn]g", "**/Image1/*.[jp][pn]g"
    disparity, right_disparity = "**/Disp0/*.npy", "**/Disp1/*.npy"

    def read_disparity(self, truth: Path) -> tuple[FloatMap, Mask]:
        """Read dense disparity."""
        return read_disparity_npy(truth)


@register_data_set("fsd")
class FSD(PatternDataSet):
    """FoundationStereo's training set (FSD): rendered rooms, streets and flying objects.

    ::

        root
        └── manipulation_v5_realistic_kitchen_2500_1/dataset/data
            ├── left
            │   ├── rgb/0000.jpg
            │   └── disparity/0000.png      (255**2 R + 255 G + B) / 1000 px
            └── right/rgb/0000.jpg

    The release has no calibrations (its issue 62).

    Source: readme and issues of NVlabs/FoundationStereo; the encoding in words: the card of
    ``nvidia/ffs_stereo4d`` on the Hugging Face hub. The arguments and the errors are those of
    `StereoDataSet`.
    """

    splits: ClassVar = {"all": None}
    left, right = "**/left/rgb/*.[jp][pn]g", "**/right/rgb/*.[jp][pn]g"
    disparity = "**/left/disparity/*.png"

    def read_disparity(self, truth: Path) -> tuple[FloatMap, Mask]:
        """Read dense disparity, packed in colours."""
        return read_disparity_fsd(truth)
