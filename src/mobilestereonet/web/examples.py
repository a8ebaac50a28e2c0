"""Example pairs: a real one and rendered ones."""

from __future__ import annotations

from dataclasses import replace

from mobilestereonet.data.motorcycle import motorcycle
from mobilestereonet.data.sample import StereoSample
from mobilestereonet.scenes import ProceduralScenes, SceneConfig

_RENDERED = SceneConfig(
    height=320,
    width=512,
    max_disparity=96,
    min_disparity=32,
    kinds={"street": 1, "room": 1, "table": 1, "park": 1},
    noise_textures=32,
)
_SCENES = {"Street": 0, "Table": 5, "Park": 9}


def examples() -> list[StereoSample]:
    """Make the examples, each with its calibration and a name to show."""
    scenes = ProceduralScenes(_RENDERED)
    return [
        replace(motorcycle(), name="Motorcycle"),
        *(replace(scenes[index], name=name) for name, index in _SCENES.items()),
    ]
