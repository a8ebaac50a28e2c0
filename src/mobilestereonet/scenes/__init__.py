"""Procedural stereo scenes: exact disparity and occlusion, reproducible from (seed, index)."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.utils.data import Dataset

from mobilestereonet.data.sample import Calibration, StereoSample
from mobilestereonet.errors import InputError
from mobilestereonet.scenes.builder import Builder
from mobilestereonet.scenes.masks import MASKS, make_masks
from mobilestereonet.scenes.noise import NOISE, make_noise
from mobilestereonet.scenes.places import PLACES
from mobilestereonet.scenes.render import render_scenes
from mobilestereonet.scenes.scene import Scene
from mobilestereonet.scenes.textures import TextureBank, read_photographs

__all__ = ["ProceduralScenes", "SceneConfig"]

# The texture bank's place in the key of the generator, where scenes have their index.
_BANK = 2**64 - 1

DISPARITY_RANGE_PX = (1e-6, 1e6)
"""Bounds of a scene's disparities: beyond them float32 geometry breaks down."""

MAX_OBJECTS = 10_000
"""Largest number of floating objects: more take too much memory to render."""


@dataclass(frozen=True)
class SceneConfig:
    """Procedural scenes as data.

    Attributes:
        height: Height of the images, in pixels.
        width: Width of the images, in pixels.
        max_disparity: Largest disparity that a scene aims at, in pixels.
        min_disparity: Smallest disparity that a scene's nearest things have, in pixels. Each scene
            draws its own nearest disparity between the two, evenly in the logarithm.
        seed: First word of the generator's key; the scene's index is the second.
        rays: Rays per pixel: 1 (the centre) or 2 (the centre and corners shared by neighbours).
        objects: Fewest and most things that float in a scene of clutter; fewer indoors.
        textureless: Chance of each large near surface (a box's faces and a room's walls one by
            one) to have next to no texture. Scenes of the same index differ then in textures'
            positions and light, too.
        kinds: Weight of each layout.
        noise_textures: How many noise textures to make.
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
    noise_textures: int = 4 * len(NOISE)
    texture_size: int = 512
    length: int = 35_454

    def __post_init__(self) -> None:
        for name, least in (("height", 2), ("width", 2), ("noise_textures", 1), ("length", 1)):
            if getattr(self, name) < least:
                raise InputError(
                    f"scenes: {name} must be at least {least}, got {getattr(self, name)}"
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
        if not 0 <= self.textureless <= 1:
            raise InputError(f"scenes: textureless must be from 0 to 1, got {self.textureless}")
        if self.rays not in (1, 2):
            raise InputError(f"scenes: rays must be 1 or 2, got {self.rays}")
        if self.texture_size & (self.texture_size - 1) or self.texture_size < 2:
            raise InputError(
                f"scenes: texture_size must be a power of two, got {self.texture_size}"
            )
        unknown = sorted(set(self.kinds) - set(PLACES))
        weights = list(self.kinds.values())
        if unknown or not 0 < sum(weights) < math.inf or min(weights) < 0:
            raise InputError(
                f"scenes: kinds needs weights for some of {', '.join(PLACES)}, got {self.kinds}"
            )


class ProceduralScenes(Dataset[StereoSample]):
    """Scenes made on demand: the same (seed, index) is the same scene on every machine.

    All random numbers come from Philox on the CPU, keyed by (seed, index); rendering is plain
    arithmetic on ``device``. The same ``textures`` folder belongs to the scene, too.
    """

    def __init__(
        self,
        config: SceneConfig | None = None,
        *,
        textures: Path | None = None,
        device: torch.device | str = "cpu",
    ) -> None:
        """Make the texture bank.

        Args:
            config: What scenes to make.
            textures: Folder of images (searched recursively) to use beside noise.
            device: Where scenes are rendered.

        Raises:
            FileNotFoundError: If ``textures`` does not exist.
            InputError: If it holds no readable image.
        """
        self.config = config or SceneConfig()
        self.device = torch.device(device)
        rng = self._generator(_BANK)
        size = self.config.texture_size
        images = make_noise(rng, self.config.noise_textures, size)
        masks = make_masks(rng, 8 * len(MASKS))
        if textures is not None:
            images = np.concatenate([images, read_photographs(Path(textures), size)])
        self._bank = TextureBank(images, self.config.noise_textures, self.device)
        self._masks = torch.from_numpy(masks).to(self.device)

    def _generator(self, word: int) -> np.random.Generator:
        key = np.array([self.config.seed, word], dtype=np.uint64)
        return np.random.Generator(np.random.Philox(key=key))

    def __len__(self) -> int:
        return self.config.length

    def layout(self, index: int) -> Scene:
        """Everything random about scene ``index``."""
        config = self.config
        rng = self._generator(index)
        weights = np.array(list(config.kinds.values()), dtype=np.float64)
        kind = list(config.kinds)[int(rng.choice(len(weights), p=weights / weights.sum()))]
        place = PLACES[kind]
        nearest = np.exp(rng.uniform(np.log(config.min_disparity), np.log(config.max_disparity)))
        build = Builder(
            rng,
            (config.height, config.width),
            float(nearest),
            float(rng.uniform(*place.near)),
            place.pitch,
            self.config.objects,
            textureless=config.textureless,
            noise=self._bank.noise,
            photographs=self._bank.photographs,
            masks=len(self._masks),
        )
        place.layout(build)
        return build.finish(kind, place.outdoors)

    def batch(self, indices: Sequence[int]) -> StereoSample:
        """Render scenes together.

        Args:
            indices: B numbers of scenes.

        Returns:
            A batched sample: images (B, 3, H, W), maps (B, H, W), on the scenes' device.
        """
        scenes = [self.layout(int(index)) for index in indices]
        config = self.config
        with torch.no_grad():
            images, disparity, occluded = render_scenes(
                scenes, (config.height, config.width), config.rays, self._bank, self._masks
            )
        valid = disparity > 0
        return StereoSample(
            left=images[:, 0].contiguous(),
            right=images[:, 1].contiguous(),
            disparity=disparity,
            valid=valid,
            occluded=occluded & valid,
            name=",".join(f"scene {index}" for index in indices),
        )

    def __getitem__(self, index: int) -> StereoSample:
        """One scene, not batched, with its calibration."""
        if not 0 <= index < len(self):
            raise IndexError(f"scene {index} of {len(self)}")
        scene = self.layout(index)
        sample = self.batch([index])
        first: dict[str, Any] = {
            item.name: value[0]
            for item in fields(sample)
            if isinstance(value := getattr(sample, item.name), Tensor)
        }
        calibration = Calibration(scene.focal, scene.baseline, 0.0, scene.cx, scene.cy)
        return replace(sample, **first, calibration=calibration)
