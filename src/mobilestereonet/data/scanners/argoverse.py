"""Argoverse 1 stereo."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import ClassVar

from mobilestereonet.data.disparity_files import read_disparity_png, read_levels
from mobilestereonet.data.files import visible
from mobilestereonet.data.images import FloatMap, Mask
from mobilestereonet.data.scanners.base import Frame, StereoDataSet
from mobilestereonet.data.scanners.registry import register_data_set
from mobilestereonet.errors import InputError

_VIEWS, _MAPS = "rectified_stereo_images_v1.1", "disparity_maps_v1.1"

MAX_GAP_NS = 100_000_000
"""Largest time between a left view and its right view: half of the 5 Hz of the release."""


@register_data_set("argoverse")
class Argoverse(StereoDataSet):
    """Argoverse 1 stereo: streets of two cities with a laser's ground truth, 2464 x 2056.

    ::

        root                               (or the folder argoverse_stereo_v1.1 below it)
        ├── rectified_stereo_images_v1.1
        │   └── {train,val,test}/273c1883-...
        │       ├── stereo_front_left_rect/stereo_front_left_rect_315978406032859416.jpg
        │       └── stereo_front_right_rect/stereo_front_right_rect_315978406032860168.jpg
        └── disparity_maps_v1.1
            └── {train,val}/273c1883-...
                ├── stereo_front_left_rect_disparity/*_315978406032859416.png     uint16 / 256
                └── stereo_front_left_rect_objects_disparity/*_315978406032859416.png

    The files are named by their time in ns, which differs a little between the cameras: the right
    view is the nearest in time. Foreground is where the map of objects has a disparity (optional).

    Source: the stereo competition's tutorial in argoverse/argoverse-api. The arguments and the
    errors are those of `StereoDataSet`.

    Args:
        split: ``train``, ``val`` or ``test``; the last has no ground truth.
    """

    splits: ClassVar = {"train": None, "val": None, "test": None}
    withheld = frozenset({"test"})

    def __init__(self, root: str | Path, split: str | None = None, *, strict: bool = False) -> None:
        self._listed: dict[Path, dict[int, Path]] = {}
        super().__init__(root, split, strict=strict)

    def patterns(self) -> Sequence[str]:
        """Globs of the left views, a folder per drive."""
        inner = f"{_VIEWS}/{self.split}/*/stereo_front_left_rect/*_[0-9]*.jpg"
        return [inner, f"argoverse_stereo_v1.1/{inner}"]

    def frame(self, left: Path) -> Frame:
        """The right view that is nearest in time, and the ground truth of the same time."""
        drive, time = left.parents[1], _time(left)
        base = drive.parents[2]
        rights = self._by_time(drive / "stereo_front_right_rect")
        nearest = min(rights, key=lambda other: abs(other - time), default=time + 2 * MAX_GAP_NS)
        is_near = abs(nearest - time) <= MAX_GAP_NS
        absent = drive / "stereo_front_right_rect" / f"stereo_front_right_rect_{time}.jpg"
        maps = base / _MAPS / self.split / drive.name / "stereo_front_left_rect_disparity"
        known = {} if self.split in self.withheld else self._by_time(maps)
        return Frame(
            name=f"{drive.name}/{time}",
            left=left,
            right=rights[nearest] if is_near else absent,
            disparity=known.get(time, maps / f"stereo_front_left_rect_disparity_{time}.png"),
        )

    def read_disparity(self, truth: Path) -> tuple[FloatMap, Mask]:
        """Read the laser's sparse disparity."""
        return read_disparity_png(truth)

    def _by_time(self, folder: Path) -> dict[int, Path]:
        """Files of a folder by their time; it is listed once."""
        if folder not in self._listed:
            self._listed[folder] = {_time(path): path for path in visible(folder, "*_[0-9]*")}
        return self._listed[folder]

    def read_foreground(self, truth: Path) -> Mask | None:
        """Read the mask of pixels with a disparity in the map of objects."""
        objects = truth.parents[1] / "stereo_front_left_rect_objects_disparity"
        path = self._by_time(objects).get(_time(truth))
        return None if path is None else read_levels(path) > 0


def _time(path: Path) -> int:
    """Time in a file's name, in ns."""
    time = path.stem.rpartition("_")[2]
    if not time.isdecimal():
        raise InputError(f"{path}: its name must end in its time in ns, as those of Argoverse do")
    return int(time)
