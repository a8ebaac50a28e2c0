"""A scene as data, and the builder that places textured surfaces in it.

Everything is drawn from one NumPy generator and kept as small arrays in metres. World frame: x to
the right, y down, z ahead, origin at the left camera; the builder turns it into the camera's
frame (the camera pitches and rolls, the right camera stands ``baseline`` along the camera's x).
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mobilestereonet.data.synthetic.textures import MASKS, NOISE

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

RECTANGLE, MASKED, QUADRIC = range(3)
# x^2 + y^2 + a z^2 + b z + c = 0 with |z| <= 1.
SPHERE = (1.0, 0.0, -1.0)
CYLINDER = (0.0, 0.0, -1.0)
CONE = (-0.25, 0.5, -0.25)  # its tip at z = 1
BARREL = (0.5, 0.0, -1.0)
VASE = (-0.6, 0.0, -0.4)
BOWL = (0.0, 0.5, -0.5)


@dataclass(frozen=True)
class Surfaces:
    """The surfaces of one scene in the left camera's frame; n of them.

    Attributes:
        shape: RECTANGLE, MASKED or QUADRIC, (n,).
        centre: Centre in metres, (n, 3).
        axes: Half axes in metres as columns; a rectangle's third is its unit normal, (n, 3, 3).
        quadric: a, b, c of a quadric, (n, 3).
        mask: Index of the mask of a MASKED one, (n,).
        mask_repeat: How often the mask repeats along x and y, (n, 2).
        texture: Index in the texture bank, (n,).
        texels: Local x and y (a quadric: angle and z) to texels, (n, 2, 3).
        density: Texels per metre, (n,).
        colour: Factor on the texture's colour, (n, 3).
        contrast: Factor on the texture's departure from its mean, (n,).
        gloss: Strength of the highlight, (n,).
    """

    shape: Ints
    centre: Floats
    axes: Floats
    quadric: Floats
    mask: Ints
    mask_repeat: Floats
    texture: Ints
    texels: Floats
    density: Floats
    colour: Floats
    contrast: Floats
    gloss: Floats


@dataclass(frozen=True)
class Scene:
    """One scene: cameras, light and surfaces.

    Attributes:
        focal: Focal length in pixels.
        cx: Column of the principal point.
        cy: Row of the principal point.
        baseline: Distance of the cameras, in metres.
        light: Position of the lamp in the camera's frame, in metres.
        focus: Middle of the region in which the lamp casts shadows, in the camera's frame.
        spread: Radius of that region, in metres.
        ambient: Light that comes from everywhere.
        diffuse: Light of the lamp, before falloff.
        reach: Distance in metres at which the lamp is half as bright.
        shininess: Exponent of the highlights.
        brightness: Geometric mean of the images, as an automatic exposure would set it.
        surfaces: What there is to see.
        kind: Name of the layout.
    """

    focal: float
    cx: float
    cy: float
    baseline: float
    light: Floats
    focus: Floats
    spread: float
    ambient: float
    diffuse: float
    reach: float
    shininess: float
    brightness: float
    surfaces: Surfaces
    kind: str


@dataclass
class Material:
    """What n surfaces are made of; the fields are those of ``Surfaces``."""

    texture: Ints
    density: Floats
    angle: Floats
    colour: Floats
    contrast: Floats
    gloss: Floats

    def __getitem__(self, which: Any) -> Material:
        """The material of some of the surfaces."""
        return Material(*(getattr(self, field.name)[which] for field in fields(self)))


def turns(angles: ArrayLike) -> Floats:
    """Rotations about the vertical, (n, 3, 3)."""
    angles = np.atleast_1d(np.asarray(angles, dtype=np.float64))
    result = np.zeros((len(angles), 3, 3))
    result[:, 0, 0] = result[:, 2, 2] = np.cos(angles)
    result[:, 0, 2] = np.sin(angles)
    result[:, 2, 0] = -np.sin(angles)
    result[:, 1, 1] = 1
    return result


class Builder:
    """Draws a scene's parts and collects them.

    Args:
        rng: The scene's generator.
        size: Height and width of the images, in pixels.
        nearest: Disparity of the nearest things, in pixels.
        near: Their distance, in metres.
        pitch: Range of the camera's pitch (down is positive), in radians.
        noise: How many textures of the bank are noise.
        photographs: How many textures of the bank are photographs.
        masks: How many masks there are.
    """

    def __init__(
        self,
        rng: np.random.Generator,
        size: tuple[int, int],
        nearest: float,
        near: float,
        pitch: tuple[float, float],
        *,
        noise: int,
        photographs: int,
        masks: int,
    ) -> None:
        self.rng = rng
        self.height, self.width = size
        self.near, self.nearest = near, nearest
        self.noise, self.photographs, self.masks = noise, photographs, masks
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
        self.parts: list[Surfaces] = []

    def log_uniform(self, low: float, high: float, size: Any = None) -> Any:
        """Numbers whose logarithm is uniform."""
        return np.exp(self.rng.uniform(np.log(low), np.log(high), size))

    def material(self, count: int, depth: ArrayLike, kind: int | None = None) -> Material:
        """Materials of surfaces that are seen from ``depth`` metres.

        Photographs three times in four if there are any, else any noise; ``kind`` asks for one
        kind of noise (or, when there are photographs, sometimes still for one of them).
        """
        rng = self.rng
        cycles = max(1, self.noise // len(NOISE))
        noise = rng.integers(0, self.noise, count)
        if kind is not None:
            noise = np.minimum(kind + len(NOISE) * rng.integers(0, cycles, count), self.noise - 1)
        chance = 0.0 if not self.photographs else 0.75 if kind is None else 0.5
        photograph = self.noise + rng.integers(0, max(self.photographs, 1), count)
        texture = np.where(rng.random(count) < chance, photograph, noise)
        strength = rng.random(count)
        contrast = rng.uniform(0.7, 1.15, count)
        contrast = np.where(strength < 0.3, rng.uniform(0.25, 0.7, count), contrast)
        contrast = np.where(strength < 0.2, self.log_uniform(0.01, 0.25, count), contrast)
        tint = rng.choice([0.0, 0.06, 0.2], (count, 1)) * rng.uniform(-1, 1, (count, 3))
        colour = self.log_uniform(0.55, 1.6, (count, 1)) * (1 + tint)
        gloss = np.where(rng.random(count) < 0.2, rng.uniform(0.05, 0.4, count), 0.0)
        density = self.focal / np.asarray(depth) * self.log_uniform(0.5, 2.5, count)
        angle = np.where(
            rng.random(count) < 0.7, rng.normal(0, 0.03, count), rng.uniform(0, 6.28, count)
        )
        return Material(texture, density, angle, colour, contrast, gloss)

    def add(
        self,
        shape: int,
        centre: Floats,
        axes: Floats,
        material: Material,
        *,
        quadric: ArrayLike = SPHERE,
        mask: ArrayLike = 0,
        mask_repeat: ArrayLike = 1.0,
    ) -> None:
        """Add n surfaces of one shape, given in the world frame."""
        count = len(centre)
        centre, axes = centre @ self.rotation.T, self.rotation @ axes
        lengths = np.linalg.norm(axes, axis=1)
        if shape == QUADRIC:
            extent = np.stack([0.5 * (lengths[:, 0] + lengths[:, 1]), lengths[:, 2]], -1)
        else:
            extent = lengths[:, :2]
        cos, sin = np.cos(material.angle), np.sin(material.angle)
        spin = np.stack([np.stack([cos, -sin], -1), np.stack([sin, cos], -1)], -2)
        texels = np.empty((count, 2, 3))
        texels[:, :, :2] = material.density[:, None, None] * spin * extent[:, None]
        texels[:, :, 2] = self.rng.uniform(0, 1024, (count, 2))
        self.parts.append(
            Surfaces(
                shape=np.full(count, shape),
                centre=centre,
                axes=axes,
                quadric=np.broadcast_to(np.asarray(quadric, dtype=np.float64), (count, 3)),
                mask=np.broadcast_to(np.asarray(mask, dtype=np.int64), (count,)),
                mask_repeat=np.broadcast_to(np.asarray(mask_repeat, dtype=np.float64), (count, 2)),
                texture=material.texture,
                texels=texels,
                density=material.density,
                colour=material.colour,
                contrast=material.contrast,
                gloss=material.gloss,
            )
        )

    def rectangles(
        self, centre: Floats, x: Floats, y: Floats, material: Material, **how: Any
    ) -> None:
        """Rectangles with half axes ``x`` and ``y``, each (n, 3)."""
        normal = np.cross(x, y)
        normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
        shape = MASKED if "mask" in how else RECTANGLE
        self.add(shape, centre, np.stack([x, y, normal], -1), material, **how)

    def boxes(self, centre: Floats, axes: Floats, material: Material) -> None:
        """Boxes with half axes as columns (right, down, ahead); only the faces seen are kept."""
        eyes = np.array([[0, 0, 0], [self.baseline, 0, 0]]) @ self.rotation
        for axis, (x, y) in enumerate(((2, 1), (0, 2), (0, 1))):
            for sign in (-1, 1):
                middle = centre + sign * axes[:, :, axis]
                outward = ((eyes - middle[:, None]) * sign * axes[:, None, :, axis]).sum(-1)
                seen = (outward > 0).any(1)
                if seen.any():
                    self.rectangles(
                        middle[seen], axes[seen, :, x], axes[seen, :, y], material[seen]
                    )

    def quadrics(
        self, centre: Floats, axes: Floats, material: Material, kind: ArrayLike = SPHERE
    ) -> None:
        """Quadrics with half axes as columns; ``kind`` is one or n of SPHERE, CYLINDER ..."""
        self.add(QUADRIC, centre, axes, material, quadric=kind)

    def pick_masks(self, count: int, *kinds: int) -> Ints:
        """Indices of masks, of any or of the given kinds."""
        choice = self.rng.choice(kinds or range(len(MASKS)), count)
        cycles = self.masks // len(MASKS)
        return choice + len(MASKS) * self.rng.integers(0, cycles, count)

    def rotations(self, count: int) -> Floats:
        """Uniformly random rotations, (n, 3, 3)."""
        w, x, y, z = (q := self.rng.normal(size=(4, count))) / np.linalg.norm(q, axis=0)
        rows = [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
        return np.moveaxis(np.array(rows), -1, 0)

    def in_view(self, count: int, lowest: float, highest: float) -> Floats:
        """World positions that are even in the image and, by half, in disparity (px)."""
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
        return ray * depth[:, None] @ self.rotation

    def depth(self, centre: Floats) -> Floats:
        """Distance along the optical axis, at least ``near`` / 2."""
        return np.maximum(centre @ self.rotation[2], 0.5 * self.near)

    def finish(self, kind: str, outdoors: bool) -> Scene:
        """The scene, under a light that suits it."""
        rng = self.rng
        far = 300.0 if outdoors else self.log_uniform(1.0, 3.0) * self.near
        towards = rng.normal(size=3) * [1.0, 0.4, 0.7] + [0, -0.9, -0.6]
        focus = np.array([0, 0, 2.5 * self.near])
        light = focus + self.rotation @ (towards / np.linalg.norm(towards) * far)
        if self.lamp is not None:
            light = self.rotation @ self.lamp
        joined = {
            field.name: np.concatenate([getattr(part, field.name) for part in self.parts])
            for field in fields(Surfaces)
        }
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
            brightness=rng.uniform(0.18, 0.48),
            surfaces=Surfaces(**joined),
            kind=kind,
        )
