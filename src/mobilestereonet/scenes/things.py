"""Things to put into a scene: floating shapes, furniture, cars, trees, poles, people, fences."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from mobilestereonet.scenes.builder import Builder, Material, turns
from mobilestereonet.scenes.masks import BARS, FOLIAGE, MESH
from mobilestereonet.scenes.noise import ASPHALT, GRASS, WOOD
from mobilestereonet.scenes.scene import (
    BARREL,
    BOWL,
    CONE,
    CYLINDER,
    SPHERE,
    VASE,
    Floats,
)

UPRIGHT = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])  # columns: a quadric's z axis points up
SIDEWAYS = np.array([[0, 0, 1.0], [0, 1, 0], [-1, 0, 0]])  # ... to the left
OPEN = np.array([CYLINDER, CYLINDER, CONE, BARREL, VASE, BOWL])
QUADRICS = np.array([SPHERE, SPHERE, *OPEN])


def points(x: ArrayLike, y: ArrayLike, z: ArrayLike) -> Floats:
    """Coordinates, numbers or (n,), as (n, 3)."""
    columns = np.broadcast_arrays(*(np.atleast_1d(np.asarray(c, np.float64)) for c in (x, y, z)))
    return np.stack(columns, -1)


def sized(directions: Floats, half: Floats) -> Floats:
    """Half axes as columns: rotations (n, 3, 3) times half sizes (n, 3)."""
    return directions * half[:, None, :]


def columns(
    build: Builder,
    foot: Floats,
    radius: Floats,
    height: Floats,
    material: Material,
    kind: ArrayLike = CYLINDER,
) -> None:
    """Round things (n of one or more quadrics) that stand on the points ``foot``."""
    size = np.stack([radius, radius, height / 2], -1)
    axes = sized(np.tile(UPRIGHT, (len(foot), 1, 1)), size)
    build.quadrics(foot - points(0, height / 2, 0), axes, material, kind)


def floaters(build: Builder, lowest: float, *, share: float) -> None:
    """Things of every shape in mid-air, even in the image and in disparity.

    Args:
        build: Where they are added.
        lowest: Disparity of the farthest, in pixels.
        share: How many there are, as a part of those in a scene of clutter.
    """
    rng, highest = build.rng, build.nearest
    count = round(share * rng.integers(build.objects[0], build.objects[1] + 1))
    for kind, number in enumerate(rng.multinomial(count, [0.2, 0.25, 0.2, 0.2, 0.15])):
        centre = build.in_view(number, lowest, highest)
        depth = build.depth(centre)
        radius = build.log_uniform(5, 0.22 * build.width, number) * depth / build.focal
        half = np.minimum(radius, 0.35 * depth)[:, None] * build.log_uniform(0.35, 1, (number, 3))
        axes = sized(build.rotations(number), half)
        material = build.material(number, depth)
        if kind == 0:
            build.boxes(centre, axes, material)
        elif kind == 1:
            build.quadrics(centre, axes, material, rng.choice(QUADRICS, number))
        elif kind == 2:
            build.rectangles(centre, axes[..., 0], axes[..., 1], material)
        elif kind == 3:
            holes = {
                "mask": build.pick_masks(number),
                "mask_repeat": rng.choice([1.0, 1.0, 2.0, 3.0], (number, 1)),
            }
            build.rectangles(centre, axes[..., 0], axes[..., 1], material, **holes)
        else:
            rod = np.maximum(1.0, build.log_uniform(0.7, 6, number)) * depth / build.focal
            axes[..., :2] *= (rod[:, None] / half[:, :2])[:, None]
            build.quadrics(centre, axes, material, CYLINDER)


def standing(build: Builder, ground: Floats, height: Floats, width: Floats) -> None:
    """Boxes, vessels, cones, balls and cards on the ground at the points ``ground``."""
    rng = build.rng
    kinds = rng.choice(5, len(ground), p=[0.4, 0.22, 0.13, 0.13, 0.12])
    whole = np.stack([width, height, width * rng.uniform(0.4, 1.3, len(width))], -1)
    for kind in range(5):
        half = whole[kinds == kind] / 2
        number = len(half)
        top = ground[kinds == kind] - points(0, 2 * half[:, 1], 0)
        centre = top + points(0, half[:, 1], 0)
        yaw = turns(rng.uniform(-np.pi, np.pi, number))
        material = build.material(number, build.depth(centre))
        upright = sized(yaw @ UPRIGHT, half[:, [0, 2, 1]])
        if kind == 0:
            build.boxes(centre, sized(yaw, half), material)
        elif kind == 1:
            build.quadrics(centre, upright, material, rng.choice(OPEN, number))
            lid = rng.random(number) < 0.7
            build.quadrics(top[lid], upright[lid] * [1, 1, 0.02], material[lid])
        elif kind == 2:
            build.quadrics(centre, upright, material, CONE)
        elif kind == 3:
            build.quadrics(centre, upright, material)
        else:
            lean = 0.3 * half[:, 1:2] * yaw[..., 2] * rng.uniform(-1, 1, (number, 1))
            x, y = yaw[..., 0] * half[:, :1], yaw[..., 1] * half[:, 1:2] + lean
            holes = {"mask": build.pick_masks(number)} if rng.random() < 0.5 else {}
            build.rectangles(centre, x, y, material, **holes)


def tables(build: Builder, ground: Floats, yaw: Floats) -> None:
    """Table tops on four legs, with things on them."""
    rng = build.rng
    number = len(ground)
    half = rng.uniform([0.3, 0.01, 0.25], [0.9, 0.03, 0.5], (number, 3))
    tall = rng.uniform(0.4, 1.0, number)
    top = ground - points(0, tall, 0)
    build.boxes(top, sized(yaw, half), build.material(number, build.depth(top), WOOD))

    def on(place: Floats) -> Floats:
        """Offsets from the middle, in half sizes (..., n, 3), turned with the table."""
        offset: Floats = np.einsum("nij,...nj->...ni", yaw, place * half)
        return offset

    wood = build.material(number, build.depth(ground))
    for x in (-0.9, 0.9):
        for z in (-0.9, 0.9):
            leg = ground + on(np.array([[x, 0, z]])) - points(0, tall / 2, 0)
            build.boxes(leg, sized(yaw, points(0.025, tall / 2, 0.025)), wood)
    place = rng.uniform(-0.8, 0.8, (3, number, 3))
    place[..., 1] = -1
    at = (top + on(place)).reshape(-1, 3)
    standing(build, at, rng.uniform(0.05, 0.45, len(at)), rng.uniform(0.05, 0.25, len(at)))


def shelves(build: Builder, ground: Floats, yaw: Floats) -> None:
    """Shelves: boards between two sides, with books on the boards."""
    rng = build.rng
    for at, turn in zip(ground, yaw, strict=True):
        wide, tall, deep = rng.uniform([0.3, 0.8, 0.12], [0.8, 2.1, 0.25])
        level = np.linspace(0, tall, int(rng.integers(3, 7)))
        boards = points(0, -level, 0), points(wide, 0.012, deep + 0 * level)
        sides = points([-wide, wide], -tall / 2, 0), points([0.012] * 2, tall / 2, deep)
        back = points(0, -tall / 2, deep), points(wide, tall / 2, 0.005)
        local, half = (np.concatenate(part) for part in zip(boards, sides, back, strict=True))
        wood = build.material(1, build.depth(at), WOOD)[np.zeros(len(local), int)]
        build.boxes(at + local @ turn.T, sized(turn[None], half), wood)
        base = np.repeat(level[:-1], 9)
        high = level[1] * rng.uniform(0.2, 0.45, len(base))
        across = rng.uniform(-0.9, 0.9, len(base)) * wide
        local = points(across, -base - high, rng.uniform(-0.3, 0.3, len(base)) * deep)
        half = points(rng.uniform(0.012, 0.05, len(base)), high, 0.6 * deep)
        books = build.material(len(base), build.depth(at))
        build.boxes(at + local @ turn.T, sized(turn[None], half), books)


def cars(build: Builder, ground: Floats, yaw: Floats) -> None:
    """A body, a cabin and four wheels."""
    rng = build.rng
    number = len(ground)
    half = rng.uniform([0.8, 0.28, 1.8], [0.95, 0.42, 2.4], (number, 3))
    body = ground - points(0, half[:, 1] + 0.25, 0)
    paint = build.material(number, build.depth(body))
    paint.contrast *= 0.3
    paint.gloss += rng.uniform(0, 0.4, number)
    build.boxes(body, sized(yaw, half), paint)
    glass = build.material(number, build.depth(body))
    glass.colour *= 0.5
    cabin = body - points(0, half[:, 1] + 0.28, 0) + yaw[..., 2] * 0.2
    build.boxes(cabin, sized(yaw, half * [0.88, 0, 0.55] + [0, 0.3, 0]), glass)
    rubber = build.material(number, build.depth(body), ASPHALT)
    rubber.colour *= 0.3
    for x in (-0.95, 0.95):
        for z in (-0.62, 0.62):
            wheel = ground + np.einsum("nij,nj->ni", yaw, half * [x, 0, z]) - points(0, 0.32, 0)
            size = np.tile([0.32, 0.32, 0.1], (number, 1))
            build.quadrics(wheel, sized(yaw @ SIDEWAYS, size), rubber)


def bushes(build: Builder, centre: Floats, radius: Floats, leaves: Material) -> None:
    """Leafy cards, turned at random."""
    cards = build.rotations(len(centre)) * radius[:, None, None]
    mask = build.pick_masks(len(centre), FOLIAGE)
    build.rectangles(centre, cards[..., 0], cards[..., 1], leaves, mask=mask)


def trees(build: Builder, ground: Floats) -> None:
    """Trunks with crowns of leafy cards."""
    rng = build.rng
    number, cards = len(ground), 6
    tall = rng.uniform(1.5, 4, number)
    bark = build.material(number, build.depth(ground), WOOD)
    columns(build, ground, rng.uniform(0.06, 0.25, number), tall, bark)
    which = np.tile(np.arange(number), cards)
    radius = rng.uniform(0.8, 2.2, number)
    crown = (ground - points(0, tall + 0.6 * radius, 0))[which]
    crown += rng.normal(0, 0.45, (len(which), 3)) * radius[which, None]
    leaves = build.material(number, build.depth(ground), GRASS)[which]
    bushes(build, crown, radius[which] * rng.uniform(0.6, 1.0, len(which)), leaves)


def poles(build: Builder, ground: Floats) -> None:
    """Poles, some with a sign."""
    rng = build.rng
    number = len(ground)
    tall = rng.uniform(2, 7, number)
    material = build.material(number, build.depth(ground))
    columns(build, ground, rng.uniform(0.03, 0.14, number), tall, material)
    sign = rng.random(number) < 0.5
    at = ground[sign] - points(0, np.minimum(tall[sign], 2.6), 0.15)
    turn = turns(rng.normal(0, 0.4, len(at))) * rng.uniform(0.25, 0.5, (len(at), 1, 1))
    board = build.material(len(at), build.depth(at))
    build.rectangles(at, turn[..., 0], turn[..., 1], board, mask=build.pick_masks(len(at)))


def people(build: Builder, ground: Floats) -> None:
    """A head, a body and two legs of ellipsoids."""
    rng = build.rng
    number = len(ground)
    scale = rng.uniform(0.6, 1.05, number)
    skin, coat, cloth = (build.material(number, build.depth(ground)) for _ in range(3))
    parts = (
        (0, 1.62, 0.11, 0.28, skin),
        (0, 1.15, 0.24, 0.72, coat),
        (-0.1, 0.4, 0.09, 0.84, cloth),
        (0.1, 0.4, 0.09, 0.84, cloth),
    )
    for x, middle, radius, tall, material in parts:
        low = (middle - tall / 2) * scale
        foot = ground + points(x * scale, -low, rng.normal(0, 0.08, number))
        columns(build, foot, radius * scale, tall * scale, material, SPHERE)


def fences(build: Builder, start: Floats, step: Floats, tall: Floats) -> None:
    """Bars or wire between ``start`` and ``start + step``."""
    number = len(start)
    length = np.linalg.norm(step, axis=1)
    repeat = np.stack([np.maximum(1, np.round(length / tall)), np.ones(number)], -1)
    build.rectangles(
        start + step / 2 - points(0, tall / 2, 0),
        step / 2,
        points(0, tall / 2, 0),
        build.material(number, build.depth(start)),
        mask=build.pick_masks(number, BARS, MESH),
        mask_repeat=repeat * build.rng.integers(1, 3, (number, 1)),
    )
