"""Layout of a furnished room."""

from __future__ import annotations

import numpy as np

from mobilestereonet.scenes.builder import SceneBuilder, yaw_rotations
from mobilestereonet.scenes.noise import WOOD
from mobilestereonet.scenes.objects import (
    UPRIGHT,
    add_floating_objects,
    add_shelves,
    add_standing_objects,
    add_tables,
    scale_axes,
    stack_xyz,
)
from mobilestereonet.scenes.scene import Floats


class _Room:
    """Room around the camera: a box with pictures, furniture and a lamp.

    Args:
        build: Builder that it is added to.
    """

    def __init__(self, build: SceneBuilder) -> None:
        self.build, rng = build, build.rng
        self.wide, deep = rng.uniform([1.6, 2.5], [4.0, 6.0]) * max(build.near, 1.0)
        self.below, self.above = rng.uniform([0.8, 0.9], [1.7, 2.0])
        self.half = 0.5 * deep + 0.6
        self.heading = yaw_rotations(rng.uniform(-0.7, 0.7))[0]
        self.right, self.down, self.ahead = self.heading.T
        # At the height of the camera.
        self.middle = self.heading @ [rng.uniform(-0.5, 0.5) * self.wide, 0, self.half - 0.9]

    def walls(self) -> None:
        """Four walls of one material, floor, ceiling; pictures, windows and doors on the walls."""
        build, rng = self.build, self.build.rng
        tall = 0.5 * (self.below + self.above)
        x, z = self.wide * self.right, self.half * self.ahead
        centre = self.middle + 0.5 * (self.below - self.above) * self.down
        around = centre + np.array([-x, x, -z, z])
        sides = np.array([z, z, x, x])
        material = build.draw_materials(1, 1.4 * self.half)[np.zeros(4, int)]
        build.add_rectangles(around, sides, np.tile(tall * self.down, (4, 1)), material)
        for level, kind in (
            (self.below, WOOD if rng.random() < 0.4 else None),
            (-self.above, None),
        ):
            at = (self.middle + level * self.down)[None]
            build.add_rectangles(at, x[None], z[None], build.draw_materials(1, self.half, kind))
        number = int(rng.integers(3, 10))
        side = rng.integers(0, 4, number)
        inward = np.array([self.right, -self.right, self.ahead, -self.ahead])[side]
        at = around[side] + sides[side] * rng.uniform(-0.85, 0.85, (number, 1))
        at += self.down * tall * rng.uniform(-0.6, 0.3, (number, 1))
        at += inward * rng.uniform(0.01, 0.06, (number, 1))
        along = sides[side] / np.linalg.norm(sides[side], axis=1, keepdims=True)
        size = rng.uniform(0.15, 0.6, (2, number, 1))
        pictures = build.draw_materials(number, build.depths(at))
        build.add_rectangles(at, along * size[0], self.down * size[1], pictures)

    def floor(self, count: int, edge: float) -> tuple[Floats, Floats]:
        """Draw points on the floor, at the walls as ``edge`` nears 1, and yaws (n, 3, 3)."""
        rng = self.build.rng
        across = rng.choice([-1, 1], count) * rng.uniform(edge, 0.93, count) * self.wide
        along = rng.uniform(-0.4, 0.9, count) * self.half
        at = self.middle + stack_xyz(across, self.below, along) @ self.heading.T
        quarter = rng.choice([0, np.pi / 2, -np.pi / 2], count)
        yaw = self.heading @ yaw_rotations(quarter + rng.normal(0, 0.1, count))
        keep = at @ self.build.rotation[2] > self.build.near + 0.4
        return at[keep], yaw[keep]

    def lamp(self) -> None:
        """A lamp below the ceiling, with a shade above it."""
        build = self.build
        x, z = build.rng.uniform(-0.4, 0.4, 2) * [self.wide, self.half]
        build.lamp = self.middle + self.heading @ [x, 0.5 - self.above, z]
        shade = (build.lamp - 0.3 * self.down)[None]
        size = np.full((1, 3), 0.2)
        build.add_quadrics(
            shade, scale_axes(UPRIGHT[None], size), build.draw_materials(1, build.depths(shade))
        )


def room(build: SceneBuilder) -> None:
    """Fill a room: furniture, tables, pictures, a lamp, and floating objects."""
    rng = build.rng
    place = _Room(build)
    place.walls()
    add_tables(build, *place.floor(int(rng.integers(1, 4)), 0.0))
    add_shelves(build, *place.floor(int(rng.integers(0, 3)), 0.85))
    at, _ = place.floor(int(rng.integers(6, 18)), 0.2)
    add_standing_objects(build, at, rng.uniform(0.2, 1.7, len(at)), rng.uniform(0.2, 0.9, len(at)))
    place.lamp()
    add_floating_objects(build, 0.3 * build.nearest, share=rng.uniform(0, 0.3))
