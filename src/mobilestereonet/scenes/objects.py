"""Objects of a scene: floating shapes, furniture, cars, trees, poles, people, fences."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from mobilestereonet.scenes.builder import SceneBuilder, yaw_rotations
from mobilestereonet.scenes.masks import BARS, FOLIAGE, MESH
from mobilestereonet.scenes.materials import Material
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


def stack_xyz(x: ArrayLike, y: ArrayLike, z: ArrayLike) -> Floats:
    """Stack coordinates, numbers or (n,), to points (n, 3)."""
    columns = np.broadcast_arrays(*(np.atleast_1d(np.asarray(c, np.float64)) for c in (x, y, z)))
    return np.stack(columns, -1)


def scale_axes(directions: Floats, half: Floats) -> Floats:
    """Half axes as columns, (n, 3, 3): rotations (n, 3, 3) times half sizes (n, 3)."""
    return directions * half[:, None, :]


def add_backdrop(
    build: SceneBuilder, depth: float, kind: int | None = None, tilt: float = 0.0
) -> None:
    """Add a wall across the whole view, perpendicular to the optical axis up to ``tilt``."""
    view = max(build.width, build.height) / build.focal
    half = 6 * depth * view + 2 * build.baseline
    tilt = min(tilt, float(np.arctan(1.1 / view)))  # a wide view would look past its end
    x, y, _ = half * (build.rotation.T @ yaw_rotations(build.rng.uniform(-tilt, tilt))[0]).T
    centre = build.rotation[2] * depth
    build.add_rectangles(centre[None], x[None], y[None], build.draw_materials(1, depth, kind))


def add_ground(
    build: SceneBuilder, below: float, far: float, kind: int | None, depth: float
) -> None:
    """Add a level plane ``below`` the camera, textured as seen from ``depth``."""
    material = build.draw_materials(1, depth, kind)
    build.add_rectangles(
        stack_xyz(0, below, 0), stack_xyz(far, 0, 0), stack_xyz(0, 0, far), material
    )


def add_columns(
    build: SceneBuilder,
    foot: Floats,
    radius: Floats,
    height: Floats,
    material: Material,
    kind: ArrayLike = CYLINDER,
) -> None:
    """Add n round objects (quadrics) that stand on the points ``foot``."""
    size = np.stack([radius, radius, height / 2], -1)
    axes = scale_axes(np.tile(UPRIGHT, (len(foot), 1, 1)), size)
    build.add_quadrics(foot - stack_xyz(0, height / 2, 0), axes, material, kind)


def add_floating_objects(build: SceneBuilder, lowest: float, *, share: float) -> None:
    """Add objects of every shape in mid-air, spread evenly in the image and in disparity.

    Args:
        build: Builder that they are added to.
        lowest: Disparity of the farthest, in pixels.
        share: Their number over that in a scene of clutter.
    """
    count = round(share * build.rng.integers(build.objects[0], build.objects[1] + 1))
    _add_shapes(build, count, lowest, build.nearest, (5, 0.22 * build.width))


def add_background_things(build: SceneBuilder) -> None:
    """Add many things far away, at a thirtieth to a third of the nearest objects' disparity."""
    low, high = 0.03 * build.nearest, 0.3 * build.nearest
    _add_shapes(build, int(build.rng.integers(40, 121)), low, high, (4, 0.08 * build.width))


def add_floating_things(build: SceneBuilder) -> None:
    """Add many small things, densely, in mid-air at all distances."""
    count = int(build.rng.integers(80, 251))
    _add_shapes(build, count, 0.05 * build.nearest, build.nearest, (2.5, 0.05 * build.width))


def _add_shapes(
    build: SceneBuilder, count: int, lowest: float, highest: float, radii: tuple[float, float]
) -> None:
    """Add objects of every shape, of disparities and of radii (px) within bounds."""
    rng = build.rng
    for kind, number in enumerate(rng.multinomial(count, [0.2, 0.25, 0.2, 0.2, 0.15])):
        centre = build.positions_in_view(number, lowest, highest)
        depth = build.depths(centre)
        radius = build.log_uniform(*radii, number) * depth / build.focal
        half = np.minimum(radius, 0.35 * depth)[:, None] * build.log_uniform(0.35, 1, (number, 3))
        axes = scale_axes(build.random_rotations(number), half)
        material = build.draw_materials(number, depth)
        if kind == 0:
            build.add_boxes(centre, axes, material)
        elif kind == 1:
            build.add_quadrics(centre, axes, material, rng.choice(QUADRICS, number))
        elif kind == 2:
            build.add_rectangles(centre, axes[..., 0], axes[..., 1], material)
        elif kind == 3:
            holes = {
                "mask": build.draw_masks(number),
                "mask_repeat": rng.choice([1.0, 1.0, 2.0, 3.0], (number, 1)),
            }
            build.add_rectangles(centre, axes[..., 0], axes[..., 1], material, **holes)
        else:
            rod = np.maximum(1.0, build.log_uniform(0.7, 6, number)) * depth / build.focal
            axes[..., :2] *= (rod[:, None] / half[:, :2])[:, None]
            build.add_quadrics(centre, axes, material, CYLINDER)


