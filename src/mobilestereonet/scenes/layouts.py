"""Layouts of scenes: rooms, streets, parks, table tops, floating clutter, slanted planes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from mobilestereonet.scenes.builder import SceneBuilder, yaw_rotations
from mobilestereonet.scenes.noise import ASPHALT, GRASS, SKY, WINDOWS, WOOD
from mobilestereonet.scenes.objects import (
    UPRIGHT,
    add_bushes,
    add_cars,
    add_fences,
    add_floating_objects,
    add_people,
    add_poles,
    add_shelves,
    add_standing_objects,
    add_tables,
    add_trees,
    scale_axes,
    stack_xyz,
)
from mobilestereonet.scenes.scene import Floats


def _add_backdrop(
    build: SceneBuilder, depth: float, kind: int | None = None, tilt: float = 0.0
) -> None:
    """Add a wall across the whole view, perpendicular to the optical axis up to ``tilt``."""
    view = max(build.width, build.height) / build.focal
    half = 6 * depth * view + 2 * build.baseline
    tilt = min(tilt, float(np.arctan(1.1 / view)))  # a wide view would look past its end
    x, y, _ = half * (build.rotation.T @ yaw_rotations(build.rng.uniform(-tilt, tilt))[0]).T
    centre = build.rotation[2] * depth
    build.add_rectangles(centre[None], x[None], y[None], build.draw_materials(1, depth, kind))


def _add_ground(
    build: SceneBuilder, below: float, far: float, kind: int | None, depth: float
) -> None:
    """Add a level plane ``below`` the camera, textured as seen from ``depth``."""
    material = build.draw_materials(1, depth, kind)
    build.add_rectangles(
        stack_xyz(0, below, 0), stack_xyz(far, 0, 0), stack_xyz(0, 0, far), material
    )


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
    _add_backdrop(build, 12 * road.far, SKY)
    kind = int(rng.choice([ASPHALT, GRASS]))
    _add_ground(build, road.below, 14 * road.far, kind, 1.5 * build.near)
    road.surface()
    for side in (-1, 1):
        road.side(side)
    number = int(rng.integers(0, 4))
    ahead = road.at(rng.uniform(-0.6, 0.6, number) * road.half, 0, road.along(number, 1.8, 60))
    add_cars(build, ahead, road.heading @ yaw_rotations(rng.normal(0, 0.1, number)))


def park(build: SceneBuilder) -> None:
    """Fill a park: open ground with hills, rocks, bushes, trees, people, huts and fences."""
    rng = build.rng
    below, far = rng.uniform(1.0, 2.5), build.log_uniform(30, 150)
    _add_backdrop(build, 10 * far, SKY)
    _add_ground(build, below, 12 * far, int(rng.choice([GRASS, ASPHALT])), 1.5 * build.near)

    def ground(lowest: int, highest: int, nearest: float, farthest: float) -> Floats:
        number = int(rng.integers(lowest, highest))
        z = build.log_uniform(nearest * build.near, farthest * far, number)
        return stack_xyz(z * rng.uniform(-0.7, 0.7, number) * build.width / build.focal, below, z)

    at = ground(3, 9, 6, 1)
    size = build.depths(at)[:, None] * rng.uniform(0.1, 0.5, (len(at), 1))
    size = size * rng.uniform([0.6, 0.6, 0.1], [1.5, 1.5, 0.4], (len(at), 3))
    hill = build.draw_materials(len(at), build.depths(at), GRASS)
    build.add_quadrics(at, scale_axes(np.tile(UPRIGHT, (len(at), 1, 1)), size), hill)
    at = ground(4, 14, 1, 0.3)
    size = rng.uniform(0.1, 0.9, (len(at), 1)) * rng.uniform(0.4, 1, (len(at), 3))
    rock = build.draw_materials(len(at), build.depths(at))
    build.add_quadrics(at, scale_axes(build.random_rotations(len(at)), size), rock)
    at = ground(6, 20, 1, 0.3) - stack_xyz(0, 0.3, 0)
    leaves = build.draw_materials(len(at), build.depths(at), GRASS)
    add_bushes(build, at, rng.uniform(0.3, 0.9, len(at)), leaves)
    add_trees(build, ground(2, 9, 1.3, 0.6))
    add_people(build, ground(0, 5, 1.3, 0.3))
    at = ground(0, 5, 1.5, 0.4)
    half = rng.uniform(1, 4, (len(at), 3))
    yaw = yaw_rotations(rng.uniform(-2, 2, len(at)))
    wall = build.draw_materials(len(at), build.depths(at), WINDOWS)
    build.add_boxes(at - stack_xyz(0, half[:, 1], 0), scale_axes(yaw, half), wall)
    at = ground(0, 4, 1.2, 0.3)
    step = rng.uniform(-5, 5, (len(at), 3)) * [1, 0, 1]
    add_fences(build, at, step, rng.uniform(0.8, 2, len(at)))


def table(build: SceneBuilder) -> None:
    """Fill a table top before a wall, seen from slightly above, with objects."""
    rng, near = build.rng, build.near
    deep = near * rng.uniform(0.6, 2.0)
    below = near * (np.tan(build.pitch) + 0.5 * build.height / build.focal) * rng.uniform(0.85, 1.1)
    _add_backdrop(build, near + deep + rng.uniform(0.05, 1.0) * near, tilt=0.5)
    kind = WOOD if rng.random() < 0.3 else None
    _add_ground(build, below, 4 * (near + deep), kind, near + 0.4 * deep)
    number = int(rng.integers(18, 45))
    z = near + deep * rng.uniform(0.03, 1, number)
    x = z * rng.uniform(-0.6, 0.6, number) * build.width / build.focal
    tall, wide = near * build.log_uniform(0.05, 0.4, (2, number))
    add_standing_objects(build, stack_xyz(x, below, z), tall * rng.uniform(0.8, 2.0, number), wide)
    # A pile of books.
    half = near * rng.uniform([0.08, 0.01, 0.06], [0.2, 0.03, 0.15], (int(rng.integers(0, 6)), 3))
    up = np.cumsum(2 * half[:, 1]) - half[:, 1]
    at = stack_xyz(rng.uniform(-0.5, 0.5) * near, below - up, near + rng.uniform(0.3, 0.9) * deep)
    yaw = yaw_rotations(rng.normal(0, 0.2, len(half)))
    build.add_boxes(at, scale_axes(yaw, half), build.draw_materials(len(half), build.depths(at)))
    add_floating_objects(build, 0.5 * build.nearest, share=rng.uniform(0, 0.2))


def clutter(build: SceneBuilder) -> None:
    """Fill a scene with objects in mid-air before a far wall, sometimes over a ground."""
    rng = build.rng
    lowest = build.nearest * build.log_uniform(0.03, 0.3)
    far = build.near * build.nearest / lowest
    _add_backdrop(build, far, tilt=0.6)
    if rng.random() < 0.4:
        _add_ground(build, rng.uniform(0.4, 1.2) * build.near, far, None, 1.5 * build.near)
    add_floating_objects(build, lowest, share=1)


def planes(build: SceneBuilder) -> None:
    """Fill a scene with a few large slanted planes and little else."""
    rng = build.rng
    lowest = build.nearest * rng.uniform(0.1, 0.6)
    _add_backdrop(build, build.near * build.nearest / lowest, tilt=0.9)
    number = int(rng.integers(1, 4))
    centre = build.positions_in_view(number, lowest, 0.7 * build.nearest)
    depth = build.depths(centre)
    half = depth * build.width / build.focal * rng.uniform(0.25, 0.7, number)
    turn = build.rotation.T @ yaw_rotations(rng.uniform(-1.1, 1.1, number))
    turn = turn * np.minimum(half, 0.8 * depth)[:, None, None]
    lean = rng.uniform(-0.9, 0.9, (number, 1))
    y = turn[..., 1] * np.cos(lean) + turn[..., 2] * np.sin(lean)
    build.add_rectangles(centre, turn[..., 0], y, build.draw_materials(number, depth))
    add_floating_objects(build, lowest, share=0.2)


@dataclass(frozen=True)
class Layout:
    """Kind of scene: what stands where, and the cameras that suit it.

    Attributes:
        fill: Adds the scene's objects to a builder.
        near: Range of the distance of the nearest objects, in metres.
        pitch: Range of the camera's pitch, in radians, down positive.
        outdoors: Whether the light is the sun.
    """

    fill: Callable[[SceneBuilder], None]
    near: tuple[float, float]
    pitch: tuple[float, float]
    outdoors: bool = False


LAYOUTS = {
    "room": Layout(room, (0.8, 1.8), (-0.15, 0.35)),
    "street": Layout(street, (4.0, 8.0), (-0.06, 0.1), outdoors=True),
    "park": Layout(park, (2.5, 7.0), (-0.06, 0.2), outdoors=True),
    "table": Layout(table, (0.5, 2.0), (0.1, 0.9)),
    "clutter": Layout(clutter, (1.0, 3.0), (-0.1, 0.1)),
    "planes": Layout(planes, (1.0, 3.0), (-0.1, 0.1)),
}
