"""Texture bank: noise and photographs with mip levels."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from mobilestereonet.data.files import visible
from mobilestereonet.errors import InputError

IMAGE_SUFFIXES = {".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp", ".ppm"}


class TextureBank:
    """Square textures with mip levels, mirrored at their borders.

    Attributes:
        pixels: All levels of all textures, one int32 of four bytes (R, G, B, 0) per texel.
        means: Mean colour of each texture, (N, 3) in 0..1.
        noise: Number of noise textures; they come first, kind ``i % len(NOISE_KINDS)``.
        photographs: Number of photographs.
    """

    def __init__(self, images: NDArray[np.uint8], noise: int, device: torch.device) -> None:
        """Compute the mip levels of ``images`` (N, S, S, 3); S is a power of two."""
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


def find_photographs(folder: Path) -> list[Path]:
    """Paths of all images below ``folder``, by their suffix, in order.

    Raises:
        FileNotFoundError: If the folder does not exist.
        InputError: If there is none.
    """
    if not folder.is_dir():
        raise FileNotFoundError(
            f"textures: no folder {folder}; give a folder of images, with --textures DIR"
        )
    files = sorted(visible(folder, "**/*"))
    paths = [path for path in files if path.suffix.lower() in IMAGE_SUFFIXES]
    if not paths:
        raise _no_image(folder)
    return paths


def _no_image(folder: Path) -> InputError:
    listed = ", ".join(sorted(IMAGE_SUFFIXES))
    return InputError(f"textures: no readable image below {folder}; it needs files {listed}")


def read_photographs(folder: Path, size: int) -> NDArray[np.uint8]:
    """All images below ``folder``, each as its central square resized to ``size``.

    Raises:
        FileNotFoundError: If the folder does not exist.
        InputError: If it holds no readable image.
    """
    squares = []
    for path in find_photographs(folder):
        image = cv2.imread(str(path), cv2.IMREAD_COLOR)
        if image is None:
            continue
        side = min(image.shape[:2])
        top, left = (image.shape[0] - side) // 2, (image.shape[1] - side) // 2
        square = image[top : top + side, left : left + side]
        way = cv2.INTER_AREA if side > size else cv2.INTER_CUBIC
        squares.append(cv2.resize(square, (size, size), interpolation=way)[..., ::-1])
    if not squares:
        raise _no_image(folder)
    return np.stack(squares)
