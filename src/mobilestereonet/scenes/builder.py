"""Builder of scenes: camera, materials and surfaces, drawn from one random generator.

World frame: x to the right, y down, z ahead, origin at the left camera. The builder turns it
into the camera's frame: the camera pitches and rolls, the right one is ``baseline`` along its x.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from mobilestereonet.scenes.masks import MASK_KINDS
from mobilestereonet.scenes.materials import Material, MaterialStock, log_uniform
from mobilestereonet.scenes.scene import (
    MASKED,
    QUADRIC,
    RECTANGLE,
    SPHERE,
    Floats,
    Ints,
    Scene,
    Surfaces,
)


@dataclass(frozen=True)
class _Part:
    """Surfaces as they were added, n of one shape, in the world frame."""

    shape: int
    centre: Floats
    axes: Floats
    material: Material
    extras: dict[str, Any]


def yaw_rotations(angles: ArrayLike) -> Floats:
    """Rotations about the vertical axis, (n, 3, 3)."""
    angles = np.atleast_1d(np.asarray(angles, dtype=np.float64))
    result = np.zeros((len(angles), 3, 3))
    result[:, 0, 0] = result[:, 2, 2] = np.cos(angles)
    result[:, 0, 2] = np.sin(angles)
    result[:, 2, 0] = -np.sin(angles)
    result[:, 1, 1] = 1
    return result


class SceneBuilder:
    """Draws the random parts of one scene and collects its surfaces.

    Args:
        rng: The scene's generator.
        size: Height and width of the images, in pixels.
        nearest: Disparity of the nearest objects, in pixels.
        near: Their distance, in metres.
        pitch: Range of the camera's pitch (down is positive), in radians.
        objects: Range of the number of floating objects in a scene of clutter.
        textureless: Probability that a large near surface has next to no texture.
        mirrors: Probability that a surface mirrors its surroundings.
        noise: Number of noise textures in the bank.
        photographs: Number of photographs in the bank.
        masks: Number of masks.
    """

    def __init__(
        self,
        rng: np.random.Generator,
        size: tuple[int, int],
        nearest: float,
        near: float,
        pitch: tuple[float, float],
        objects: tuple[int, int],
        *,
        textureless: float,
        mirrors: float,
        noise: int,
        photographs: int,
        masks: int,
    ) -> None:
        self.rng = rng
        self.height, self.width = size
        self.near, self.nearest = near, nearest
        self.objects, self.textureless = objects, textureless
        self.masks = masks
        # A long focal length with a principal point off the centre is a crop of a wide image.
        zoom = self.log_uniform(0.55, 1.8)
        self.focal = zoom * self.width
        shift = 0.12 + 0.2 * max(0.0, zoom - 0.8)
        self.cx = self.width * (0.5 + shift * rng.uniform(-1, 1))
        self.cy = self.height * (0.5 + 0.5 * shift * rng.uniform(-1, 1))
        self.baseline = nearest * near / self.focal
        self.pitch = rng.uniform(*pitch)
        roll = rng.normal(0, 0.03)
        cos, sin = np.cos(self.pitch), np.sin(self.pitch)
        tilt = np.array([[1, 0, 0], [0, cos, -sin], [0, sin, cos]])
        cos, sin = np.cos(roll), np.sin(roll)
        self.rotation = np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]]) @ tilt
        self.lamp: Floats | None = None  # in the world frame; drawn if a layout sets none
        self.parts: list[_Part] = []
        self._materials = MaterialStock(rng, self.focal, noise, photographs, mirrors)
        self.surroundings = self._materials.draw_surroundings()

    def log_uniform(self, low: float, high: float, size: Any = None) -> Any:
        """Draw numbers whose logarithm is uniform; the bounds may come in either order."""
        return log_uniform(self.rng, low, high, size)

    def draw_materials(self, count: int, depth: ArrayLike, kind: int | None = None) -> Material:
        """Draw materials of surfaces seen from ``depth`` metres; see `MaterialStock.draw`."""
        return self._materials.draw(count, depth, kind)

    def add_rectangles(
        self, centre: Floats, x: Floats, y: Floats, material: Material, **extras: Any
    ) -> None:
        """Add rectangles with half axes ``x`` and ``y``, (n, 3); ``extras`` as in ``Surfaces``."""
        shape = MASKED if "mask" in extras else RECTANGLE
        axes = np.stack([x, y, y], -1)  # the normal follows in the end, for all at once
        self.parts.append(_Part(shape, centre, axes, material, extras))

    def add_boxes(self, centre: Floats, axes: Floats, material: Material) -> None:
        """Add boxes with half axes as columns (right, down, ahead), as six faces."""
        count = len(centre)
        outward = np.concatenate([axes, -axes], -1).swapaxes(1, 2)  # (n, 6, 3)
        x = axes[:, :, [2, 0, 0] * 2].swapaxes(1, 2)
        y = axes[:, :, [1, 2, 1] * 2].swapaxes(1, 2)
        # The normal, x cross y, points outward.
        x = x * np.array([-1, -1, 1, 1, 1, -1])[:, None]
        middle = (centre[:, None] + outward).reshape(-1, 3)
        faces = material[np.repeat(np.arange(count), 6)]
        self.add_rectangles(middle, x.reshape(-1, 3), y.reshape(-1, 3), faces, one_sided=True)

    def add_quadrics(
        self, centre: Floats, axes: Floats, material: Material, kind: ArrayLike = SPHERE
    ) -> None:
        """Add quadrics with half axes as columns; ``kind`` is one or n of SPHERE, CYLINDER ..."""
        self.parts.append(_Part(QUADRIC, centre, axes, material, {"quadric": kind}))

    def _surfaces(self) -> Surfaces:
        """All parts in the left camera's frame."""
        count = [len(part.centre) for part in self.parts]
        shape = np.repeat([part.shape for part in self.parts], count)
        centre = np.concatenate([part.centre for part in self.parts]) @ self.rotation.T
        axes = self.rotation @ np.concatenate([part.axes for part in self.parts])
        normal = np.cross(axes[:, :, 0], axes[:, :, 1])
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        curved = shape == QUADRIC
        axes[:, :, 2] = np.where(curved[:, None], axes[:, :, 2], normal)
        extras = {
            "quadric": np.tile(SPHERE, (len(shape), 1)),
            "mask": np.zeros(len(shape), dtype=np.int64),
            "mask_repeat": np.ones((len(shape), 2)),
            "one_sided": np.zeros(len(shape), dtype=np.bool_),
        }
        for part, end in zip(self.parts, np.cumsum(count), strict=True):
            for name, values in part.extras.items():
                extras[name][end - len(part.centre) : end] = values
        looks = {
            field.name: np.concatenate([getattr(part.material, field.name) for part in self.parts])
            for field in fields(Material)
        }
        if self.textureless:
            looks["contrast"] *= self._contrast_factors(centre, axes)
        # A quadric's texture goes around it by its mean radius and along its axis.
        length = np.linalg.norm(axes, axis=1)
        extent = np.where(
            curved[:, None],
            np.stack([0.5 * (length[:, 0] + length[:, 1]), length[:, 2]], -1),
            length[:, :2],
        )
        angle = looks.pop("angle")
        spin = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        texels = looks["density"][:, None, None] * np.moveaxis(spin, -1, 0) * extent[:, None]
        shift = self.rng.uniform(0, 1024, (len(shape), 2, 1))
        return Surfaces(
            shape=shape,
            centre=centre,
            axes=axes,
            texels=np.concatenate([texels, shift], -1),
            **extras,
            **looks,
        )

    def _contrast_factors(self, centre: Floats, axes: Floats) -> Floats:
        """Factors on the contrast of surfaces, (n,): small for some of those large and near.

        Large is what spans about a quarter of the view both ways, near what has its centre nearer
        than 8 times the nearest objects (as all ground has, whose centre is below the camera); far
        planes such as the sky are textureless often enough.
        """
        rng, count = self.rng, len(centre)
        depth = np.maximum(centre[:, 2], 0.5 * self.near)
        half = np.linalg.norm(axes, axis=1)[:, :2].min(1) * self.focal / depth
        large = (half > 0.12 * self.width) & (depth < 8 * self.near)
        chosen = large & (rng.random(count) < self.textureless)
        return np.where(chosen, self.log_uniform(0.01, 0.1, count), 1.0)

    def draw_masks(self, count: int, *kinds: int) -> Ints:
        """Draw indices of masks, of any or of the given kinds."""
        choice = self.rng.choice(kinds or range(len(MASK_KINDS)), count)
        cycle: Ints = self.rng.integers(0, self.masks // len(MASK_KINDS), count)
        return choice + len(MASK_KINDS) * cycle

    def random_rotations(self, count: int) -> Floats:
        """Uniformly random rotations, (n, 3, 3)."""
        w, x, y, z = (q := self.rng.normal(size=(4, count))) / np.linalg.norm(q, axis=0)
        rows = [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
        return np.moveaxis(np.array(rows), -1, 0)

    def positions_in_view(self, count: int, lowest: float, highest: float) -> Floats:
        """Draw world positions, even in the image; half are even in disparity (px)."""
        rng = self.rng
        disparity = np.where(
            rng.random(count) < 0.5,
            rng.uniform(lowest, highest, count),
            self.log_uniform(lowest, highest, count),
        )
        depth = self.focal * self.baseline / disparity
        column, row = rng.uniform(-0.1, 1.1, (2, count)) * [[self.width], [self.height]]
        ray = np.stack(
            [(column - self.cx) / self.focal, (row - self.cy) / self.focal, np.ones(count)], -1
        )
        world: Floats = ray * depth[:, None] @ self.rotation
        return world

    def depths(self, centre: Floats) -> Floats:
        """Distances along the optical axis, at least ``near`` / 2."""
        ahead: Floats = np.maximum(centre @ self.rotation[2], 0.5 * self.near)
        return ahead

    def scene(self, kind: str, outdoors: bool) -> Scene:
        """Assemble the scene, under a light that suits it."""
        rng = self.rng
        far = 300.0 if outdoors else self.log_uniform(1.0, 3.0) * self.near
        towards = rng.normal(size=3) * [1.0, 0.4, 0.7] + [0, -0.9, -0.6]
        focus = np.array([0, 0, 2.5 * self.near])
        light = focus + self.rotation @ (towards / np.linalg.norm(towards) * far)
        if self.lamp is not None:
            light = self.rotation @ self.lamp
        return Scene(
            focal=self.focal,
            cx=self.cx,
            cy=self.cy,
            baseline=self.baseline,
            light=light,
            focus=focus,
            spread=2.5 * self.near,
            ambient=rng.uniform(0.3, 0.7),
            diffuse=rng.uniform(0.3, 1.0),
            reach=1e4 if outdoors else far * self.log_uniform(1.5, 8),
            shininess=self.log_uniform(4, 60),
            brightness=rng.uniform(0.2, 0.48),
            surfaces=self._surfaces(),
            kind=kind,
            surroundings=self.surroundings,
        )
