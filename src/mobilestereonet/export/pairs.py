"""Pairs to compare and to calibrate with."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import torch.nn.functional as F
from torch import Tensor

from mobilestereonet.data import PairFolder, StereoSample
from mobilestereonet.data.motorcycle import motorcycle
from mobilestereonet.export.base import Pair
from mobilestereonet.scenes import ProceduralScenes, SceneConfig

_SCENES = 24
_SCENE_SEED = 3_000_017  # no training, validation or benchmark uses it


def real_pair(size: tuple[int, int]) -> Pair:
    """scikit-image's Motorcycle, in the given height and width."""
    return _fit(motorcycle(), size)


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
        yield from (_fit(pairs[index], size) for index in range(len(pairs)))
        return
    yield real_pair(size)
    scenes = ProceduralScenes(SceneConfig(height=size[0], width=size[1], seed=_SCENE_SEED))
    yield from (_fit(scenes[index], size) for index in range(_SCENES))


def _fit(sample: StereoSample, size: tuple[int, int]) -> Pair:
    """Scale a pair until it covers the size, then cut out the middle."""
    height, width = sample.left.shape[-2:]
    scale = max(size[0] / height, size[1] / width)
    scaled = (max(round(scale * height), size[0]), max(round(scale * width), size[1]))
    top, left = ((have - want) // 2 for have, want in zip(scaled, size, strict=True))

    def cut(view: Tensor) -> Tensor:
        view = F.interpolate(view[None], scaled, mode="bilinear", antialias=True)
        return view[..., top : top + size[0], left : left + size[1]].clamp(0, 1).contiguous()

    return cut(sample.left), cut(sample.right)
