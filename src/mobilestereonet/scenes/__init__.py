"""Procedural stereo scenes: exact disparity and occlusion, reproducible from (seed, index)."""

from mobilestereonet.scenes.config import SceneConfig
from mobilestereonet.scenes.data_set import ProceduralScenes

__all__ = ["ProceduralScenes", "SceneConfig"]