def add_standing_objects(
    build: SceneBuilder, ground: Floats, height: Floats, width: Floats
) -> None:
    """Add boxes, vessels, cones, balls and cards that stand on the points ``ground``."""
    rng = build.rng
    kinds = rng.choice(5, len(ground), p=[0.4, 0.22, 0.13, 0.13, 0.12])
    whole = np.stack([width, height, width * rng.uniform(0.4, 1.3, len(width))], -1)
    for kind in range(5):
        half = whole[kinds == kind] / 2
        number = len(half)
        top = ground[kinds == kind] - stack_xyz(0, 2 * half[:, 1], 0)
        centre = top + stack_xyz(0, half[:, 1], 0)
        yaw = yaw_rotations(rng.uniform(-np.pi, np.pi, number))
        material = build.draw_materials(number, build.depths(centre))
        upright = scale_axes(yaw @ UPRIGHT, half[:, [0, 2, 1]])
        if kind == 0:
            build.add_boxes(centre, scale_axes(yaw, half), material)
        elif kind == 1:
            build.add_quadrics(centre, upright, material, rng.choice(OPEN, number))
            lid = rng.random(number) < 0.7
            build.add_quadrics(top[lid], upright[lid] * [1, 1, 0.02], material[lid])
        elif kind == 2:
            build.add_quadrics(centre, upright, material, CONE)
        elif kind == 3:
            build.add_quadrics(centre, upright, material)
        else:
            lean = 0.3 * half[:, 1:2] * yaw[..., 2] * rng.uniform(-1, 1, (number, 1))
            x, y = yaw[..., 0] * half[:, :1], yaw[..., 1] * half[:, 1:2] + lean
            holes = {"mask": build.draw_masks(number)} if rng.random() < 0.5 else {}
            build.add_rectangles(centre, x, y, material, **holes)


def add_tables(build: SceneBuilder, ground: Floats, yaw: Floats) -> None:
    """Add tables with objects on them."""
    rng = build.rng
    number = len(ground)
    half = rng.uniform([0.3, 0.01, 0.25], [0.9, 0.03, 0.5], (number, 3))
    tall = rng.uniform(0.4, 1.0, number)
    top = ground - stack_xyz(0, tall, 0)
    build.add_boxes(
        top, scale_axes(yaw, half), build.draw_materials(number, build.depths(top), WOOD)
    )

    def on(place: Floats) -> Floats:
        """Offsets from the middle, in half sizes (..., n, 3), turned with the table."""
        offset: Floats = np.einsum("nij,...nj->...ni", yaw, place * half)
        return offset

    wood = build.draw_materials(number, build.depths(ground))
    for x in (-0.9, 0.9):
        for z in (-0.9, 0.9):
            leg = ground + on(np.array([[x, 0, z]])) - stack_xyz(0, tall / 2, 0)
            build.add_boxes(leg, scale_axes(yaw, stack_xyz(0.025, tall / 2, 0.025)), wood)
    place = rng.uniform(-0.8, 0.8, (3, number, 3))
    place[..., 1] = -1
    at = (top + on(place)).reshape(-1, 3)
    add_standing_objects(
        build, at, rng.uniform(0.05, 0.45, len(at)), rng.uniform(0.05, 0.25, len(at))
    )


def add_shelves(build: SceneBuilder, ground: Floats, yaw: Floats) -> None:
    """Add shelves with books."""
    rng = build.rng
    for at, turn in zip(ground, yaw, strict=True):
        wide, tall, deep = rng.uniform([0.3, 0.8, 0.12], [0.8, 2.1, 0.25])
        level = np.linspace(0, tall, int(rng.integers(3, 7)))
        boards = stack_xyz(0, -level, 0), stack_xyz(wide, 0.012, deep + 0 * level)
        sides = stack_xyz([-wide, wide], -tall / 2, 0), stack_xyz([0.012] * 2, tall / 2, deep)
        back = stack_xyz(0, -tall / 2, deep), stack_xyz(wide, tall / 2, 0.005)
        local, half = (np.concatenate(part) for part in zip(boards, sides, back, strict=True))
        wood = build.draw_materials(1, build.depths(at), WOOD)[np.zeros(len(local), int)]
        build.add_boxes(at + local @ turn.T, scale_axes(turn[None], half), wood)
        base = np.repeat(level[:-1], 9)
        high = level[1] * rng.uniform(0.2, 0.45, len(base))
        across = rng.uniform(-0.9, 0.9, len(base)) * wide
        local = stack_xyz(across, -base - high, rng.uniform(-0.3, 0.3, len(base)) * deep)
        half = stack_xyz(rng.uniform(0.012, 0.05, len(base)), high, 0.6 * deep)
        books = build.draw_materials(len(base), build.depths(at))
        build.add_boxes(at + local @ turn.T, scale_axes(turn[None], half), books)


