"""Layouts of scenes: rooms, streets, parks, table tops, floating clutter, slanted planes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from mobilestereonet.scenes.builder import SceneBuilder, yaw_rotations
from mobilestereonet.scenes.noise import ASPHALT, GRASS, SKY, WINDOWS, WOOD
from mobilestereonet.scenes.objects import (
    UPRIGHT,
    add_backdrop,
    add_bushes,
    add_fences,
    add_floating_objects,
    add_ground,
    add_people,
    add_standing_objects,
    add_trees,
    scale_axes,
    stack_xyz,
)
from mobilestereonet.scenes.room import room
from mobilestereonet.scenes.scene import Floats
from mobilestereonet.scenes.street import street


def park(build: SceneBuilder) -> None:
    """Fill a park: open ground with hills, rocks, bushes, trees, people, huts and fences."""
    rng = build.rng
    below, far = rng.uniform(1.0, 2.5), build.log_uniform(30, 150)
    add_backdrop(build, 10 * far, SKY)
    add_ground(build, below, 12 * far, int(rng.choice([GRASS, ASPHALT])), 1.5 * build.near)

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
    add_backdrop(build, near + deep + rng.uniform(0.05, 1.0) * near, tilt=0.5)
    kind = WOOD if rng.random() < 0.3 else None
    add_ground(build, below, 4 * (near + deep), kind, near + 0.4 * deep)
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
    add_backdrop(build, far, tilt=0.6)
    if rng.random() < 0.4:
        add_ground(build, rng.uniform(0.4, 1.2) * build.near, far, None, 1.5 * build.near)
    add_floating_objects(build, lowest, share=1)


def planes(build: SceneBuilder) -> None:
    """Fill a scene with a few large slanted planes and little else."""
    rng = build.rng
    lowest = build.nearest * rng.uniform(0.1, 0.6)
    add_backdrop(build, build.near * build.nearest / lowest, tilt=0.9)
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
