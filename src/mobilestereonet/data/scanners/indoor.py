"""Indoor scenes measured by structured light or space-time stereo: InStereo2K and Booster."""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar

from mobilestereonet.data.disparity_files import read_disparity_npy, read_disparity_png
from mobilestereonet.data.images import FloatMap, Mask
from mobilestereonet.data.scanners.patterns import PatternDataSet
from mobilestereonet.data.scanners.registry import register_data_set


@register_data_set("instereo2k")
class InStereo2K(PatternDataSet):
    """InStereo2K: 2,050 pairs of rooms with ground truth of structured light.

    ::

        root
        ├── train/part1/000000         (or without the parts)
        │   ├── left.png, right.png
        │   ├── left_disp.png      uint16 / 100, 0 = unknown
        │   └── right_disp.png     the same of the right view (optional, for occlusion)
        └── test/000040/...

    Source: the README of YuhuaXu/StereoDataset. The arguments and the errors are those of
    `StereoDataSet`.

    Args:
        split: ``train`` or ``test``; both have ground truth.
    """

    splits: ClassVar = {"train": 2000, "test": 50}
    left, right = "{split}/**/left.png", "{split}/**/right.png"
    disparity, right_disparity = "{split}/**/left_disp.png", "{split}/**/right_disp.png"

    def read_disparity(self, truth: Path) -> tuple[FloatMap, Mask]:
        """Read disparity in 1/100 px."""
        return read_disparity_png(truth, 100.0)


@register_data_set("booster")
class Booster(PatternDataSet):
    """Booster: 64 rooms with transparent and mirroring things, 12 megapixels, several lights each.

    The balanced pairs, whose cameras are alike::

        root
        ├── train/balanced/Bathroom
        │   ├── camera_00/im0.png ...    left, a picture per lighting
        │   ├── camera_02/im0.png ...    right
        │   ├── disp_00.npy              disparity in px, 0 = unknown
        │   └── disp_02.npy              the same of the right view (optional, for occlusion)
        └── test/balanced/...

    Source: Zama Ramirez et al., CVPR 2022; the layout was not compared with the release. The
    arguments and the errors are those of `StereoDataSet`.

    Args:
        split: ``train`` or ``test``; the latter has no ground truth.
    """

    splits: ClassVar = {"train": 228, "test": 191}
    withheld = frozenset({"test"})
    left = "{split}/balanced/*/camera_00/im*.png"
    right = "{split}/balanced/*/camera_02/im*.png"
    disparity = "{split}/balanced/*/disp_00.npy"
    right_disparity = "{split}/balanced/*/disp_02.npy"

    def read_disparity(self, truth: Path) -> tuple[FloatMap, Mask]:
        """Read disparity of a scene, one for all its lightings."""
        return read_disparity_npy(truth)
