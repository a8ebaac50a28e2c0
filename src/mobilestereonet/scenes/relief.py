"""Photographs on reliefs: both views shown from one photograph over procedural depth.

What is seen has the statistics of photographs, unlike rendered surfaces: edges in the picture that
are none in depth, and the other way round. A relief is a stack of layers, each a smooth disparity
map with holes, over the frame of a camera in the middle between the two. A point of a layer at
column X there, of disparity d(X), appears at X + d / 2 in the left view and at X - d / 2 in the
right one; both views are resampled alike.
"""

from __future__ import annotations

import numpy as np
import torch
import torch.nn.functional as F
from numpy.typing import NDArray
from torch import Tensor

from mobilestereonet.scenes.materials import log_uniform
from mobilestereonet.scenes.textures import TextureBank

MAX_SLOPE = 0.6
"""Largest change of a layer's disparity per column: 2 would hide the surface behind itself."""

SOLVER_STEPS = 12
"""Steps of the fixed point x = X + d(X) / 2, each of which divides the error by 2 / slope."""

OCCLUSION_MARGIN_PX = 0.25


def _smooth(rng: np.random.Generator, size: tuple[int, int], cell: float) -> NDArray[np.float32]:
    """Smooth random map in about -1..1 with bumps of ``cell`` pixels."""
    grid = [int(side / cell) + 4 for side in size]
    values = torch.from_numpy(rng.uniform(-1, 1, (1, 1, *grid)).astype(np.float32))
    whole = [int((count - 1) * cell) for count in grid]
    large = F.interpolate(values, whole, mode="bicubic", align_corners=True)
    found: NDArray[np.float32] = large[0, 0, : size[0], : size[1]].numpy()
    return found


def _disparity(
    rng: np.random.Generator, size: tuple[int, int], low: float, high: float
) -> NDArray[np.float32]:
    """A layer's disparity: a slanted plane with bumps, all of it between ``low`` and ``high``."""
    height, width = size
    y, x = np.mgrid[-1 : 1 : height * 1j, -1 : 1 : width * 1j].astype(np.float32)
    across, down = rng.uniform(-1, 1, 2)
    shape = across * x + down * y
    for cell in (0.5 * width, 0.2 * width, 0.07 * width):
        shape = shape + rng.uniform(0, 0.5) * _smooth(rng, size, cell) * cell / (0.5 * width)
    shape = (shape - shape.min()) / max(float(np.ptp(shape)), 1e-6)
    steepest = float(np.abs(np.diff(shape, axis=1)).max())
    span = min(high - low, MAX_SLOPE / max(steepest, 1e-6))
    found: NDArray[np.float32] = low + (high - low - span) * rng.random() + span * shape
    return found.astype(np.float32)


def _cover(rng: np.random.Generator, size: tuple[int, int]) -> NDArray[np.float32]:
    """Which part of a layer is there (1) and which is a hole (0), smooth over a pixel's width."""
    cell = log_uniform(rng, 0.06, 0.4) * size[1]
    level = _smooth(rng, size, cell) + 0.3 * _smooth(rng, size, cell / 4) - rng.uniform(0, 0.5)
    slope = np.hypot(*np.gradient(level)) + 1e-6
    found: NDArray[np.float32] = np.clip(level / slope + 0.5, 0, 1)
    return found.astype(np.float32)


def _at(values: Tensor, columns: Tensor) -> Tensor:
    """Values of a map (H, W) at real columns (H, w) of each row, linear between pixels."""
    columns = columns.clamp(0, values.shape[1] - 1.001)
    left = columns.floor()
    index = left.long()
    return torch.lerp(values.gather(1, index), values.gather(1, index + 1), columns - left)


def render_relief(
    rng: np.random.Generator,
    size: tuple[int, int],
    disparities: tuple[float, float],
    bank: TextureBank,
) -> tuple[Tensor, Tensor, Tensor]:
    """Show a photograph, or a noise texture if the bank has none, on a relief.

    Args:
        rng: The scene's generator.
        size: Height and width of the views, in pixels.
        disparities: Lowest and highest disparity, in pixels.
        bank: Textures.

    Returns:
        Images (2, 3, H, W) in 0..1, the left view's disparity (H, W) in pixels, and whether the
        left pixel is hidden in the right view (H, W).
    """
    height, width = size
    device = bank.pixels.device
    margin = int(disparities[1]) // 2 + 2
    frame = (height, width + 2 * margin)
    layers = int(rng.integers(1, 5))
    # Disjoint ranges: each layer lies before those that came before it.
    cuts = np.sort(rng.uniform(*disparities, layers - 1))
    bounds = np.array([disparities[0], *cuts, disparities[1]])
    first, count = (bank.noise, bank.photographs) if bank.photographs else (0, bank.noise)
    one = rng.random() < 0.5
    texture = int(first + rng.integers(count))
    density, start = log_uniform(rng, 0.5, 1.5), rng.uniform(0, 2 * bank.size, 2)
    column = torch.arange(width, device=device).expand(height, -1)
    row = torch.arange(height, device=device)[:, None].expand(-1, width)
    images = torch.zeros(2, 3, height, width, device=device)
    seen = torch.zeros(2, height, width, device=device)
    for layer in range(layers):
        low, high = bounds[layer], bounds[layer + 1]
        shape = torch.from_numpy(_disparity(rng, frame, low, high)).to(device)
        cover = _cover(rng, frame) if layer else np.ones(frame, np.float32)
        there = torch.from_numpy(cover).to(device)
        if not one:
            texture = int(first + rng.integers(count))
        for view, side in enumerate((0.5, -0.5)):
            disparity = torch.full((height, width), float(low + high) / 2, device=device)
            for _ in range(SOLVER_STEPS):
                disparity = _at(shape, column - side * disparity + margin)
            place = column - side * disparity
            share = _at(there, place + margin)
            colour = bank.sample(
                torch.full((height * width,), texture, device=device),
                (place * density + start[0]).flatten(),
                (row * density + start[1]).flatten(),
                torch.full((height * width,), float(np.log2(density)), device=device),
            )
            images[view] = torch.lerp(images[view], colour.view(3, height, width) / 255, share)
            seen[view] = torch.where(share > 0.5, disparity, seen[view])
    left = seen[0].contiguous()
    matched = column - left
    other = seen[1].gather(1, matched.round().long().clamp(0, width - 1))
    return images, left, (other > left + OCCLUSION_MARGIN_PX) | (matched < -0.5)
