"""Data set of procedural scenes, reproducible from (seed, index)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.utils.data import Dataset

from mobilestereonet.data.sample import Calibration, StereoSample
from mobilestereonet.scenes.builder import SceneBuilder
from mobilestereonet.scenes.config import SceneConfig
from mobilestereonet.scenes.layouts import LAYOUTS
from mobilestereonet.scenes.masks import MASK_KINDS, make_masks
from mobilestereonet.scenes.materials import log_uniform
from mobilestereonet.scenes.noise import make_noise
from mobilestereonet.scenes.objects import add_background_things, add_floating_things
from mobilestereonet.scenes.relief import render_relief
from mobilestereonet.scenes.render import render_scenes
from mobilestereonet.scenes.scene import Scene
from mobilestereonet.scenes.textures import TextureBank, read_photographs

# The texture bank's generator: its key has this where a scene's has the index.
_TEXTURE_BANK_KEY = 2**64 - 1


class ProceduralScenes(Dataset[StereoSample]):
    """Data set of procedural stereo scenes, rendered on demand.

    The same (seed, index) is the same scene on every machine, if ``textures`` is the same folder:
    all random numbers come from Philox on the CPU, keyed by (seed, index), and rendering is plain
    arithmetic on ``device``.
    """

    def __init__(
        self,
        config: SceneConfig | None = None,
        *,
        textures: Path | None = None,
        device: torch.device | str = "cpu",
    ) -> None:
        """Prepare the textures.

        Args:
            config: Settings; the defaults if left out.
            textures: Folder of photographs (searched recursively) to use beside noise.
            device: Device on which scenes are rendered.

        Raises:
            FileNotFoundError: If ``textures`` does not exist.
            InputError: If it holds no readable image.
        """
        self.config = config or SceneConfig()
        self.device = torch.device(device)
        rng = self._generator(_TEXTURE_BANK_KEY)
        size = self.config.texture_size
        images = make_noise(rng, self.config.noise_textures, size)
        masks = make_masks(rng, 8 * len(MASK_KINDS))
        if textures is not None:
            images = np.concatenate([images, read_photographs(Path(textures), size)])
        self._bank = TextureBank(images, self.config.noise_textures, self.device)
        self._masks = torch.from_numpy(masks).to(self.device)

    def _generator(self, word: int) -> np.random.Generator:
        key = np.array([self.config.seed, word], dtype=np.uint64)
        return np.random.Generator(np.random.Philox(key=key))

    def __len__(self) -> int:
        return self.config.length

    def scene(self, index: int) -> Scene:
        """Geometry, materials and light of scene ``index``, drawn but not rendered."""
        config = self.config
        rng = self._generator(index)
        weights = np.array(list(config.kinds.values()), dtype=np.float64)
        kind = list(config.kinds)[int(rng.choice(len(weights), p=weights / weights.sum()))]
        layout = LAYOUTS[kind]
        nearest = np.exp(rng.uniform(np.log(config.min_disparity), np.log(config.max_disparity)))
        build = SceneBuilder(
            rng,
            (config.height, config.width),
            float(nearest),
            float(rng.uniform(*layout.near)),
            layout.pitch,
            self.config.objects,
            textureless=config.textureless,
            mirrors=config.mirrors,
            noise=self._bank.noise,
            photographs=self._bank.photographs,
            masks=len(self._masks),
        )
        layout.fill(build)
        if config.background and rng.random() < config.background:
            add_background_things(build)
        if config.floating and rng.random() < config.floating:
            add_floating_things(build)
        return build.scene(kind, layout.outdoors)

    def _relief(self, index: int) -> tuple[Tensor, Tensor, Tensor] | None:
        """Views, disparity and occlusion of a scene that is a photograph on a relief."""
        config = self.config
        # A stream beside that of the scene: without reliefs a scene is the same.
        stream = self._generator(index).bit_generator.jumped(2)  # type: ignore[attr-defined]
        rng = np.random.Generator(stream)
        if rng.random() >= config.reliefs:
            return None
        highest = log_uniform(rng, config.min_disparity, config.max_disparity)
        lowest = highest * rng.uniform(0.05, 0.6)
        size = (config.height, config.width)
        return render_relief(rng, size, (lowest, highest), self._bank)

    def batch(self, indices: Sequence[int]) -> StereoSample:
        """Render scenes together.

        Args:
            indices: Indices of B scenes.

        Returns:
            A batched sample: images (B, 3, H, W), maps (B, H, W), on the scenes' device.
        """
        config = self.config
        size = (config.height, config.width)
        with torch.no_grad():
            shown = {int(index): self._relief(int(index)) for index in indices}
            others = [index for index, relief in shown.items() if relief is None]
            if others:
                scenes = [self.scene(index) for index in others]
                views = render_scenes(scenes, size, config.rays, self._bank, self._masks)
                shown |= dict(zip(others, zip(*views, strict=True), strict=True))
        found = [relief for index in indices if (relief := shown[int(index)]) is not None]
        images, disparity, occluded = (torch.stack(maps) for maps in zip(*found, strict=True))
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
        """One scene, not batched, with its calibration; a relief has none."""
        if not 0 <= index < len(self):
            raise IndexError(f"scene {index} of {len(self)}")
        sample = self.batch([index])
        first: dict[str, Any] = {
            item.name: value[0]
            for item in fields(sample)
            if isinstance(value := getattr(sample, item.name), Tensor)
        }
        if self._relief(index) is None:
            scene = self.scene(index)
            camera = Calibration(scene.focal, scene.baseline, 0.0, scene.cx, scene.cy)
            first["calibration"] = camera
        return replace(sample, **first)
