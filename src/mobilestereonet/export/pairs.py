"""Stereo pairs that calibrate a quantiser."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from mobilestereonet.data import PairFolder, StereoSample
from mobilestereonet.data.images import cover_and_crop
from mobilestereonet.data.motorcycle import motorcycle_views
from mobilestereonet.export.base import Pair
from mobilestereonet.scenes import ProceduralScenes, SceneConfig

_SCENES = 24
_SCENE_SEED = 3_000_017  # no training, validation or benchmark uses it


def calibration_pairs(size: tuple[int, int], folder: Path | None = None) -> Iterator[Pair]:
    """Pairs that show a quantiser what values to expect.

    Args:
        size: Height and width.
        folder: Folder of the user's own pairs, in the default layout of `PairFolder`. Without it:
            scikit-image's Motorcycle, and procedural scenes.

    Raises:
        FileNotFoundError: If the folder does not exist or holds no pair.
    """
    if folder is not None:
        pairs = PairFolder(folder)
        yield from (_views(pairs[index], size) for index in range(len(pairs)))
        return
    yield motorcycle_views(size)
    scenes = ProceduralScenes(SceneConfig(height=size[0], width=size[1], seed=_SCENE_SEED))
    yield from (_views(scenes[index], size) for index in range(_SCENES))


def _views(sample: StereoSample, size: tuple[int, int]) -> Pair:
    return cover_and_crop(sample.left, size), cover_and_crop(sample.right, size)
