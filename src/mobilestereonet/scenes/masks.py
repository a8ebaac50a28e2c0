"""Masks that cut holes, bars, leaves and outlines out of a rectangle."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np

from mobilestereonet.data.images import Mask
from mobilestereonet.scenes.noise import noise_field, unit_grid


def _bars(rng: np.random.Generator, size: int) -> Mask:
    y, x = unit_grid(size)
    count, width = rng.integers(3, 10), rng.uniform(0.15, 0.5)
    mask = (x * count) % 1 < width
    for _ in range(rng.integers(0, 4)):
        at = rng.uniform(0, 1)
        mask |= np.abs(y - at) < rng.uniform(0.02, 0.05)
    return mask


def _mesh(rng: np.random.Generator, size: int) -> Mask:
    y, x = unit_grid(size)
    count, width = rng.integers(3, 9), rng.uniform(0.12, 0.3)
    if rng.random() < 0.5:
        x, y = x + y, x - y
    return ((x * count) % 1 < width) | ((y * count) % 1 < width)


def _foliage(rng: np.random.Generator, size: int) -> Mask:
    """Leaves: thresholded noise within a ragged outline."""
    y, x = (2 * part - 1 for part in unit_grid(size))
    leaves = noise_field(rng, size, rng.uniform(0.9, 1.5))
    outline = 1.1 - np.hypot(x, y) + 0.6 * (noise_field(rng, size, 1.8) - 0.5)
    return (leaves > rng.uniform(0.35, 0.6)) & (outline > 0.1)


def _blob(rng: np.random.Generator, size: int) -> Mask:
    """One closed outline: a disc, a star, a leaf or something like a silhouette."""
    y, x = (2 * part - 1 for part in unit_grid(size))
    angle = np.arctan2(y, x)
    radius = np.full_like(x, 0.85)
    for order in range(2, 9):
        radius = radius + rng.normal(0, 0.25 / order) * np.cos(order * angle + rng.uniform(0, 6.3))
    return np.hypot(x, y) < np.clip(radius, 0.15, 1)


def _disc(rng: np.random.Generator, size: int) -> Mask:
    y, x = (2 * part - 1 for part in unit_grid(size))
    power = rng.choice([1.0, 2.0, 2.0, 4.0])
    distance = (np.abs(x) ** power + np.abs(y) ** power) ** (1 / power)
    hole = rng.choice([0.0, 0.0, 0.5, 0.75])
    return np.asarray((distance < 0.99) & (distance > hole))


def _holes(rng: np.random.Generator, size: int) -> Mask:
    y, x = unit_grid(size)
    count, radius = rng.integers(1, 6), rng.uniform(0.2, 0.42)
    power = rng.choice([2.0, 8.0])
    distance = (
        np.abs((x * count) % 1 - 0.5) ** power + np.abs((y * count) % 1 - 0.5) ** power
    ) ** (1 / power)
    return np.asarray(distance > radius)


def _polygon(rng: np.random.Generator, size: int) -> Mask:
    count = int(rng.integers(3, 8))
    angle = np.sort(rng.uniform(0, 2 * np.pi, count)) + rng.uniform(0, 6.3)
    radius = rng.uniform(0.4, 1, count) * size / 2
    points = np.stack([np.cos(angle), np.sin(angle)], -1) * radius[:, None] + size / 2
    canvas = np.zeros((size, size), np.uint8)
    cv2.fillPoly(canvas, [points.astype(np.int32)], 1)
    return canvas > 0


MASK_KINDS: tuple[Callable[[np.random.Generator, int], Mask], ...] = (
    _bars,
    _mesh,
    _foliage,
    _blob,
    _disc,
    _holes,
    _polygon,
)
BARS, MESH, FOLIAGE = (MASK_KINDS.index(kind) for kind in (_bars, _mesh, _foliage))


def make_masks(rng: np.random.Generator, count: int, size: int = 256) -> Mask:
    """Make ``count`` masks (N, S, S), kind after kind; True is solid."""
    return np.stack([MASK_KINDS[i % len(MASK_KINDS)](rng, size) for i in range(count)])
