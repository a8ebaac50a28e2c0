"""Layout of a street."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from mobilestereonet.scenes.builder import SceneBuilder, yaw_rotations
from mobilestereonet.scenes.noise import ASPHALT, GRASS, SKY, WINDOWS
from mobilestereonet.scenes.objects import (
    add_backdrop,
    add_cars,
    add_fences,
    add_ground,
    add_people,
    add_poles,
    add_trees,
    scale_axes,
    stack_xyz,
)
from mobilestereonet.scenes.scene import Floats


class _Road:
    """Straight road with what stands beside it; x counts from its middle, z ahead.

    Args:
        build: Builder that it is added to.
    """

    def __init__(self, build: SceneBuilder) -> None:
        self.build, rng = build, build.rng
        yaw = rng.normal(0, 0.12) if rng.random() < 0.8 else rng.uniform(-0.8, 0.8)
        self.heading = yaw_rotations(yaw)[0]
        self.far = build.log_uniform(60, 250)
        self.below, self.half = rng.uniform([1.2, 2.5], [2.6, 7.0])
        self.shift = rng.uniform(-0.6, 0.6) * self.half

    def at(self, x: ArrayLike, above: ArrayLike, z: ArrayLike) -> Floats:
        """World positions (n, 3)."""
        shifted = np.asarray(x) + self.shift
        world: Floats = stack_xyz(shifted, self.below - np.asarray(above), z) @ self.heading.T
        return world

    def along(self, count: int, nearest: float, farthest: float) -> Floats:
        """Draw distances, even in the logarithm, from ``nearest`` times near."""
        drawn: Floats = self.build.log_uniform(nearest * self.build.near, farthest, count)
        return drawn

    def surface(self) -> None:
        """Asphalt and a dashed line."""
        build = self.build
        right, _, ahead = self.heading.T[:, None]
        material = build.draw_materials(1, 2 * build.near, ASPHALT)
        middle = self.at(0, 0.02, self.far / 2)
        build.add_rectangles(middle, self.half * right, self.far * ahead, material)
        dashes = np.arange(2, 74, 9.0)
        paint = build.draw_materials(1, 2 * build.near, ASPHALT)[np.zeros(len(dashes), int)]
        paint.colour *= 2
        at = self.at(build.rng.choice([0, self.half / 3]), 0.03, dashes)
        build.add_rectangles(at, 0 * at + 0.07 * right, 0 * at + ahead, paint)

    def facades(self, side: int, start: float) -> None:
        """Houses, walls or hedges beyond ``start`` metres from the middle; sometimes nothing."""
        build, rng = self.build, self.build.rng
        style = rng.random()
        number = int(rng.integers(4, 11)) if style < 0.92 else 0
        z = np.cumsum(build.log_uniform(6, 30, number)) - 10
        deep = np.diff(z, append=z[-1:] + 20) / 2 * rng.uniform(0.7, 1.0, number)
        low, high = (2.5, 16) if style < 0.75 else (0.8, 3)
        tall, wide = build.log_uniform(low, high, number), rng.uniform(3, 9, number)
        away = start + wide + rng.uniform(0, 5) * rng.random(number)
        seen_from = np.maximum(z, 1.5 * build.near)
        material = build.draw_materials(number, seen_from, WINDOWS if style < 0.5 else None)
        axes = scale_axes(self.heading[None], np.stack([wide, tall, deep], -1))
        build.add_boxes(self.at(side * away, tall, z), axes, material)

    def side(self, side: int) -> None:
        """Pavement, facades, trees, parked cars, poles, people and a fence on one side."""
        build, rng = self.build, self.build.rng
        walk = rng.uniform(1.5, 4)
        kerb = self.half
        size = np.array([[walk, 0.12, self.far]])
        slab = build.draw_materials(1, 2 * build.near)
        build.add_boxes(
            self.at(side * (kerb + walk), 0, self.far / 2),
            scale_axes(self.heading[None], size),
            slab,
        )
        self.facades(side, kerb + 2 * walk)
        number = rng.integers([0, 0, 1, 0], [7, 6, 6, 4])
        x = kerb + walk * rng.uniform(0.3, 2, number[0])
        add_trees(build, self.at(side * x, 0, self.along(number[0], 1.5, self.far / 2)))
        x = kerb - 1.1 + rng.normal(0, 0.2, number[1])
        turned = yaw_rotations(rng.choice([0, np.pi], number[1]) + rng.normal(0, 0.05, number[1]))
        parked = self.at(side * x, 0, self.along(number[1], 1.3, self.far / 2))
        add_cars(build, parked, self.heading @ turned)
        x = kerb + rng.uniform(0.5, 0.8, number[2])
        add_poles(build, self.at(side * x, 0, self.along(number[2], 1, self.far / 2)))
        x = kerb + walk * rng.uniform(0, 2, number[3])
        add_people(build, self.at(side * x, 0, self.along(number[3], 1.2, self.far / 4)))
        if rng.random() < 0.4:
            start = self.at(side * (kerb + 1.6 * walk), 0, build.near + 6.0 * np.arange(4))
            tall = np.full(4, rng.uniform(0.8, 2))
            add_fences(build, start, 0 * start + 6 * self.heading[:, 2], tall)


def street(build: SceneBuilder) -> None:
    """Fill a street: a road between facades or hedges, cars, poles, trees, people, sky."""
    rng = build.rng
    road = _Road(build)
    add_backdrop(build, 12 * road.far, SKY)
    kind = int(rng.choice([ASPHALT, GRASS]))
    add_ground(build, road.below, 14 * road.far, kind, 1.5 * build.near)
    road.surface()
    for side in (-1, 1):
        road.side(side)
    number = int(rng.integers(0, 4))
    ahead = road.at(rng.uniform(-0.6, 0.6, number) * road.half, 0, road.along(number, 1.8, 60))
    add_cars(build, ahead, road.heading @ yaw_rotations(rng.normal(0, 0.1, number)))
