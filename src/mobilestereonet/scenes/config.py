"""Settings of procedural scenes."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from mobilestereonet.errors import InputError
from mobilestereonet.scenes.layouts import LAYOUTS
from mobilestereonet.scenes.noise import NOISE_KINDS

DISPARITY_RANGE_PX = (1e-6, 1e6)
"""Bounds of a scene's disparities: beyond them float32 geometry breaks down."""

MAX_OBJECTS = 10_000
"""Largest number of floating objects: more take too much memory to render."""


MAX_SIDE_PX = 16_384
"""Height and width of a scene's views above which they would fill the memory."""


@dataclass(frozen=True)
class SceneConfig:
    """Settings of procedural scenes.

    Attributes:
        height: Height of the images, in pixels.
        width: Width of the images, in pixels.
        max_disparity: Largest disparity of a scene's nearest objects, in pixels.
        min_disparity: Smallest disparity of a scene's nearest objects, in pixels. Each scene draws
            its own between the two, evenly in the logarithm.
        seed: First word of the generator's key; the scene's index is the second.
        rays: Rays per pixel: 1 (the centre) or 2 (the centre and corners shared by neighbours).
        objects: Range of the number of floating objects in a scene of clutter; fewer indoors.
        textureless: Probability that a large near surface (a box's faces and a room's walls one
            by one) has next to no texture. It changes the textures' positions and the light, too.
        background: Probability that many things stand far away, before the backdrop.
        floating: Probability that many small things float everywhere.
        mirrors: Probability that a surface mirrors its surroundings, as metal or glass does.
        reliefs: Share of scenes that are a photograph on a relief instead of a layout.
        kinds: Weight of each layout.
        noise_textures: Number of noise textures.
        texture_size: Side of a texture in texels, a power of two.
        length: Nominal number of scenes.
    """

    height: int = 256
    width: int = 512
    max_disparity: float = 192.0
    min_disparity: float = 12.0
    seed: int = 0
    rays: int = 2
    objects: tuple[int, int] = (20, 60)
    textureless: float = 0.0
    background: float = 0.0
    floating: float = 0.0
    mirrors: float = 0.0
    reliefs: float = 0.0
    kinds: Mapping[str, float] = field(
        default_factory=lambda: {
            "room": 0.25,
            "street": 0.25,
            "park": 0.1,
            "table": 0.15,
            "clutter": 0.2,
            "planes": 0.05,
        }
    )
    noise_textures: int = 4 * len(NOISE_KINDS)
    texture_size: int = 512
    length: int = 35_454

    def __post_init__(self) -> None:
        for name, least in (("height", 2), ("width", 2), ("noise_textures", 1), ("length", 1)):
            if getattr(self, name) < least:
                raise InputError(
                    f"scenes: {name} must be at least {least}, got {getattr(self, name)}"
                )
        if max(self.height, self.width) > MAX_SIDE_PX:
            raise InputError(
                f"scenes: height and width must be at most {MAX_SIDE_PX}, got {self.height} and "
                f"{self.width}"
            )
        low, high = DISPARITY_RANGE_PX
        if not low <= self.min_disparity <= self.max_disparity <= high:
            raise InputError(
                f"scenes: {low:g} <= min_disparity <= max_disparity <= {high:g} must hold, got "
                f"{self.min_disparity} and {self.max_disparity}"
            )
        if not 0 <= self.seed < 2**64:
            raise InputError(f"scenes: seed must be from 0 to 2**64 - 1, got {self.seed}")
        if len(self.objects) != 2 or not 0 <= self.objects[0] <= self.objects[1] <= MAX_OBJECTS:
            raise InputError(
                f"scenes: objects must be a range of counts up to {MAX_OBJECTS}, got {self.objects}"
            )
        for name in ("textureless", "background", "floating", "mirrors", "reliefs"):
            if not 0 <= getattr(self, name) <= 1:
                raise InputError(f"scenes: {name} must be from 0 to 1, got {getattr(self, name)}")
        if self.rays not in (1, 2):
            raise InputError(f"scenes: rays must be 1 or 2, got {self.rays}")
        if self.texture_size & (self.texture_size - 1) or self.texture_size < 2:
            raise InputError(
                f"scenes: texture_size must be a power of two, got {self.texture_size}"
            )
        unknown = sorted(set(self.kinds) - set(LAYOUTS))
        weights = list(self.kinds.values())
        if unknown or not 0 < sum(weights) < math.inf or min(weights) < 0:
            raise InputError(
                f"scenes: kinds needs weights for some of {', '.join(LAYOUTS)}, got {self.kinds}"
            )
