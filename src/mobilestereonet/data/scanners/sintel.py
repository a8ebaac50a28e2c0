"""MPI Sintel stereo."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import ClassVar

import numpy as np

from mobilestereonet.data.disparity_files import read_levels
from mobilestereonet.data.encoded_disparities import read_disparity_sintel
from mobilestereonet.data.images import FloatMap, Mask
from mobilestereonet.data.scanners.base import Frame, StereoDataSet
from mobilestereonet.data.scanners.registry import register_data_set
from mobilestereonet.errors import InputError


@register_data_set("sintel")
class Sintel(StereoDataSet):
    """MPI Sintel stereo: 1,064 frames of 23 film scenes.

    ::

        root
        └── training
            ├── {clean,final}_left/alley_1/frame_0001.png
            ├── {clean,final}_right/alley_1/frame_0001.png
            ├── disparities/alley_1/frame_0001.png   4 R + G / 2**6 + B / 2**14
            ├── occlusions/alley_1/frame_0001.png    255 = hidden in the right view (optional)
            └── outofframe/alley_1/frame_0001.png    255 = outside the right view (optional)

    Args:
        render: ``final`` (with motion blur, defocus and haze) or ``clean``.

    The other arguments and the errors are those of `StereoDataSet`.
    """

    splits: ClassVar = {"training": 1064}

    def __init__(
        self,
        root: str | Path,
        split: str | None = None,
        *,
        render: str = "final",
        strict: bool = False,
    ) -> None:
        if render not in ("final", "clean"):
            raise InputError(f"Sintel: render must be final or clean, got {render!r}")
        self.render = render
        super().__init__(root, split, strict=strict)

    def patterns(self) -> Sequence[str]:
        """Globs of the left views, one folder per scene."""
        return [f"training/{self.render}_left/*/frame_*.png"]

    def frame(self, left: Path) -> Frame:
        """Paths of the same scene and name in the folders beside the left views'."""
        folders, scene = left.parents[2], left.parent.name
        return Frame(
            name=f"{scene}/{left.stem}",
            left=left,
            right=folders / f"{self.render}_right" / scene / left.name,
            disparity=folders / "disparities" / scene / left.name,
        )

    def read_disparity(self, truth: Path) -> tuple[FloatMap, Mask]:
        """Read dense disparity, occluded pixels included."""
        return read_disparity_sintel(truth)

    def read_occluded(self, truth: Path, disparity: FloatMap, valid: Mask) -> Mask | None:
        """Read the mask of pixels hidden in or outside the right view; None without both files."""
        paths = [
            truth.parents[2] / folder / truth.parent.name / truth.name
            for folder in ("occlusions", "outofframe")
        ]
        if not all(path.is_file() for path in paths):
            return None
        return np.logical_or(*(read_levels(path) > 0 for path in paths))
