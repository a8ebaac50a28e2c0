"""DrivingStereo."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import ClassVar

from mobilestereonet.data.disparity_files import read_disparity_png
from mobilestereonet.data.images import FloatMap, Mask
from mobilestereonet.data.scanners.base import Frame, StereoDataSet
from mobilestereonet.data.scanners.registry import register_data_set
from mobilestereonet.errors import InputError


@register_data_set("drivingstereo")
class DrivingStereo(StereoDataSet):
    """DrivingStereo: street scenes of a whole year with a laser's ground truth.

    ::

        root
        ├── train-left-image/2018-07-09-16-11-56/*.jpg        half size only
        ├── train-right-image/2018-07-09-16-11-56/*.jpg
        ├── train-disparity-map/2018-07-09-16-11-56/*.png     uint16 / 256, 0 = unknown
        ├── test-left-image/left-image-{half,full}-size/[sequence]/*.jpg
        ├── test-right-image/right-image-{half,full}-size/[sequence]/*.jpg
        ├── test-disparity-map/disparity-map-{half,full}-size/[sequence]/*.png
        └── {sunny,cloudy,foggy,rainy}
            ├── left-image-{half,full}-size/*.jpg
            ├── right-image-{half,full}-size/*.jpg
            └── disparity-map-{half,full}-size/*.png          full size: uint16 / 128

    Args:
        split: ``train``, ``test``, or a weather: ``sunny``, ``cloudy``, ``foggy``, ``rainy``.
        size: ``half`` (881 x 400) or ``full`` (1762 x 800, not for ``train``).

    The other arguments and the errors are those of `StereoDataSet`.
    """

    splits: ClassVar = {
        "train": 174437,
        "test": 7751,
        "sunny": 500,
        "cloudy": 500,
        "foggy": 500,
        "rainy": 500,
    }
    _scales: ClassVar = {"half": 256.0, "full": 128.0}

    def __init__(
        self,
        root: str | Path,
        split: str | None = None,
        *,
        size: str = "half",
        strict: bool = False,
    ) -> None:
        if size not in self._scales:
            raise InputError(f"DrivingStereo: size must be half or full, got {size!r}")
        if size == "full" and split in (None, "train"):
            raise InputError("DrivingStereo: the train split comes in half size only")
        self.size = size
        super().__init__(root, split, strict=strict)

    def patterns(self) -> Sequence[str]:
        """Globs of the left views of the split and size, in folders per sequence or without."""
        if self.split == "train":
            return ["train-left-image/**/*.jpg"]
        parent = "test-left-image" if self.split == "test" else self.split
        return [f"{parent}/left-image-{self.size}-size/**/*.jpg"]

    def frame(self, left: Path) -> Frame:
        """Paths of the files of the same name in the right-image and disparity-map folders."""
        relative = left.relative_to(self.root).as_posix()
        truth = self.root / relative.replace("left-image", "disparity-map")
        return Frame(
            name=f"{self.split}/{left.stem}",
            left=left,
            right=self.root / relative.replace("left-image", "right-image"),
            disparity=truth.with_suffix(".png"),
        )

    def read_disparity(self, truth: Path) -> tuple[FloatMap, Mask]:
        """Read the laser's sparse disparity."""
        return read_disparity_png(truth, self._scales[self.size])
