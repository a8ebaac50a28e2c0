"""Folders of pairs in any layout, found by patterns."""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar

from mobilestereonet.data.calibration import read_calibration
from mobilestereonet.data.disparity_files import read_disparity
from mobilestereonet.data.images import FloatMap, Mask
from mobilestereonet.data.sample import Calibration
from mobilestereonet.data.scanners.patterns import PatternDataSet, count_wildcards
from mobilestereonet.data.scanners.registry import register_data_set
from mobilestereonet.errors import InputError


@register_data_set("folder")
class PairFolder(PatternDataSet):
    """Pairs in any folder, found by patterns.

    What the wildcards of ``left`` match in a file's path is filled in for the wildcards of
    ``right`` and ``disparity``, in the same order::

        root
        ├── left/0001.png         left="left/*.png"          (the default)
        ├── right/0001.png        right="right/*.png"        (the default)
        └── disparity/0001.pfm    disparity="disparity/*.pfm"

    Args:
        left: Glob of the left views below the root.
        right: Pattern of the right views, with as many wildcards as ``left``.
        disparity: Pattern of the ground truth (``.pfm``, ``.npy`` or grey image); no ground
            truth if left out.
        scale: Grey levels per pixel of disparity, for images; see `read_disparity`.
        calibration: Calibration file of all pairs, below the root or absolute.

    The other arguments and the errors are those of `StereoDataSet`.
    """

    splits: ClassVar = {"all": None}

    def __init__(
        self,
        root: str | Path,
        split: str | None = None,
        *,
        left: str = "left/*.png",
        right: str = "right/*.png",
        disparity: str | None = None,
        scale: float | None = None,
        calibration: str | Path | None = None,
        strict: bool = False,
    ) -> None:
        wildcards = count_wildcards(left)
        for pattern in (right, disparity):
            if pattern is not None and count_wildcards(pattern) != wildcards:
                raise InputError(
                    f"PairFolder: {pattern!r} needs as many wildcards as {left!r}, {wildcards}"
                )
        self.left, self.right, self.disparity = left, right, disparity
        self.scale = scale
        self.calibration = (
            None if calibration is None else read_calibration(Path(root) / calibration)
        )
        super().__init__(root, split, strict=strict)

    def left_views(self) -> list[Path]:
        """Paths that the pattern finds, sorted."""
        try:
            return super().left_views()
        except (NotImplementedError, ValueError) as error:
            raise InputError(f"PairFolder: cannot look for {self.left!r}: {error}") from error

    def truth_advice(self) -> str:
        """Advice to give the option ``disparity``."""
        return (
            "tell where it is by the option disparity, such as "
            '--set "disparity=disparity/*.pfm"; in training, by data_options.disparity and '
            "val_options.disparity"
        )

    def read_disparity(self, truth: Path) -> tuple[FloatMap, Mask]:
        """Read disparity in the format of the file's ending."""
        return read_disparity(truth, self.scale)

    def read_calibration(self, left: Path) -> Calibration | None:
        """Calibration of all pairs."""
        return self.calibration
