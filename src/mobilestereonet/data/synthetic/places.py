"""The layouts: rooms, streets, parks, table tops, floating clutter and slanted planes."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from mobilestereonet.data.synthetic.layout import (
    BARREL,
    BOWL,
    CONE,
    CYLINDER,
    SPHERE,
    VASE,
    Builder,
    Floats,
    turns,
)
from mobilestereonet.data.synthetic.textures import (
    ASPHALT,
    BARS,
    FOLIAGE,
    GRASS,
    MESH,
    SKY,
    WINDOWS,
    WOOD,
)

UPRIGHT = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])  # columns: a quadric's z axis points up
QUADRICS = np.array([SPHERE, SPHERE, CYLINDER, CYLINDER, CONE, BARREL, VASE, BOWL])


def _sized(directions: Floats, half: Floats) -> Floats:
    """Half axes as columns: rotations (n, 3, 3) times half sizes (n, 3)."""
    return directions * half[:, None, :]


def _points(x: ArrayLike, y: ArrayLike, z: ArrayLike) -> Floats:
    return np.stack(
        np.broadcast_arrays(*(np.atleast_1d(np.asarray(v, float)) for v in (x, y, z))), -1
    )


def floaters(build: Builder, count: int, lowest: float, highest: float) -> None:
    """Things of every shape in mid-air, even in the image and in disparity."""
    rng = build.rng
    kinds = rng.multinomial(count, [0.2, 0.25, 0.2, 0.2, 0.15])
    for kind, number in enumerate(kinds):
        if not number:
            continue
        centre = build.in_view(number, lowest, highest)
        depth = build.depth(centre)
        radius = build.log_uniform(5, 0.22 * build.width, number) * depth / build.focal
        half = np.minimum(radius, 0.35 * depth)[:, None] * build.log_uniform(0.35, 1, (number, 3))
        axes = _sized(build.rotations(number), half)
        material = build.material(number, depth)
        if kind == 0:
            build.boxes(centre, axes, material)
        elif kind == 1:
            build.quadrics(centre, axes, material, QUADRICS[rng.integers(0, len(QUADRICS), number)])
        elif kind == 2:
            build.rectangles(centre, axes[..., 0], axes[..., 1], material)
        elif kind == 3:
            repeat = rng.choice([1.0, 1.0, 2.0, 3.0], (number, 1))
            build.rectangles(
                centre,
                axes[..., 0],
                axes[..., 1],
                material,
                mask=build.pick_masks(number),
                mask_repeat=repeat,
            )
        else:
            thin = np.maximum(1.0, build.log_uniform(0.7, 6, number)) * depth / build.focal
            axes[..., :2] *= (thin[:, None] / half[:, :2])[:, None]
            build.quadrics(centre, axes, material, CYLINDER)


def _backdrop(build: Builder, depth: float, kind: int | None = None, tilt: float = 0.0) -> None:
    """A wall across the whole view, perpendicular to the optical axis but for ``tilt``."""
    half = 3 * depth * max(build.width, build.height) / build.focal + 2 * build.baseline
    axes = build.rotation.T @ turns(build.rng.uniform(-tilt, tilt))[0]
    centre = build.rotation[2] * depth
    build.rectangles(
        centre[None],
        half * axes[None, :, 0],
        half * axes[None, :, 1],
        build.material(1, depth, kind),
    )


def _ground(
    build: Builder, below: float, far: float, kind: int | None = None, depth: float | None = None
) -> None:
    centre = _points(0, below, 0)
    build.rectangles(
        centre,
        _points(far, 0, 0),
        _points(0, 0, far),
        build.material(1, depth or 1.5 * build.near, kind),
    )


def _standing(build: Builder, ground: Floats, height: Floats, width: Floats) -> None:
    """Boxes, cylinders, cones, balls and cards on the ground at the points ``ground``."""
    rng = build.rng
    kinds = rng.choice(5, len(ground), p=[0.4, 0.22, 0.13, 0.13, 0.12])
    for kind in range(5):
        which = kinds == kind
        number = int(which.sum())
        if not number:
            continue
        half = np.stack([width, height, width * rng.uniform(0.4, 1.3, len(width))], -1)[which] / 2
        centre = ground[which] - [[0, 1, 0]] * half[:, 1:2]
        yaw = turns(rng.uniform(-np.pi, np.pi, number))
        material = build.material(number, build.depth(centre))
        upright = _sized(yaw @ UPRIGHT, half[:, [0, 2, 1]])
        if kind == 0:
            build.boxes(centre, _sized(yaw, half), material)
        elif kind == 1:
            build.quadrics(
                centre, upright, material, QUADRICS[rng.integers(2, len(QUADRICS), number)]
            )
            top = upright.copy()
            top[..., 2] *= 0.02
            lids = (rng.random(number) < 0.7) & True
            build.quadrics((centre - [[0, 1, 0]] * half[:, 1:2])[lids], top[lids], material[lids])
        elif kind == 2:
            build.quadrics(centre, upright, material, CONE)
        elif kind == 3:
            build.quadrics(centre, upright, material)
        else:
            lean = _sized(yaw, half)
            lean[..., 1] += 0.3 * half[:, 1:2] * yaw[..., 2] * rng.uniform(-1, 1, (number, 1))
            mask = build.pick_masks(number)
            if rng.random() < 0.5:
                build.rectangles(centre, lean[..., 0], lean[..., 1], material)
            else:
                build.rectangles(centre, lean[..., 0], lean[..., 1], material, mask=mask)


def _tables(build: Builder, ground: Floats, yaw: Floats) -> None:
    """Table tops on four legs, with things on them."""
    rng = build.rng
    number = len(ground)
    half = np.stack(
        [
            rng.uniform(0.3, 0.9, number),
            rng.uniform(0.01, 0.03, number),
            rng.uniform(0.25, 0.5, number),
        ],
        -1,
    )
    tall = rng.uniform(0.4, 1.0, number)
    top = ground - _points(0, tall, 0)
    build.boxes(top, _sized(yaw, half), build.material(number, build.depth(top), WOOD))
    for sx in (-0.9, 0.9):
        for sz in (-0.9, 0.9):
            foot = np.einsum("nij,nj->ni", yaw, half * [sx, 0, sz])
            leg = ground + foot - _points(0, tall / 2, 0)
            size = _points(0.025, tall / 2, 0.025)
            build.boxes(leg, _sized(yaw, size), build.material(number, build.depth(leg)))
    each = 3
    spread = rng.uniform(-0.8, 0.8, (each, number, 3)) * half * [1, 0, 1]
    at = top + np.einsum("nij,knj->kni", yaw, spread) - [[0, 1, 0]] * half[:, 1:2]
    _standing(
        build,
        at.reshape(-1, 3),
        rng.uniform(0.05, 0.45, each * number),
        rng.uniform(0.05, 0.25, each * number),
    )


def _shelves(build: Builder, ground: Floats, yaw: Floats) -> None:
    """Shelves: boards between two sides, with books on the boards."""
    rng = build.rng
    for at, turn in zip(ground, yaw, strict=True):
        wide, tall, deep = rng.uniform(0.3, 0.8), rng.uniform(0.8, 2.1), rng.uniform(0.12, 0.25)
        boards = int(rng.integers(3, 7))
        material = build.material(1, build.depth(at), WOOD)
        levels = np.linspace(0, tall, boards)
        local = np.concatenate(
            [
                _points(0, -levels, 0),
                _points([-wide, wide], -tall / 2, 0),
                _points(0, -tall / 2, deep),
            ]
        )
        half = np.concatenate(
            [
                np.tile([wide, 0.012, deep], (boards, 1)),
                np.tile([0.012, tall / 2, deep], (2, 1)),
                [[wide, tall / 2, 0.005]],
            ]
        )
        build.boxes(
            at + local @ turn.T, turn[None] * half[:, None], material[np.zeros(len(local), int)]
        )
        books = 9 * (boards - 1)
        gap = tall / (boards - 1)
        high = gap * rng.uniform(0.4, 0.9, books)
        thick = rng.uniform(0.012, 0.05, books)
        x = rng.uniform(-0.9, 0.9, books) * wide
        base = np.repeat(levels[:-1], 9)
        local = _points(x, -base - high / 2, rng.uniform(-0.3, 0.3, books) * deep)
        half = np.stack([thick, high / 2, np.full(books, 0.6 * deep)], -1)
        build.boxes(
            at + local @ turn.T, turn[None] * half[:, None], build.material(books, build.depth(at))
        )


def room(build: Builder) -> None:
    """Four walls, furniture along them, tables, pictures, a lamp, clutter."""
    rng = build.rng
    near = build.near
    wide, deep = rng.uniform(1.6, 4.0) * max(near, 1.0), rng.uniform(2.5, 6) * max(near, 1.0)
    below, above = rng.uniform(0.8, 1.7), rng.uniform(0.9, 2.0)
    heading = turns(rng.uniform(-0.7, 0.7))[0]
    right, down, ahead = heading.T
    middle = heading @ [rng.uniform(-0.5, 0.5) * wide, 0, 0.5 * deep - 0.3]
    centre = middle + (below - above) / 2 * down
    tall = (below + above) / 2
    walls = build.material(1, 0.7 * deep)[np.zeros(4, int)]
    half = 0.5 * deep + 0.6
    around = np.array(
        [centre - wide * right, centre + wide * right, centre - half * ahead, centre + half * ahead]
    )
    sides = np.array([half * ahead, half * ahead, wide * right, wide * right])
    build.rectangles(around, sides, np.tile(tall * down, (4, 1)), walls)
    for level, sign in ((below, 1), (-above, -1)):
        at = (middle + level * down)[None]
        kind = WOOD if sign > 0 and rng.random() < 0.4 else None
        build.rectangles(
            at, wide * right[None], half * ahead[None], build.material(1, 0.5 * deep, kind)
        )
    # Pictures, windows, doors: a few centimetres before the walls.
    number = int(rng.integers(3, 10))
    side = rng.integers(0, 4, number)
    inward = np.array([right, -right, ahead, -ahead])[side]
    along = sides[side] * rng.uniform(-0.85, 0.85, (number, 1))
    at = (
        around[side]
        + along
        + down * tall * rng.uniform(-0.6, 0.3, (number, 1))
        + inward * rng.uniform(0.01, 0.06, (number, 1))
    )
    unit = sides[side] / np.linalg.norm(sides[side], axis=1, keepdims=True)
    build.rectangles(
        at,
        unit * rng.uniform(0.15, 0.6, (number, 1)),
        down * rng.uniform(0.15, 0.6, (number, 1)),
        build.material(number, build.depth(at)),
    )

    def floor_points(count: int, edge: float) -> tuple[Floats, Floats]:
        """Points on the floor beyond ``near``; towards the walls as ``edge`` goes to 1."""
        across = np.sign(rng.uniform(-1, 1, count)) * rng.uniform(edge, 0.93, count) * wide
        along = rng.uniform(-0.4, 0.9, count) * half
        points = middle + below * down + across[:, None] * right + along[:, None] * ahead
        keep = points @ build.rotation[2] > near + 0.4
        yaw = heading @ turns(
            rng.choice([0, np.pi / 2, -np.pi / 2], count) + rng.normal(0, 0.1, count)
        )
        return points[keep], yaw[keep]

    at, yaw = floor_points(int(rng.integers(1, 4)), 0.0)
    _tables(build, at, yaw)
    at, yaw = floor_points(int(rng.integers(0, 3)), 0.85)
    _shelves(build, at, yaw)
    at, _ = floor_points(int(rng.integers(5, 14)), 0.2)
    _standing(build, at, rng.uniform(0.2, 1.7, len(at)), rng.uniform(0.2, 0.9, len(at)))
    aside = rng.uniform(-0.4, 0.4, 2)
    build.lamp = middle - (above - 0.5) * down + aside[0] * wide * right + aside[1] * half * ahead
    shade = (build.lamp - 0.3 * down)[None]
    size = np.full((1, 3), 0.2)
    build.quadrics(shade, _sized(UPRIGHT[None], size), build.material(1, build.depth(shade)))
    floaters(build, int(rng.integers(0, 9)), 0.3 * build.nearest, build.nearest)


def _cars(build: Builder, ground: Floats, yaw: Floats) -> None:
    rng = build.rng
    number = len(ground)
    half = np.stack(
        [
            rng.uniform(0.8, 0.95, number),
            rng.uniform(0.28, 0.42, number),
            rng.uniform(1.8, 2.4, number),
        ],
        -1,
    )
    body = ground - _points(0, half[:, 1] + 0.25, 0)
    material = build.material(number, build.depth(body))
    material.contrast *= 0.3
    material.gloss += rng.uniform(0, 0.4, number)
    build.boxes(body, _sized(yaw, half), material)
    cabin = body - _points(0, half[:, 1] + 0.28, 0) + yaw[..., 2] * 0.2
    glass = build.material(number, build.depth(body))
    glass.colour *= 0.5
    build.boxes(
        cabin,
        _sized(yaw, np.stack([half[:, 0] * 0.88, np.full(number, 0.3), half[:, 2] * 0.55], -1)),
        glass,
    )
    sideways = np.array(
        [[0, 0, 1.0], [0, 1, 0], [-1, 0, 0]]
    )  # a quadric's z axis along the car's x
    for sx in (-1, 1):
        for sz in (-0.62, 0.62):
            local = half * [[sx * 0.95, 0, sz]]
            wheel = ground + np.einsum("nij,nj->ni", yaw, local) - _points(0, 0.32, 0)
            tyre = build.material(number, build.depth(wheel), ASPHALT)
            tyre.colour *= 0.3
            size = np.tile([0.32, 0.32, 0.1], (number, 1))
            build.quadrics(wheel, _sized(yaw @ sideways, size), tyre)


def _trees(build: Builder, ground: Floats) -> None:
    """Trunks with crowns of leafy cards."""
    rng = build.rng
    number = len(ground)
    tall = rng.uniform(1.5, 4, number)
    trunk = ground - _points(0, tall / 2, 0)
    size = np.stack([*np.tile(rng.uniform(0.06, 0.25, number), (2, 1)), tall / 2], -1)
    build.quadrics(
        trunk,
        _sized(np.tile(UPRIGHT, (number, 1, 1)), size),
        build.material(number, build.depth(trunk), WOOD),
        CYLINDER,
    )
    each = 6
    radius = rng.uniform(0.8, 2.2, number)
    crown = ground - _points(0, tall + 0.6 * radius, 0)
    at = crown + rng.normal(0, 0.45, (each, number, 3)) * radius[:, None]
    leaves = build.rotations(each * number)
    leaves[..., :2] *= np.tile(radius, each)[:, None, None] * rng.uniform(
        0.6, 1.0, (each * number, 1, 1)
    )
    foliage = build.material(number, build.depth(crown), GRASS)[np.tile(np.arange(number), each)]
    build.rectangles(
        at.reshape(-1, 3),
        leaves[..., 0],
        leaves[..., 1],
        foliage,
        mask=build.pick_masks(each * number, FOLIAGE),
    )


def _poles(build: Builder, ground: Floats) -> None:
    """Poles, some with a sign."""
    rng = build.rng
    number = len(ground)
    tall, thick = rng.uniform(2, 7, number), rng.uniform(0.03, 0.14, number)
    size = np.stack([thick, thick, tall / 2], -1)
    at = ground - _points(0, tall / 2, 0)
    build.quadrics(
        at,
        _sized(np.tile(UPRIGHT, (number, 1, 1)), size),
        build.material(number, build.depth(at)),
        CYLINDER,
    )
    signs = rng.random(number) < 0.5
    count = int(signs.sum())
    if count:
        at = ground[signs] - _points(0, np.minimum(tall[signs], 2.6), 0.15)
        turn = turns(rng.normal(0, 0.4, count))
        half = rng.uniform(0.25, 0.5, (count, 1))
        build.rectangles(
            at,
            turn[..., 0] * half,
            turn[..., 1] * half,
            build.material(count, build.depth(at)),
            mask=build.pick_masks(count),
        )


def _people(build: Builder, ground: Floats) -> None:
    """A head, a body and two legs of quadrics."""
    rng = build.rng
    number = len(ground)
    scale = rng.uniform(0.6, 1.05, number)
    upright = np.tile(UPRIGHT, (number, 1, 1))
    wear = build.material(2 * number, np.tile(build.depth(ground), 2))
    for part, (x, high, wide, tall) in enumerate(
        (
            (0, 1.62, 0.11, 0.14),
            (0, 1.15, 0.24, 0.36),
            (-0.1, 0.4, 0.09, 0.42),
            (0.1, 0.4, 0.09, 0.42),
        )
    ):
        at = ground + _points(x * scale, -high * scale, rng.normal(0, 0.08, number))
        size = np.array([wide, 0.7 * wide, tall]) * scale[:, None]
        build.quadrics(at, _sized(upright, size), wear[number * (part > 1) :][:number])


def _fences(build: Builder, start: Floats, step: Floats, tall: Floats) -> None:
    """Bars or wire between ``start`` and ``start + step``."""
    rng = build.rng
    number = len(start)
    length = np.linalg.norm(step, axis=1)
    repeat = np.stack([np.maximum(1, np.round(length / tall)), np.ones(number)], -1)
    at = start + step / 2 - _points(0, tall / 2, 0)
    build.rectangles(
        at,
        step / 2,
        _points(0, tall / 2, 0),
        build.material(number, build.depth(at)),
        mask=build.pick_masks(number, BARS, MESH),
        mask_repeat=repeat * rng.integers(1, 3, (number, 1)),
    )


def street(build: Builder) -> None:
    """A road between facades or hedges, cars, poles, trees, people; sky at the end."""
    rng = build.rng
    heading = turns(rng.normal(0, 0.12) if rng.random() < 0.8 else rng.uniform(-0.8, 0.8))[0]
    far = build.log_uniform(60, 250)
    below = rng.uniform(1.2, 2.6)
    half = rng.uniform(2.5, 7)
    shift = rng.uniform(-0.6, 0.6) * half
    _backdrop(build, 12 * far, SKY)
    _ground(build, below, 14 * far, rng.choice([ASPHALT, GRASS]))

    def at(x: ArrayLike, y: ArrayLike, z: ArrayLike) -> Floats:
        return _points(np.asarray(x) + shift, y, z) @ heading.T

    road = build.material(1, 2 * build.near, ASPHALT)
    along = at([0], 0, 1) - at([0], 0, 0)
    build.rectangles(at(0, below - 0.02, far / 2), at(half, 0, 0) - at(0, 0, 0), along * far, road)
    dashes = np.arange(2, 2 + 9 * 8, 9.0)
    paint = build.material(1, 2 * build.near, ASPHALT)[np.zeros(len(dashes), int)]
    paint.colour *= 2
    build.rectangles(
        at(rng.choice([0, half / 3]), below - 0.03, dashes),
        at(0.07, 0, 0) - at(0, 0, 0) + 0 * dashes[:, None],
        along + 0 * dashes[:, None],
        paint,
    )
    for side in (-1, 1):
        walk = rng.uniform(1.5, 4)
        build.boxes(
            at(side * (half + walk), below, far / 2),
            _sized(heading[None], np.array([[walk, 0.12, far]])),
            build.material(1, 2 * build.near),
        )
        style = rng.random()
        number = int(rng.integers(4, 11))
        z = np.cumsum(build.log_uniform(6, 30, number)) - 10
        deep = np.diff(z, append=z[-1] + 20) / 2 * rng.uniform(0.7, 1.0, number)
        tall = (
            build.log_uniform(2.5, 16, number)
            if style < 0.75
            else build.log_uniform(0.8, 3, number)
        )
        wide = rng.uniform(3, 9, number)
        away = half + 2 * walk + wide + rng.uniform(0, 5) * rng.random(number)
        if style < 0.92:
            material = build.material(
                number, np.maximum(z, 1.5 * build.near), WINDOWS if style < 0.5 else None
            )
            build.boxes(
                at(side * away, below - tall, z),
                _sized(heading[None], np.stack([wide, tall, deep], -1)),
                material,
            )
        number = int(rng.integers(0, 7))
        _trees(
            build,
            at(
                side * (half + walk * rng.uniform(0.3, 2, number)),
                below,
                build.log_uniform(1.5 * build.near, far / 2, number),
            ),
        )
        number = int(rng.integers(0, 6))
        z = build.log_uniform(1.3 * build.near, far / 2, number)
        turned = turns(np.where(rng.random(number) < 0.5, 0, np.pi) + rng.normal(0, 0.05, number))
        _cars(
            build, at(side * (half - 1.1 + rng.normal(0, 0.2, number)), below, z), heading @ turned
        )
        number = int(rng.integers(1, 6))
        _poles(
            build,
            at(
                side * (half + 0.5 + 0.3 * rng.random(number)),
                below,
                build.log_uniform(build.near, far / 2, number),
            ),
        )
        number = int(rng.integers(0, 4))
        _people(
            build,
            at(
                side * (half + walk * rng.uniform(0, 2, number)),
                below,
                build.log_uniform(1.2 * build.near, far / 4, number),
            ),
        )
        if rng.random() < 0.4:
            z = build.near + np.arange(4) * 6.0
            step = np.broadcast_to(along * 6, (4, 3))
            _fences(
                build,
                at(side * (half + 1.6 * walk), below, z),
                step,
                np.full(4, rng.uniform(0.8, 2)),
            )
    if rng.random() < 0.6:
        number = int(rng.integers(1, 4))
        z = build.log_uniform(1.8 * build.near, 60, number)
        _cars(
            build,
            at(rng.uniform(-0.6, 0.6, number) * half, below, z),
            heading @ turns(rng.normal(0, 0.1, number)),
        )


def park(build: Builder) -> None:
    """Open ground with hills, trees, rocks, bushes and a fence."""
    rng = build.rng
    below, far = rng.uniform(1.0, 2.5), build.log_uniform(30, 150)
    _backdrop(build, 10 * far, SKY)
    _ground(build, below, 12 * far, rng.choice([GRASS, ASPHALT]))

    def ground(count: int, nearest: float, farthest: float) -> Floats:
        z = build.log_uniform(nearest * build.near, farthest, count)
        return _points(z * rng.uniform(-0.7, 0.7, count) * build.width / build.focal, below, z)

    number = int(rng.integers(3, 9))
    at = ground(number, 6, far)
    size = (build.depth(at) * rng.uniform(0.1, 0.5, number))[:, None] * rng.uniform(
        [0.6, 0.6, 0.1], [1.5, 1.5, 0.4], (number, 3)
    )
    build.quadrics(
        at,
        _sized(turns(np.zeros(number)) @ UPRIGHT, size),
        build.material(number, build.depth(at), GRASS),
    )
    number = int(rng.integers(4, 14))
    at = ground(number, 1, 0.3 * far)
    size = rng.uniform(0.1, 0.9, (number, 1)) * rng.uniform(0.4, 1, (number, 3))
    build.quadrics(
        at, _sized(build.rotations(number), size), build.material(number, build.depth(at))
    )
    number = int(rng.integers(6, 20))
    at = ground(number, 1, 0.3 * far)
    cards = build.rotations(number)
    cards[..., :2] *= rng.uniform(0.3, 0.9, (number, 1, 1))
    build.rectangles(
        at - _points(0, 0.3, 0),
        cards[..., 0],
        cards[..., 1],
        build.material(number, build.depth(at), GRASS),
        mask=build.pick_masks(number, FOLIAGE),
    )
    _trees(build, ground(int(rng.integers(2, 9)), 1.3, 0.6 * far))
    _people(build, ground(int(rng.integers(0, 5)), 1.3, 0.3 * far))
    number = int(rng.integers(0, 5))
    at = ground(number, 1.5, 0.4 * far)
    half = rng.uniform(1, 4, (number, 3))
    build.boxes(
        at - [[0, 1, 0]] * half,
        _sized(turns(rng.uniform(-2, 2, number)), half),
        build.material(number, build.depth(at), WINDOWS),
    )
    number = int(rng.integers(0, 4))
    _fences(
        build,
        ground(number, 1.2, 0.3 * far),
        rng.uniform(-5, 5, (number, 3)) * [1, 0, 1],
        rng.uniform(0.8, 2, number),
    )


def table(build: Builder) -> None:
    """A table top full of things before a wall, seen from slightly above."""
    rng = build.rng
    near = build.near
    deep = near * rng.uniform(0.6, 2.0)
    below = near * (np.tan(build.pitch) + 0.5 * build.height / build.focal) * rng.uniform(0.85, 1.1)
    _backdrop(build, near + deep + rng.uniform(0.05, 1.0) * near, tilt=0.5)
    kind = WOOD if rng.random() < 0.3 else None
    _ground(build, below, 4 * (near + deep), kind, depth=near + 0.4 * deep)
    number = int(rng.integers(16, 40))
    z = near + deep * rng.uniform(0.12, 1, number) ** 0.8
    x = z * rng.uniform(-0.6, 0.6, number) * build.width / build.focal
    scale = near * build.log_uniform(0.05, 0.4, (2, number))
    at = _points(x, below, z)
    _standing(build, at, scale[0] * rng.uniform(0.8, 2.0, number), np.minimum(scale[1], 0.5 * near))
    if rng.random() < 0.5:
        number = int(rng.integers(2, 6))
        at = _points(rng.uniform(-0.5, 0.5) * near, below, near + rng.uniform(0.3, 0.9) * deep)
        half = near * rng.uniform([0.08, 0.01, 0.06], [0.2, 0.03, 0.15], (number, 3))
        up = np.cumsum(2 * half[:, 1]) - half[:, 1]
        build.boxes(
            at - _points(0, up, 0),
            _sized(turns(rng.normal(0, 0.2, number)), half),
            build.material(number, build.depth(at)),
        )
    floaters(build, int(rng.integers(0, 7)), 0.5 * build.nearest, build.nearest)


def clutter(build: Builder) -> None:
    """Things in mid-air before a far wall, sometimes over a ground."""
    rng = build.rng
    lowest = build.nearest * build.log_uniform(0.03, 0.3)
    _backdrop(build, build.focal * build.baseline / lowest, tilt=0.6)
    if rng.random() < 0.4:
        _ground(build, rng.uniform(0.4, 1.2) * build.near, build.near * build.nearest / lowest)
    floaters(build, int(rng.integers(20, 55)), lowest, build.nearest)


def planes(build: Builder) -> None:
    """A few large slanted planes that cross the whole view, and little else."""
    rng = build.rng
    lowest = build.nearest * rng.uniform(0.1, 0.6)
    _backdrop(build, build.focal * build.baseline / lowest, tilt=0.9)
    number = int(rng.integers(1, 4))
    centre = build.in_view(number, lowest, 0.7 * build.nearest)
    depth = build.depth(centre)
    turn = build.rotation.T @ turns(rng.uniform(-1.1, 1.1, number)) @ build.rotations(number) ** 0
    turn = build.rotation.T @ turns(rng.uniform(-1.1, 1.1, number))
    lean = rng.uniform(-0.9, 0.9, (number, 1))
    half = (depth * build.width / build.focal * rng.uniform(0.25, 0.7, number))[:, None]
    half = np.minimum(half, 0.8 * depth[:, None])
    x, y = turn[..., 0] * half, (turn[..., 1] * np.cos(lean) + turn[..., 2] * np.sin(lean)) * half
    build.rectangles(centre, x, y, build.material(number, depth))
    floaters(build, int(rng.integers(0, 9)), lowest, build.nearest)


# Layout, distance of the nearest things (m), pitch (rad), outdoors.
PLACES: dict[
    str, tuple[Callable[[Builder], None], tuple[float, float], tuple[float, float], bool]
] = {
    "room": (room, (0.8, 1.8), (-0.15, 0.35), False),
    "street": (street, (4.0, 8.0), (-0.06, 0.1), True),
    "park": (park, (2.5, 7.0), (-0.06, 0.2), True),
    "table": (table, (0.5, 2.0), (0.1, 0.9), False),
    "clutter": (clutter, (1.0, 3.0), (-0.1, 0.1), False),
    "planes": (planes, (1.0, 3.0), (-0.1, 0.1), False),
}