def add_cars(build: SceneBuilder, ground: Floats, yaw: Floats) -> None:
    """Add cars: a body, a cabin and four wheels each."""
    rng = build.rng
    number = len(ground)
    half = rng.uniform([0.8, 0.28, 1.8], [0.95, 0.42, 2.4], (number, 3))
    body = ground - stack_xyz(0, half[:, 1] + 0.25, 0)
    paint = build.draw_materials(number, build.depths(body))
    paint.contrast *= 0.3
    paint.gloss += rng.uniform(0, 0.4, number)
    build.add_boxes(body, scale_axes(yaw, half), paint)
    glass = build.draw_materials(number, build.depths(body))
    glass.colour *= 0.5
    cabin = body - stack_xyz(0, half[:, 1] + 0.28, 0) + yaw[..., 2] * 0.2
    build.add_boxes(cabin, scale_axes(yaw, half * [0.88, 0, 0.55] + [0, 0.3, 0]), glass)
    rubber = build.draw_materials(number, build.depths(body), ASPHALT)
    rubber.colour *= 0.3
    for x in (-0.95, 0.95):
        for z in (-0.62, 0.62):
            wheel = ground + np.einsum("nij,nj->ni", yaw, half * [x, 0, z]) - stack_xyz(0, 0.32, 0)
            size = np.tile([0.32, 0.32, 0.1], (number, 1))
            build.add_quadrics(wheel, scale_axes(yaw @ SIDEWAYS, size), rubber)


def add_bushes(build: SceneBuilder, centre: Floats, radius: Floats, leaves: Material) -> None:
    """Add leafy cards, turned at random."""
    cards = build.random_rotations(len(centre)) * radius[:, None, None]
    mask = build.draw_masks(len(centre), FOLIAGE)
    build.add_rectangles(centre, cards[..., 0], cards[..., 1], leaves, mask=mask)


def add_trees(build: SceneBuilder, ground: Floats) -> None:
    """Add trees: trunks with crowns of leafy cards."""
    rng = build.rng
    number, cards = len(ground), 6
    tall = rng.uniform(1.5, 4, number)
    bark = build.draw_materials(number, build.depths(ground), WOOD)
    add_columns(build, ground, rng.uniform(0.06, 0.25, number), tall, bark)
    which = np.tile(np.arange(number), cards)
    radius = rng.uniform(0.8, 2.2, number)
    crown = (ground - stack_xyz(0, tall + 0.6 * radius, 0))[which]
    crown += rng.normal(0, 0.45, (len(which), 3)) * radius[which, None]
    leaves = build.draw_materials(number, build.depths(ground), GRASS)[which]
    add_bushes(build, crown, radius[which] * rng.uniform(0.6, 1.0, len(which)), leaves)


def add_poles(build: SceneBuilder, ground: Floats) -> None:
    """Add poles, some with a sign."""
    rng = build.rng
    number = len(ground)
    tall = rng.uniform(2, 7, number)
    material = build.draw_materials(number, build.depths(ground))
    add_columns(build, ground, rng.uniform(0.03, 0.14, number), tall, material)
    sign = rng.random(number) < 0.5
    at = ground[sign] - stack_xyz(0, np.minimum(tall[sign], 2.6), 0.15)
    turn = yaw_rotations(rng.normal(0, 0.4, len(at))) * rng.uniform(0.25, 0.5, (len(at), 1, 1))
    board = build.draw_materials(len(at), build.depths(at))
    build.add_rectangles(at, turn[..., 0], turn[..., 1], board, mask=build.draw_masks(len(at)))


def add_people(build: SceneBuilder, ground: Floats) -> None:
    """Add people: a head, a body and two legs of ellipsoids each."""
    rng = build.rng
    number = len(ground)
    scale = rng.uniform(0.6, 1.05, number)
    skin, coat, cloth = (build.draw_materials(number, build.depths(ground)) for _ in range(3))
    parts = (
        (0, 1.62, 0.11, 0.28, skin),
        (0, 1.15, 0.24, 0.72, coat),
        (-0.1, 0.4, 0.09, 0.84, cloth),
        (0.1, 0.4, 0.09, 0.84, cloth),
    )
    for x, middle, radius, tall, material in parts:
        low = (middle - tall / 2) * scale
        foot = ground + stack_xyz(x * scale, -low, rng.normal(0, 0.08, number))
        add_columns(build, foot, radius * scale, tall * scale, material, SPHERE)


def add_fences(build: SceneBuilder, start: Floats, step: Floats, tall: Floats) -> None:
    """Add fences of bars or wire between ``start`` and ``start + step``."""
    number = len(start)
    length = np.linalg.norm(step, axis=1)
    repeat = np.stack([np.maximum(1, np.round(length / tall)), np.ones(number)], -1)
    build.add_rectangles(
        start + step / 2 - stack_xyz(0, tall / 2, 0),
        step / 2,
        stack_xyz(0, tall / 2, 0),
        build.draw_materials(number, build.depths(start)),
        mask=build.draw_masks(number, BARS, MESH),
        mask_repeat=repeat * build.rng.integers(1, 3, (number, 1)),
    )
