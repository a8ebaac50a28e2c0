"""What surfaces look like: a bank of noise and photographs with mip levels, and masks for holes."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from mobilestereonet.errors import InputError

Image = NDArray[np.float32]
SUFFIXES = {".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp", ".ppm"}


class TextureBank:
    """Square textures with mip levels, mirrored at their borders.

    Attributes:
        pixels: All levels of all textures, one int32 of four bytes (R, G, B, 0) per texel.
        means: Mean colour of each texture, (N, 3) in 0..1.
        noise: How many textures are noise; they come first, kind ``i % len(NOISE)``.
        photographs: How many textures are photographs.
    """

    def __init__(self, images: NDArray[np.uint8], noise: int, device: torch.device) -> None:
        """Build the levels of ``images`` (N, S, S, 3); S is a power of two."""
        count, size = images.shape[:2]
        self.size = size
        sizes = [(size >> level) ** 2 for level in range(size.bit_length())]
        self.starts = torch.tensor(np.cumsum([0, *sizes[:-1]]), dtype=torch.int32, device=device)
        self.texels = sum(sizes)
        pixels = np.zeros((count, self.texels, 4), dtype=np.uint8)
        for levels, image in zip(pixels, images, strict=True):
            start = 0
            for texels in sizes:
                levels[start : start + texels, :3] = image.reshape(-1, 3)
                start += texels
                half = (max(1, len(image) // 2),) * 2
                image = cv2.resize(image, half, interpolation=cv2.INTER_AREA)
        self.means = torch.from_numpy(pixels[:, -1, :3].astype(np.float32) / 255).to(device)
        self.pixels = torch.from_numpy(pixels.view(np.int32).ravel()).to(device)
        self.noise = noise
        self.photographs = count - noise

    def sample(self, texture: Tensor, x: Tensor, y: Tensor, level: Tensor) -> Tensor:
        """Bilinear colour 0..255, (3, n), at texels (x, y) of the nearest mip level, all (n,)."""
        level = level.round().clamp(0, len(self.starts) - 1)
        scale = torch.exp2(-level)
        level = level.int()
        size = self.size >> level
        x, y = x * scale - 0.5, y * scale - 0.5
        left, top = x.floor(), y.floor()
        x, y = x - left, y - top
        last = 2 * size - 1

        def mirrored(position: Tensor) -> Tensor:
            position = position & last
            return torch.minimum(position, last - position)

        column, row = left.int(), top.int()
        columns = mirrored(column), mirrored(column + 1)
        rows = mirrored(row) * size, mirrored(row + 1) * size
        # int64: a large bank has more texels than fit in int32.
        start = texture * self.texels + self.starts.index_select(0, level)
        taps = torch.stack(
            [self.pixels.index_select(0, start + (i + j)) for i in rows for j in columns]
        )
        weights = torch.stack([i * j for i in (1 - y, y) for j in (1 - x, x)])
        return torch.stack([(((taps >> shift) & 255) * weights).sum(0) for shift in (0, 8, 16)])


def read_photographs(folder: Path, size: int) -> NDArray[np.uint8]:
    """All images below ``folder``, each as its central square resized to ``size``.

    Raises:
        FileNotFoundError: If the folder does not exist.
        InputError: If it holds no readable image.
    """
    if not folder.is_dir():
        raise FileNotFoundError(f"textures: no folder {folder}; give a folder of images")
    squares = []
    for path in sorted(folder.rglob("*")):
        if path.suffix.lower() not in SUFFIXES:
            continue
        image = cv2.imread(str(path), cv2.IMREAD_COLOR)
        if image is None:
            continue
        side = min(image.shape[:2])
        top, left = (image.shape[0] - side) // 2, (image.shape[1] - side) // 2
        square = image[top : top + side, left : left + side]
        way = cv2.INTER_AREA if side > size else cv2.INTER_CUBIC
        squares.append(cv2.resize(square, (size, size), interpolation=way)[..., ::-1])
    if not squares:
        listed = ", ".join(sorted(SUFFIXES))
        raise InputError(f"textures: no readable image below {folder}; it needs files {listed}")
    return np.stack(squares)


def _field(rng: np.random.Generator, size: int, slope: float, stretch: float = 1.0) -> Image:
    """Periodic noise of spectrum 1 / f^slope in 0..1; ``stretch`` lengthens it along the rows."""
    fy = np.fft.fftfreq(size)[:, None] * size
    fx = np.fft.rfftfreq(size)[None] * size * stretch
    radius = np.maximum(np.hypot(fx, fy), 1.0)
    spectrum = np.fft.rfft2(rng.standard_normal((size, size), dtype=np.float32))
    noise = np.fft.irfft2(spectrum * radius**-slope, s=(size, size))
    low, high = np.percentile(noise, [0.5, 99.5])
    return np.clip((noise - low) / max(high - low, 1e-9), 0, 1).astype(np.float32)


def _colours(rng: np.random.Generator, count: int) -> Image:
    """Colours that are more often dull than vivid."""
    grey = rng.uniform(0.05, 0.95, (count, 1))
    tint = rng.normal(0, 1, (count, 3)) * rng.choice(
        [0.02, 0.07, 0.2], (count, 1), p=[0.45, 0.4, 0.15]
    )
    return np.clip(grey + tint, 0.02, 0.98).astype(np.float32)


def _ramp(value: Image, colours: Image) -> Image:
    """Colour a field 0..1 by linear interpolation between ``colours``."""
    stops = np.linspace(0, 1, len(colours))
    channels = [np.interp(value, stops, colours[:, i]) for i in range(3)]
    return np.stack(channels, -1).astype(np.float32)


def _grain(rng: np.random.Generator, image: Image, amount: float = 0.08) -> Image:
    noise = _field(rng, len(image), rng.uniform(0.3, 1.5)) - 0.5
    return image + amount * noise[..., None]


def _fractal(rng: np.random.Generator, size: int) -> Image:
    field = _field(rng, size, rng.uniform(0.7, 1.9))
    image = _ramp(field, _colours(rng, int(rng.integers(2, 6))))
    hue = np.stack([_field(rng, size, 1.6) for _ in range(3)], -1) - 0.5
    return image + rng.uniform(0, 0.4) * hue


def _stripes(rng: np.random.Generator, size: int) -> Image:
    y, x = np.mgrid[:size, :size] / size
    count, slant = rng.integers(4, 40), rng.integers(-8, 9)
    phase = x * count + y * slant + rng.uniform(0, 0.6) * _field(rng, size, 2.0)
    width = rng.uniform(0.2, 0.8)
    colours = _colours(rng, 2)
    wave = np.clip((np.abs((phase % 1) - 0.5) * 2 - width) * 12 + 0.5, 0, 1).astype(np.float32)
    return _grain(rng, _ramp(wave, colours))


def _checker(rng: np.random.Generator, size: int) -> Image:
    y, x = np.mgrid[:size, :size] / size
    count = 2 * rng.integers(2, 13)
    cells = (np.floor(x * count) + np.floor(y * count)) % 2
    return _grain(rng, _ramp(cells.astype(np.float32), _colours(rng, 2)), 0.12)


def _bricks(rng: np.random.Generator, size: int) -> Image:
    y, x = np.mgrid[:size, :size] / size
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
    tone = rng.normal(0, rng.uniform(0.02, 0.15), (rows, columns, 1)).astype(np.float32)
    brick, mortar = _colours(rng, 2)
    image = np.where((edge < joint)[..., None], mortar, brick + tone[row, column])
    return _grain(rng, image.astype(np.float32), 0.15)


def _dots(rng: np.random.Generator, size: int) -> Image:
    y, x = np.mgrid[:size, :size] / size
    count = int(rng.integers(5, 30))
    radius = rng.uniform(0.15, 0.45)
    row = np.floor(y * count)
    distance = np.hypot((x * count + 0.5 * (row % 2)) % 1 - 0.5, y * count % 1 - 0.5)
    blend = np.clip((radius - distance) * 8 + 0.5, 0, 1).astype(np.float32)
    return _grain(rng, _ramp(blend, _colours(rng, 2)))


def _marble(rng: np.random.Generator, size: int) -> Image:
    y, x = np.mgrid[:size, :size] / size
    veins = np.sin(
        2 * np.pi * (x * rng.integers(0, 6) + y * rng.integers(1, 6))
        + rng.uniform(4, 14) * _field(rng, size, 1.8)
    )
    return _grain(rng, _ramp((0.5 + 0.5 * veins).astype(np.float32), _colours(rng, 3)), 0.05)


def _wood(rng: np.random.Generator, size: int) -> Image:
    grain = _field(rng, size, rng.uniform(1.0, 1.5), stretch=rng.uniform(8, 30))
    dark = np.array([0.25, 0.15, 0.08]) * rng.uniform(0.5, 1.6)
    light = dark + np.array([0.4, 0.3, 0.2]) * rng.uniform(0.3, 1.2)
    return _ramp(grain, np.clip(np.stack([dark, light]), 0, 1).astype(np.float32))


def _canvas(image: Image) -> NDArray[np.uint8]:
    """What OpenCV draws on with smooth edges."""
    return np.ascontiguousarray((np.clip(image, 0, 1) * 255).round().astype(np.uint8))


def _scratches(rng: np.random.Generator, size: int) -> Image:
    image = _canvas(_ramp(_field(rng, size, 2.0), _colours(rng, 2)))
    for _ in range(int(rng.integers(60, 400))):
        start, end = rng.integers(0, size, 2), rng.integers(-size // 3, size // 3, 2)
        colour = np.clip(image[start[1], start[0]] + rng.normal(0, 50), 0, 255)
        width = int(rng.integers(1, 3))
        cv2.line(image, start.tolist(), (start + end).tolist(), colour.tolist(), width, cv2.LINE_AA)
    return image.astype(np.float32) / 255


def _leaves(rng: np.random.Generator, size: int) -> Image:
    """Dead leaves: shapes of all sizes over each other, the statistics of natural images."""
    image = _canvas(_ramp(_field(rng, size, 1.5), _colours(rng, 2)))
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
    return _grain(rng, image.astype(np.float32) / 255)


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
    return _grain(rng, image.astype(np.float32), 0.1)


def _windows(rng: np.random.Generator, size: int) -> Image:
    """A facade: rows of windows with sills, each with its own reflection."""
    y, x = np.mgrid[:size, :size] / size
    rows, columns = rng.integers(3, 8, 2)
    wall, frame = _colours(rng, 2)
    image = _grain(rng, np.broadcast_to(wall, (size, size, 3)).astype(np.float32), 0.15)
    u, v = x * columns % 1, y * rows % 1
    half = rng.uniform(0.15, 0.4, 2)
    glass = rng.uniform(0.02, 0.6, (rows, columns, 1)) * rng.uniform(0.7, 1.1, 3)
    panes = glass[(y * rows).astype(int), (x * columns).astype(int)] * (1.3 - 0.6 * v[..., None])
    away = np.maximum(np.abs(u - 0.5) - half[0], np.abs(v - 0.5) - half[1])[..., None]
    image = np.where(away < 0.04, frame, image)
    cross = (np.abs(u - 0.5) < 0.015)[..., None]
    return np.where((away < 0) & ~cross, panes, image).astype(np.float32)


def _asphalt(rng: np.random.Generator, size: int) -> Image:
    tone = rng.uniform(0.2, 0.55) * np.array([1, 1, 1 + rng.uniform(-0.1, 0.1)])
    fine, coarse = _field(rng, size, 0.2) - 0.5, _field(rng, size, rng.uniform(1, 1.6)) - 0.5
    return (
        tone + rng.uniform(0.1, 0.4) * fine[..., None] + rng.uniform(0.05, 0.3) * coarse[..., None]
    ).astype(np.float32)


def _grass(rng: np.random.Generator, size: int) -> Image:
    blades = 0.5 * _field(rng, size, rng.uniform(0.5, 1.0)) + 0.5 * _field(rng, size, 0.9).T
    dark = np.array([0.08, 0.14, 0.04]) * rng.uniform(0.6, 1.5)
    light = np.array([0.5, 0.6, 0.25]) * rng.uniform(0.6, 1.3, 3)
    image = _ramp(blades, np.clip(np.stack([dark, light]), 0, 1).astype(np.float32))
    return image * (0.7 + 0.6 * _field(rng, size, 1.6)[..., None])


def _sky(rng: np.random.Generator, size: int) -> Image:
    cloud = np.clip(
        (_field(rng, size, rng.uniform(1.5, 2.2), 2.0) - rng.uniform(0.2, 0.9)) * 2, 0, 1
    )
    blue = np.array([0.45, 0.62, 0.85]) * rng.uniform(0.8, 1.15, 3)
    return (blue + (rng.uniform(0.7, 1.0) - blue) * cloud[..., None]).astype(np.float32)


def _weave(rng: np.random.Generator, size: int) -> Image:
    y, x = np.mgrid[:size, :size] / size
    count = rng.integers(24, 90)
    over = np.where(
        (np.floor(x * count) + np.floor(y * count)) % 2 > 0,
        np.sin(np.pi * (x * count % 1)),
        np.sin(np.pi * (y * count % 1)),
    )
    value = 0.6 * over + 0.4 * _field(rng, size, 1.4)
    return _grain(rng, _ramp(value.astype(np.float32), _colours(rng, 2)), 0.1)


def _gradient(rng: np.random.Generator, size: int) -> Image:
    return _ramp(_field(rng, size, 2.6), _colours(rng, 2))


NOISE: tuple[Callable[[np.random.Generator, int], Image], ...] = (
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
    NOISE.index(kind) for kind in (_asphalt, _grass, _sky, _windows, _wood)
)


def make_noise(rng: np.random.Generator, count: int, size: int) -> NDArray[np.uint8]:
    """``count`` textures (N, S, S, 3), kind after kind."""
    images = [NOISE[i % len(NOISE)](rng, size) for i in range(count)]
    return np.stack([(np.clip(image, 0, 1) * 255).round().astype(np.uint8) for image in images])


def _bars(rng: np.random.Generator, size: int) -> NDArray[np.bool_]:
    y, x = np.mgrid[:size, :size] / size
    count, width = rng.integers(3, 10), rng.uniform(0.15, 0.5)
    mask = (x * count) % 1 < width
    for _ in range(rng.integers(0, 4)):
        at = rng.uniform(0, 1)
        mask |= np.abs(y - at) < rng.uniform(0.02, 0.05)
    return mask


def _mesh(rng: np.random.Generator, size: int) -> NDArray[np.bool_]:
    y, x = np.mgrid[:size, :size] / size
    count, width = rng.integers(3, 9), rng.uniform(0.12, 0.3)
    if rng.random() < 0.5:
        x, y = x + y, x - y
    return ((x * count) % 1 < width) | ((y * count) % 1 < width)


def _foliage(rng: np.random.Generator, size: int) -> NDArray[np.bool_]:
    """Leaves: thresholded noise within a ragged outline."""
    y, x = np.mgrid[:size, :size] / size * 2 - 1
    leaves = _field(rng, size, rng.uniform(0.9, 1.5))
    outline = 1.1 - np.hypot(x, y) + 0.6 * (_field(rng, size, 1.8) - 0.5)
    return (leaves > rng.uniform(0.35, 0.6)) & (outline > 0.1)


def _blob(rng: np.random.Generator, size: int) -> NDArray[np.bool_]:
    """One closed outline: a disc, a star, a leaf or something like a silhouette."""
    y, x = np.mgrid[:size, :size] / size * 2 - 1
    angle = np.arctan2(y, x)
    radius = np.full_like(x, 0.85)
    for order in range(2, 9):
        radius = radius + rng.normal(0, 0.25 / order) * np.cos(order * angle + rng.uniform(0, 6.3))
    return np.hypot(x, y) < np.clip(radius, 0.15, 1)


def _disc(rng: np.random.Generator, size: int) -> NDArray[np.bool_]:
    y, x = np.mgrid[:size, :size] / size * 2 - 1
    power = rng.choice([1.0, 2.0, 2.0, 4.0])
    distance = (np.abs(x) ** power + np.abs(y) ** power) ** (1 / power)
    return (distance < 0.99) & (distance > rng.choice([0.0, 0.0, 0.5, 0.75]))


def _holes(rng: np.random.Generator, size: int) -> NDArray[np.bool_]:
    y, x = np.mgrid[:size, :size] / size
    count, radius = rng.integers(1, 6), rng.uniform(0.2, 0.42)
    power = rng.choice([2.0, 8.0])
    distance = (
        np.abs((x * count) % 1 - 0.5) ** power + np.abs((y * count) % 1 - 0.5) ** power
    ) ** (1 / power)
    return distance > radius


def _polygon(rng: np.random.Generator, size: int) -> NDArray[np.bool_]:
    count = int(rng.integers(3, 8))
    angle = np.sort(rng.uniform(0, 2 * np.pi, count)) + rng.uniform(0, 6.3)
    radius = rng.uniform(0.4, 1, count) * size / 2
    points = np.stack([np.cos(angle), np.sin(angle)], -1) * radius[:, None] + size / 2
    canvas = np.zeros((size, size), np.uint8)
    cv2.fillPoly(canvas, [points.astype(np.int32)], 1)
    return canvas > 0


MASKS: tuple[Callable[[np.random.Generator, int], NDArray[np.bool_]], ...] = (
    _bars,
    _mesh,
    _foliage,
    _blob,
    _disc,
    _holes,
    _polygon,
)
BARS, MESH, FOLIAGE = (MASKS.index(kind) for kind in (_bars, _mesh, _foliage))


def make_masks(rng: np.random.Generator, count: int, size: int = 256) -> NDArray[np.bool_]:
    """``count`` masks (N, S, S), kind after kind; True is solid."""
    return np.stack([MASKS[i % len(MASKS)](rng, size) for i in range(count)])
