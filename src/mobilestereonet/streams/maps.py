"""Map files of many pairs: their names, and writing and reading them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mobilestereonet.data.depth_files import write_depth
from mobilestereonet.data.disparity_files import (
    read_disparity_png,
    write_disparity_png,
)
from mobilestereonet.data.files import is_whole, write_npy, write_pfm, write_png
from mobilestereonet.data.images import FloatMap
from mobilestereonet.data.sample import Calibration
from mobilestereonet.errors import InputError
from mobilestereonet.inference import StereoPair, StereoResult
from mobilestereonet.inference.map_files import MAX_PNG_DISPARITY_PX
from mobilestereonet.streams.laser import Pose, write_laser_points
from mobilestereonet.streams.pairs import PairFiles


def _known(result: StereoResult) -> FloatMap:
    return np.where(result.valid, result.disparity, np.float32(np.inf))


def _write_disparity(path: Path, result: StereoResult) -> None:
    write_disparity_png(
        path, result.disparity, result.valid & (result.disparity <= MAX_PNG_DISPARITY_PX)
    )


_WRITERS: dict[str, Callable[[Path, StereoResult], None]] = {
    "disparity.png": _write_disparity,
    "disparity.pfm": lambda path, result: write_pfm(path, _known(result)),
    "disparity.npy": lambda path, result: write_npy(path, _known(result)),
    "picture.png": lambda path, result: write_png(path, result.picture()),
}

LASER_POINTS = "points.bin"

MAP_KINDS = (*_WRITERS, "depth.png", "depth.npy", "depth.tiff", LASER_POINTS)
"""Maps that a pair may get; `StereoResult.save`, `write_depth` and `write_laser_points` say what is
in them."""


@dataclass(frozen=True)
class MapFiles:
    """Files of each pair's maps: ``FOLDER/NAME_disparity.png`` and so on.

    Args:
        folder: Folder to write to.
        kinds: What to write, of `MAP_KINDS`.

    Raises:
        InputError: If a kind is unknown.
    """

    folder: Path
    kinds: tuple[str, ...] = ("disparity.png",)

    def __post_init__(self) -> None:
        unknown = [kind for kind in self.kinds if kind not in MAP_KINDS]
        if unknown or not self.kinds:
            raise InputError(f"maps to write are of {', '.join(MAP_KINDS)}; got {unknown}")

    @property
    def needs_calibration(self) -> bool:
        """Whether one of the maps is a depth, or made of it."""
        return any(kind.startswith(("depth", "points")) for kind in self.kinds)

    def path(self, name: str, kind: str) -> Path:
        """The file of one of a pair's maps."""
        return self.folder / f"{name}_{kind}"

    def paths(self, name: str) -> list[Path]:
        """The files of all maps of a pair."""
        return [self.path(name, kind) for kind in self.kinds]

    def finished(self, name: str) -> bool:
        """Whether a pair has all its files, and these are whole."""
        return all(is_whole(path) for path in self.paths(name))

    def matched(self, name: str) -> bool:
        """Whether a pair has its disparities; other maps can be made of the PNG, to 1/256 px."""
        kinds = [kind for kind in self.kinds if kind.startswith("disparity")]
        return all(is_whole(self.path(name, kind)) for kind in ("disparity.png", *kinds))

    def unfinished(self, pairs: Sequence[PairFiles]) -> list[PairFiles]:
        """The pairs that lack a file."""
        return [pair for pair in pairs if not self.finished(pair.name)]

    def save(
        self,
        name: str,
        result: StereoResult,
        calibration: Calibration | None,
        *,
        to_laser: Pose | None = None,
        keep: bool = False,
    ) -> None:
        """Write a pair's maps, each file atomically.

        Args:
            name: The pair's name.
            result: Its result.
            calibration: Its geometry; depth needs it.
            to_laser: From the left camera's frame to the laser scanner's, if known.
            keep: Leave the files that are there as they are.

        Raises:
            InputError: If the calibration is missing, or known to be of another size.
        """
        if calibration is not None and self.needs_calibration:
            height, width = result.disparity.shape
            calibration.require_size(width, height)  # before the first of several files
        for kind in self.kinds:
            path = self.path(name, kind)
            if keep and is_whole(path):
                continue
            if kind in _WRITERS:
                _WRITERS[kind](path, result)
            elif calibration is None:
                raise InputError(f"{path}: depth needs a calibration, and {name} has none")
            elif kind == LASER_POINTS:
                write_laser_points(path, result.points(calibration), to_laser)
            else:
                write_depth(path, result.depth(calibration))

    def load(self, name: str, pair: StereoPair) -> StereoResult:
        """Read a saved result.

        Args:
            name: The pair's name.
            pair: The pair that it belongs to.

        Raises:
            InputError: If the saved disparity is damaged or of another size.
        """
        path = self.path(name, "disparity.png")
        disparity, valid = read_disparity_png(path)
        size = (pair.height, pair.width)
        if disparity.shape != size:
            raise InputError(
                f"{path}: shape is {disparity.shape}, but the left view's is {size}: it is of "
                "another stream; choose another folder"
            )
        return StereoResult(left=pair.left_image, disparity=disparity, valid=valid)
