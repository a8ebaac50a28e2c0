"""Materials of surfaces, drawn at random."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from mobilestereonet.scenes.noise import NOISE_KINDS
from mobilestereonet.scenes.scene import Floats, Ints

MATERIALS_PER_DRAW = 256


def log_uniform(rng: np.random.Generator, low: float, high: float, size: Any = None) -> Any:
    """Draw numbers whose logarithm is uniform; the bounds may come in either order."""
    return low * (high / low) ** rng.random(size)


@dataclass
class Material:
    """Materials of n surfaces.

    Attributes:
        texture: Index in the texture bank, (n,).
        density: Texels per metre, (n,).
        angle: Rotation of the texture on the surface, in radians, (n,).
        colour: Factor on the texture's colour, (n, 3).
        contrast: Factor on the texture's departure from its mean, (n,).
        gloss: Strength of the highlight, (n,).
        mirror: Share of the light that it mirrors, seen head-on, (n,).
    """

    texture: Ints
    density: Floats
    angle: Floats
    colour: Floats
    contrast: Floats
    gloss: Floats
    mirror: Floats

    def __getitem__(self, which: Any) -> Material:
        """Copy of the material of some of the surfaces."""
        return Material(*(getattr(self, field.name)[which].copy() for field in fields(self)))


class MaterialStock:
    """Random materials of one scene, drawn many at once, which is cheaper than a few at a time.

    Args:
        rng: The scene's generator.
        focal: Focal length in pixels: textures have about a texel per pixel.
        noise: Number of noise textures in the bank.
        photographs: Number of photographs in the bank.
        mirrors: Probability that a surface mirrors its surroundings.
    """

    def __init__(
        self,
        rng: np.random.Generator,
        focal: float,
        noise: int,
        photographs: int,
        mirrors: float = 0.0,
    ) -> None:
        self._rng, self._focal, self._mirrors = rng, focal, mirrors
        # A stream of their own: without mirrors a scene is the same.
        self._mirror_rng = np.random.Generator(rng.bit_generator.jumped())  # type: ignore[attr-defined]
        self._noise, self._photographs = noise, photographs
        self._refill()

    def _refill(self, count: int = MATERIALS_PER_DRAW) -> None:
        """Draw the next materials."""
        rng = self._rng
        strength = rng.random(count)
        contrast = rng.uniform(0.7, 1.15, count)
        contrast = np.where(strength < 0.3, rng.uniform(0.25, 0.7, count), contrast)
        contrast = np.where(strength < 0.2, log_uniform(rng, 0.01, 0.25, count), contrast)
        tint = rng.choice([0.0, 0.06, 0.2], (count, 1)) * rng.uniform(-1, 1, (count, 3))
        askew = rng.random(count) < 0.3
        angle = np.where(askew, rng.uniform(0, 6.28, count), rng.normal(0, 0.03, count))
        shiny = rng.random(count) < 0.2
        self._stock = Material(
            texture=rng.integers(0, self._noise, count),
            density=self._focal * log_uniform(rng, 0.5, 2.5, count),
            angle=angle,
            colour=log_uniform(rng, 0.55, 1.6, (count, 1)) * (1 + tint),
            contrast=contrast,
            gloss=np.where(shiny, rng.uniform(0.05, 0.4, count), 0.0),
            mirror=np.zeros(count),
        )
        if self._mirrors:
            self._make_mirrors(self._stock)
        self._photograph = self._noise + rng.integers(0, max(self._photographs, 1), count)
        self._choice = rng.random(count) if self._photographs else np.ones(count)
        self._used = 0

    def draw_surroundings(self) -> int:
        """Draw the texture that mirrors show."""
        return int(self._mirror_rng.integers(self._noise + self._photographs))

    def _make_mirrors(self, material: Material) -> None:
        """Turn some of the materials into metal, plain and bright, or glass, dark."""
        rng, count = self._mirror_rng, len(material.gloss)
        chosen, metal = rng.random(count) < self._mirrors, rng.random(count) < 0.5
        share = np.where(metal, rng.uniform(0.3, 0.8, count), rng.uniform(0.06, 0.2, count))
        material.mirror = np.where(chosen, share, 0.0)
        material.contrast = np.where(chosen & metal, 0.2, 1.0) * material.contrast
        material.colour = np.where(chosen & ~metal, 0.4, 1.0)[:, None] * material.colour
        material.gloss = np.where(chosen, rng.uniform(0.3, 1.0, count), material.gloss)

    def draw(self, count: int, depth: ArrayLike, kind: int | None = None) -> Material:
        """Draw materials of surfaces that are seen from ``depth`` metres.

        Args:
            count: Number of materials.
            depth: Depths in metres, a number or (count,).
            kind: Kind of noise, an index in `NOISE_KINDS`; any if left out. If the bank has
                photographs, they make up three in four materials, half where a kind is asked for.
        """
        if self._used + count > len(self._choice):
            self._refill(max(count, MATERIALS_PER_DRAW))
        part = slice(self._used, self._used + count)
        self._used += count
        material = self._stock[part]
        if kind is not None:
            cycles = max(1, self._noise // len(NOISE_KINDS))
            material.texture = kind + len(NOISE_KINDS) * (material.texture % cycles)
            material.texture = np.minimum(material.texture, self._noise - 1)
        chosen = self._choice[part] < (0.75 if kind is None else 0.5)
        material.texture = np.where(chosen, self._photograph[part], material.texture)
        material.density /= np.asarray(depth)
        return material
