"""Noise textures: procedural patterns of 16 kinds."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.floating[Any]]


def unit_grid(size: int) -> tuple[Image, Image]:
    """Row and column of each texel in 0..1, (S, S) each."""
    y, x = np.meshgrid(np.arange(size) / size, np.arange(size) / size, indexing="ij")
    return y, x


def noise_field(rng: np.random.Generator, size: int, slope: float, stretch: float = 1.0) -> Image:
    """Periodic noise of spectrum 1 / f^slope in 0..1; ``stretch`` lengthens it along the rows."""
    fy = np.fft.fftfreq(size)[:, None] * size
    fx = np.fft.rfftfreq(size)[None] * size * stretch
    radius = np.maximum(np.hypot(fx, fy), 1.0)
    spectrum = np.fft.rfft2(rng.standard_normal((size, size), dtype=np.float32))
    noise = np.fft.irfft2(spectrum * radius**-slope, s=(size, size))
    low, high = np.percentile(noise, [0.5, 99.5])
    return np.asarray(np.clip((noise - low) / max(high - low, 1e-9), 0, 1), dtype=np.float32)


def _colours(rng: np.random.Generator, count: int) -> Image:
    """Colours that are more often dull than vivid."""
    grey = rng.uniform(0.05, 0.95, (count, 1))
    tint = rng.normal(0, 1, (count, 3)) * rng.choice(
        [0.02, 0.07, 0.2], (count, 1), p=[0.45, 0.4, 0.15]
    )
    return np.asarray(np.clip(grey + tint, 0.02, 0.98))


def _ramp(value: Image, colours: Image) -> Image:
    """Colour a field 0..1 by linear interpolation between ``colours``."""
    stops = np.linspace(0, 1, len(colours))
    channels = [np.interp(value, stops, colours[:, i]) for i in range(3)]
    return np.stack(channels, -1)


def _grain(rng: np.random.Generator, image: Image, amount: float = 0.08) -> Image:
    noise = noise_field(rng, len(image), rng.uniform(0.3, 1.5)) - 0.5
    return image + amount * noise[..., None]


def _fractal(rng: np.random.Generator, size: int) -> Image:
    field = noise_field(rng, size, rng.uniform(0.7, 1.9))
    image = _ramp(field, _colours(rng, int(rng.integers(2, 6))))
    hue = np.stack([noise_field(rng, size, 1.6) for _ in range(3)], -1) - 0.5
    return image + rng.uniform(0, 0.4) * hue


def _stripes(rng: np.random.Generator, size: int) -> Image:
    y, x = unit_grid(size)
    count, slant = rng.integers(4, 40), rng.integers(-8, 9)
    phase = x * count + y * slant + rng.uniform(0, 0.6) * noise_field(rng, size, 2.0)
    width = rng.uniform(0.2, 0.8)
    colours = _colours(rng, 2)
    wave = np.clip((np.abs((phase % 1) - 0.5) * 2 - width) * 12 + 0.5, 0, 1)
    return _grain(rng, _ramp(wave, colours))


def _checker(rng: np.random.Generator, size: int) -> Image:
    y, x = unit_grid(size)
    count = 2 * rng.integers(2, 13)
    cells = (np.floor(x * count) + np.floor(y * count)) % 2
    return _grain(rng, _ramp(cells, _colours(rng, 2)), 0.12)


def _bricks(rng: np.random.Generator, size: int) -> Image:
    y, x = unit_grid(size)
    rows = 2 * int(rng.integers(3, 12))
    columns = max(1, int(rows * rng.uniform(0.3, 0.8)))
    row = np.floor(y * rows).astype(int)
    shifted = (x * columns + 0.5 * (row % 2) * (rng.random() < 0.7)) % columns
    column = np.floor(shifted).astype(int)
    joint = rng.uniform(0.04, 0.12)
    edge = np.minimum(
        np.minimum(shifted % 1, 1 - shifted % 1) / columns * rows,
        np.minimum(y * rows % 1, 1 - y * rows % 1),
    )
    tone = rng.normal(0, rng.uniform(0.02, 0.15), (rows, columns, 1))
    brick, mortar = _colours(rng, 2)
    image = np.where((edge < joint)[..., None], mortar, brick + tone[row, column])
    return _grain(rng, image, 0.15)


def _dots(rng: np.random.Generator, size: int) -> Image:
    y, x = unit_grid(size)
    count = int(rng.integers(5, 30))
    radius = rng.uniform(0.15, 0.45)
    row = np.floor(y * count)
    distance = np.hypot((x * count + 0.5 * (row % 2)) % 1 - 0.5, y * count % 1 - 0.5)
    blend = np.clip((radius - distance) * 8 + 0.5, 0, 1)
    return _grain(rng, _ramp(blend, _colours(rng, 2)))


def _marble(rng: np.random.Generator, size: int) -> Image:
    y, x = unit_grid(size)
    veins = np.sin(
        2 * np.pi * (x * rng.integers(0, 6) + y * rng.integers(1, 6))
        + rng.uniform(4, 14) * noise_field(rng, size, 1.8)
    )
    return _grain(rng, _ramp((0.5 + 0.5 * veins), _colours(rng, 3)), 0.05)


def _wood(rng: np.random.Generator, size: int) -> Image:
    grain = noise_field(rng, size, rng.uniform(1.0, 1.5), stretch=rng.uniform(8, 30))
    dark = np.array([0.25, 0.15, 0.08]) * rng.uniform(0.5, 1.6)
    light = dark + np.array([0.4, 0.3, 0.2]) * rng.uniform(0.3, 1.2)
    return _ramp(grain, np.clip(np.stack([dark, light]), 0, 1))


def _canvas(image: Image) -> NDArray[np.uint8]:
    """Image as uint8, on which OpenCV draws with smooth edges."""
    return np.ascontiguousarray((np.clip(image, 0, 1) * 255).round().astype(np.uint8))


def _scratches(rng: np.random.Generator, size: int) -> Image:
    image = _canvas(_ramp(noise_field(rng, size, 2.0), _colours(rng, 2)))
    for _ in range(int(rng.integers(60, 400))):
        start, end = rng.integers(0, size, 2), rng.integers(-size // 3, size // 3, 2)
        colour = np.clip(image[start[1], start[0]] + rng.normal(0, 50), 0, 255)
        width = int(rng.integers(1, 3))
        cv2.line(image, start.tolist(), (start + end).tolist(), colour.tolist(), width, cv2.LINE_AA)
    return image / np.float32(255)


def _leaves(rng: np.random.Generator, size: int) -> Image:
    """Dead leaves: shapes of all sizes over each other, the statistics of natural images."""
    image = _canvas(_ramp(noise_field(rng, size, 1.5), _colours(rng, 2)))
    palette = _colours(rng, int(rng.integers(3, 9)))
    count = int(rng.integers(400, 1500))
    radius = np.clip(size * 0.008 / rng.uniform(0.02, 1, count), 2, size / 5)
    centre, angle = rng.integers(0, size, (count, 2)), rng.uniform(0, 360, count)
    flat, box = rng.uniform(0.2, 1, count), rng.random() < 0.3
    tone = palette[rng.integers(0, len(palette), count)] + rng.normal(0, 0.06, (count, 1))
    tone = np.clip(tone, 0, 1) * 255
    for i in range(count):
        half = (float(radius[i]), float(radius[i] * flat[i]))
        where, colour = centre[i].tolist(), tone[i].tolist()
        if box:
            points = cv2.boxPoints((where, half, float(angle[i]))).astype(np.int32)
            cv2.fillConvexPoly(image, points, colour, cv2.LINE_AA)
        else:
            axes = (int(half[0]), max(1, int(half[1])))
            cv2.ellipse(image, where, axes, float(angle[i]), 0, 360, colour, -1, cv2.LINE_AA)
    return _grain(rng, image / np.float32(255))


def _print(rng: np.random.Generator, size: int) -> Image:
    """Lines of made-up characters, as on paper, boxes and signs."""
    paper, ink = _colours(rng, 2)
    ink = np.where(abs(paper.mean() - ink.mean()) < 0.25, (paper + 0.5) % 1, ink)
    alphabet = np.zeros((40, 9, 6), dtype=np.float32)
    alphabet[:, 1:8, :5] = rng.random((40, 7, 5)) < 0.45
    page = np.zeros((size, size), dtype=np.float32)
    top = 0
    while top < size:
        scale = int(rng.choice([1, 1, 2, 2, 3, 5, 8]))
        letters = alphabet[rng.integers(0, 40, size // (6 * scale) + 1)]
        letters[rng.random(len(letters)) < 0.2] = 0
        line = np.kron(letters.transpose(1, 0, 2).reshape(9, -1), np.ones((scale, scale)))
        rows = min(len(line), size - top)
        page[top : top + rows] = line[:rows, :size]
        top += int(len(line) * rng.uniform(1, 1.6))
    image = paper + (ink - paper) * cv2.GaussianBlur(page, (3, 3), 0.7)[..., None]
    return _grain(rng, image, 0.1)


def _windows(rng: np.random.Generator, size: int) -> Image:
    """A facade: rows of windows with sills, each with its own reflection."""
    y, x = unit_grid(size)
    rows, columns = rng.integers(3, 8, 2)
    wall, frame = _colours(rng, 2)
    image = _grain(rng, np.broadcast_to(wall, (size, size, 3)), 0.15)
    u, v = x * columns % 1, y * rows % 1
    half = rng.uniform(0.15, 0.4, 2)
    glass = rng.uniform(0.02, 0.6, (rows, columns, 1)) * rng.uniform(0.7, 1.1, 3)
    panes = glass[(y * rows).astype(int), (x * columns).astype(int)] * (1.3 - 0.6 * v[..., None])
    away = np.maximum(np.abs(u - 0.5) - half[0], np.abs(v - 0.5) - half[1])[..., None]
    image = np.where(away < 0.04, frame, image)
    cross = (np.abs(u - 0.5) < 0.015)[..., None]
    return np.where((away < 0) & ~cross, panes, image)


def _asphalt(rng: np.random.Generator, size: int) -> Image:
    tone = rng.uniform(0.2, 0.55) * np.array([1, 1, 1 + rng.uniform(-0.1, 0.1)])
    fine = noise_field(rng, size, 0.2)[..., None] - 0.5
    coarse = noise_field(rng, size, rng.uniform(1, 1.6))[..., None] - 0.5
    return np.asarray(tone + rng.uniform(0.1, 0.4) * fine + rng.uniform(0.05, 0.3) * coarse)


def _grass(rng: np.random.Generator, size: int) -> Image:
    blades = noise_field(rng, size, rng.uniform(0.5, 1.0)) + noise_field(rng, size, 0.9).T
    dark = np.array([0.08, 0.14, 0.04]) * rng.uniform(0.6, 1.5)
    light = np.array([0.5, 0.6, 0.25]) * rng.uniform(0.6, 1.3, 3)
    image = _ramp(0.5 * blades, np.clip(np.stack([dark, light]), 0, 1))
    return image * (0.7 + 0.6 * noise_field(rng, size, 1.6)[..., None])


def _sky(rng: np.random.Generator, size: int) -> Image:
    cloud = np.clip(
        (noise_field(rng, size, rng.uniform(1.5, 2.2), 2.0) - rng.uniform(0.2, 0.9)) * 2, 0, 1
    )
    blue = np.array([0.45, 0.62, 0.85]) * rng.uniform(0.8, 1.15, 3)
    return np.asarray(blue + (rng.uniform(0.7, 1.0) - blue) * cloud[..., None])


def _weave(rng: np.random.Generator, size: int) -> Image:
    y, x = unit_grid(size)
    count = rng.integers(24, 90)
    over = np.where(
        (np.floor(x * count) + np.floor(y * count)) % 2 > 0,
        np.sin(np.pi * (x * count % 1)),
        np.sin(np.pi * (y * count % 1)),
    )
    value = 0.6 * over + 0.4 * noise_field(rng, size, 1.4)
    return _grain(rng, _ramp(value, _colours(rng, 2)), 0.1)


def _gradient(rng: np.random.Generator, size: int) -> Image:
    return _ramp(noise_field(rng, size, 2.6), _colours(rng, 2))


NOISE_KINDS: tuple[Callable[[np.random.Generator, int], Image], ...] = (
    _fractal,
    _stripes,
    _checker,
    _bricks,
    _dots,
    _marble,
    _wood,
    _scratches,
    _leaves,
    _print,
    _windows,
    _asphalt,
    _grass,
    _sky,
    _weave,
    _gradient,
)
ASPHALT, GRASS, SKY, WINDOWS, WOOD = (
    NOISE_KINDS.index(kind) for kind in (_asphalt, _grass, _sky, _windows, _wood)
)


def make_noise(rng: np.random.Generator, count: int, size: int) -> NDArray[np.uint8]:
    """Make ``count`` noise textures (N, S, S, 3), kind after kind."""
    images = [NOISE_KINDS[i % len(NOISE_KINDS)](rng, size) for i in range(count)]
    return np.stack([(np.clip(image, 0, 1) * 255).round().astype(np.uint8) for image in images])
