"""What matching a pair gives."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mobilestereonet.data.disparity_files import KITTI_SCALE, write_disparity_png
from mobilestereonet.data.files import write_npy, write_pfm, write_png
from mobilestereonet.data.sample import Calibration
from mobilestereonet.plots import Picture, colour_disparity, side_by_side

SMALLEST_DISPARITY = 1 / KITTI_SCALE
"""Pixels of disparity, the step of KITTI's files: what is below has no depth."""

_LARGEST_IN_PNG = 65535 / KITTI_SCALE


@dataclass(frozen=True)
class StereoResult:
    """Disparity of the left view, and what belongs to it.

    Attributes:
        left: Left view, (H, W, 3) uint8 RGB.
        disparity: (H, W) float32, in pixels of the left view.
        valid: (H, W) bool, False where the disparity is not known.
        confidence: (H, W) float32 in 0..1, or None where it was not estimated.
        facts: What was run and how long it took: ``model``, ``runtime``, ``width``, ``height``,
            ``seconds`` (from the checked pair to the disparity; a pair's share of its batch).
    """

    left: Picture
    disparity: NDArray[np.float32]
    valid: NDArray[np.bool_]
    confidence: NDArray[np.float32] | None = None
    facts: dict[str, Any] = field(default_factory=dict)

    def depth(self, calibration: Calibration) -> NDArray[np.float32]:
        """Depth along the optical axis.

        Args:
            calibration: Geometry of the pair, for the left view's size.

        Returns:
            (H, W) float32 in metres. Never NaN or infinite: 0 where it is not known, which is
            where ``valid`` is False or the disparity (plus ``doffs``) is below 1/256 px.
        """
        disparity = self.disparity + np.float32(calibration.doffs)
        known = self.valid & (disparity >= SMALLEST_DISPARITY)
        depth = calibration.focal * calibration.baseline / np.where(known, disparity, 1)
        return np.where(known, depth, 0).astype(np.float32)

    def picture(self) -> Picture:
        """The left view beside the coloured disparity, (H, 2 W + gap, 3) uint8 RGB."""
        return side_by_side([self.left, colour_disparity(self.disparity, valid=self.valid)])

    def save(self, folder: str | Path, stem: str) -> dict[str, Path]:
        """Write the disparity and a picture, each file atomically.

        Args:
            folder: Folder to write to; made if it does not exist.
            stem: How the files' names begin.

        Returns:
            Paths by kind: ``png`` (16 bit, disparity x 256 as in KITTI; 0 where unknown or 256 px
            and more), ``pfm`` and ``npy`` (float32; infinite where unknown) and ``picture``.
        """
        folder = Path(folder)
        paths = {kind: folder / f"{stem}_disparity.{kind}" for kind in ("png", "pfm", "npy")}
        paths["picture"] = folder / f"{stem}_picture.png"
        disparity = np.where(self.valid, self.disparity, np.float32(np.inf))
        storable = disparity <= _LARGEST_IN_PNG
        write_disparity_png(paths["png"], disparity, storable)
        write_pfm(paths["pfm"], disparity)
        write_npy(paths["npy"], disparity)
        write_png(paths["picture"], self.picture())
        return paths
