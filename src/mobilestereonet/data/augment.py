"""Augmentation of stereo pairs: joint for both views and per view; disparity stays exact."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from mobilestereonet.data.sample import StereoSample, collate
from mobilestereonet.errors import InputError, needs_extra

MAX_SIDE_PX = 16_384
"""Height and width of a crop above which it would fill the memory."""


@dataclass(frozen=True, kw_only=True)
class AugmentConfig:
    """Settings of the augmentation of training pairs. The defaults only crop.

    A range (lo, hi) is drawn from uniformly; a probability is per pair or, where it says so, per
    view. Geometry first, then colour (joint, then per view), then what the sensor does.

    Attributes:
        height: Height of the random crop in pixels; None keeps the whole image.
        width: Width of the random crop in pixels; None keeps the whole image.
        scale: Range of the logarithm (base 2) of a resizing before the crop, never below what the
            crop needs. Disparity follows.
        stretch: Largest logarithm (base 2) of a stretch of the width against the height.
        stretch_probability: Probability of the stretch.
        vertical_shift: Largest vertical shift of the right view in pixels.
        rotation: Largest rotation of the right view about its centre in degrees.
        exposure: Range of the mean brightness (0..1) to which the pair is brought, as a camera's
            automatic exposure does, by a factor of at most 4; None leaves it.
        brightness: Largest relative change of the joint brightness.
        contrast: Largest relative change of the joint contrast.
        saturation: Largest relative change of the joint saturation.
        hue: Largest change of the joint hue in radians.
        gamma: Largest natural logarithm of the joint gamma.
        view_change: Share of each of the colour changes that is drawn again per view.
        one_sided: Probability that one of the views has colour changes of its own altogether.
        grey: Probability of a grey pair.
        vignette: Largest darkening of the corners.
        blur: Largest standard deviation of a Gaussian blur in pixels, drawn per view.
        blur_probability: Probability of the blur, per view.
        noise: Largest standard deviation of the sensor noise (1 = white), drawn per view.
        patch_probability: Probability that a patch of the right view is painted in its mean colour.
        patch: Range of the patch's sides in pixels.

    Raises:
        InputError: If height or width are not positive.
    """

    height: int | None = None
    width: int | None = None
    scale: tuple[float, float] = (0.0, 0.0)
    stretch: float = 0.0
    stretch_probability: float = 0.8
    vertical_shift: float = 0.0
    rotation: float = 0.0
    exposure: tuple[float, float] | None = None
    brightness: float = 0.0
    contrast: float = 0.0
    saturation: float = 0.0
    hue: float = 0.0
    gamma: float = 0.0
    view_change: float = 0.0
    one_sided: float = 0.0
    grey: float = 0.0
    vignette: float = 0.0
    blur: float = 0.0
    blur_probability: float = 0.0
    noise: float = 0.0
    patch_probability: float = 0.0
    patch: tuple[int, int] = (20, 80)

    def __post_init__(self) -> None:
        for name in ("height", "width"):
            value = getattr(self, name)
            if value is not None and value <= 0:
                raise InputError(f"augment: {name} must be positive, got {value}")
            if value is not None and value > MAX_SIDE_PX:
                raise InputError(f"augment: {name} must be at most {MAX_SIDE_PX}, got {value}")
        for name, value in vars(self).items():
            if isinstance(value, tuple) and not value[0] <= value[-1]:
                raise InputError(f"augment: {name} must be a range, got {value}")


def geometry_only(config: AugmentConfig) -> AugmentConfig:
    """The geometric part of a config: crop, scale, stretch and misalignment.

    Generators in the same state give the same geometry under both.
    """
    return AugmentConfig(
        height=config.height,
        width=config.width,
        scale=config.scale,
        stretch=config.stretch,
        stretch_probability=config.stretch_probability,
        vertical_shift=config.vertical_shift,
        rotation=config.rotation,
    )


def augment(
    pairs: Sequence[StereoSample], config: AugmentConfig, generators: Sequence[np.random.Generator]
) -> StereoSample:
    """Augment pairs, on their device, to a batch.

    Args:
        pairs: B pairs, not batched, of any sizes: images (3, H, W), in 0..1 or as bytes.
        config: Settings.
        generators: One random generator per pair: a pair's augmentation does not depend on the
            batch that it is in.

    Returns:
        Batch of the crop's size, images in 0..1, with disparity and masks to match.

    Raises:
        InputError: If the crop is larger than an image, or pairs are not cropped to one size.
    """
    cut = [_cut(pair, config, rng) for pair, rng in zip(pairs, generators, strict=True)]
    sample = collate(cut)
    if config.vertical_shift or config.rotation:
        sample = _misalign(sample, config, generators)
    views = torch.stack((sample.left, sample.right), dim=1)  # (B, 2, 3, H, W)
    if config.exposure is not None:
        views = _expose(views, config.exposure, generators)
    views = _sensor(_colour(views, config, generators), config, generators)
    grey = torch.tensor([g.uniform() < config.grey for g in generators], device=views.device)
    views = torch.where(grey[:, None, None, None, None], _luminance(views), views)
    right = _patch(views[:, 1], config, generators)
    return replace(sample, left=views[:, 0], right=right)


def _cut(pair: StereoSample, config: AugmentConfig, generator: np.random.Generator) -> StereoSample:
    """Cut a window out of one pair and resize it to the crop's size."""
    height, width = pair.left.shape[-2:]
    tall, wide = _factors(config, (height, width), generator)
    rows, columns = config.height or round(height * tall), config.width or round(width * wide)
    # What the crop shows, in pixels of the pair; all of it where there is no crop.
    high = min(height, round(rows / tall)) if config.height else height
    across = min(width, round(columns / wide)) if config.width else width
    if rows / tall > height + 0.5 or columns / wide > width + 0.5:
        raise InputError(
            f"crop {rows} x {columns} is larger than the image {height} x {width} "
            f"({pair.name or 'unnamed'}): choose a smaller crop"
        )
    top, start = generator.integers((height - high + 1, width - across + 1))

    def window(value: Tensor) -> Tensor:
        part = value[..., top : top + high, start : start + across]
        return part.float() / 255 if part.dtype == torch.uint8 else part

    pair = pair.map(window)
    return pair if (high, across) == (rows, columns) else _resize(pair, rows, columns)


def _factors(
    config: AugmentConfig, size: tuple[int, int], generator: np.random.Generator
) -> tuple[float, float]:
    """Factors of height and width, no smaller than the crop needs if they are drawn."""
    if config.scale == (0.0, 0.0) and not config.stretch:
        return 1.0, 1.0
    octaves = generator.uniform(*config.scale)
    stretch, chance = generator.uniform(-config.stretch, config.stretch), generator.uniform()
    half = 0.5 * stretch * (chance < config.stretch_probability)
    tall, wide = 2.0 ** (octaves - half), 2.0 ** (octaves + half)
    least = max((config.height or 0) / size[0] / tall, (config.width or 0) / size[1] / wide, 1.0)
    return tall * least, wide * least


def _resize(pair: StereoSample, height: int, width: int) -> StereoSample:
    """Resize views smoothly and masks to the nearest pixel; disparity scales with the width."""

    def resize(value: Tensor, **how: Any) -> Tensor:
        batch = value[None] if value.dim() == 3 else value[None, None]
        resized = F.interpolate(batch.float(), (height, width), **how)
        return resized.view(*value.shape[:-2], height, width)

    def resize_any(value: Tensor) -> Tensor:
        if value.dim() == 3:
            return resize(value, mode="bilinear", antialias=True).clamp(0, 1)
        return resize(value, mode="nearest-exact").to(value.dtype)

    resized = pair.map(resize_any)
    if pair.disparity is None or resized.disparity is None:
        return resized
    # Between two surfaces only the nearest pixel is right; on one, the nearest may be half a
    # pixel off, which on a slanted one is a wrong disparity.
    nearest, smooth = resized.disparity, resize(pair.disparity, mode="bilinear")
    one_surface = (smooth - nearest).abs() < 1
    if pair.valid is not None:
        one_surface &= resize(pair.valid, mode="bilinear") > 0.999
    disparity = torch.where(one_surface, smooth, nearest) * (width / pair.left.shape[-1])
    return replace(resized, disparity=disparity)


def _draw(
    generators: Sequence[np.random.Generator], shape: tuple[int, ...], like: Tensor
) -> Tensor:
    """Uniform numbers in -1..1, (B, *shape)."""
    values = np.stack([generator.uniform(-1, 1, shape) for generator in generators])
    return torch.as_tensor(values, dtype=like.dtype, device=like.device)


def _misalign(
    sample: StereoSample, config: AugmentConfig, generators: Sequence[np.random.Generator]
) -> StereoSample:
    """Rotate the right view about its centre and shift it vertically, as bad rectification does.

    The rotation moves matches horizontally as well: the disparity follows exactly.
    """
    batch, _, height, width = sample.right.shape
    drawn = _draw(generators, (2,), sample.right)
    angle = drawn[:, 0] * math.radians(config.rotation)
    shift = drawn[:, 1] * config.vertical_shift
    cos, sin = angle.cos(), angle.sin()
    # affine_grid maps each output pixel to the input pixel that it shows, in units of half sizes.
    aspect = height / width
    theta = sample.right.new_zeros(batch, 2, 3)
    theta[:, 0, 0], theta[:, 0, 1] = cos, sin * aspect
    theta[:, 1, 0], theta[:, 1, 1] = -sin / aspect, cos
    theta[:, 0, 2] = -sin * shift * 2 / width
    theta[:, 1, 2] = -cos * shift * 2 / height
    grid = F.affine_grid(theta, list(sample.right.shape), align_corners=False)
    right = F.grid_sample(sample.right, grid, padding_mode="border", align_corners=False)
    if sample.disparity is None:
        return replace(sample, right=right)
    # Forward: input (x, y) relative to the centre goes to x cos - y sin.
    x = torch.arange(width, device=right.device) - (width - 1) / 2
    y = torch.arange(height, device=right.device)[:, None] - (height - 1) / 2
    cos, sin = cos[:, None, None], sin[:, None, None]
    matched = (x - sample.disparity) * cos - y * sin
    disparity = x - matched
    if sample.valid is not None:
        disparity = torch.where(sample.valid, disparity, 0)
    return replace(sample, right=right, disparity=disparity)


def _expose(
    views: Tensor, limits: tuple[float, float], generators: Sequence[np.random.Generator]
) -> Tensor:
    targets = views.new_tensor([generator.uniform(*limits) for generator in generators])
    mean = views.mean(dim=(1, 2, 3, 4)).clamp_min(1e-3)
    gain = (targets / mean).clamp(0.25, 4)
    return (views * gain[:, None, None, None, None]).clamp(0, 1)


def _colour(
    views: Tensor, config: AugmentConfig, generators: Sequence[np.random.Generator]
) -> Tensor:
    """Brightness, contrast, saturation, hue, gamma: joint, plus a share per view."""
    drawn = _draw(generators, (3, 5), views)  # joint, left, right
    change = drawn[:, :1] + config.view_change * drawn[:, 1:]  # (B, 2, 5)
    if config.one_sided:
        side, chance = (_draw(generators, (2,), views) / 2 + 0.5).unbind(1)
        own = torch.stack((side < 0.5, side >= 0.5), 1) & (chance < config.one_sided)[:, None]
        change = torch.where(own[..., None], drawn[:, 1:], change)
    limits = (config.brightness, config.contrast, config.saturation, config.hue, config.gamma)
    if not any(limits):
        return views
    amount = (change * views.new_tensor(limits)).flatten(0, 1)
    flat = views.flatten(0, 1)
    if config.hue:
        with needs_extra("train"):
            from kornia.enhance import adjust_hue

        flat = adjust_hue(flat, amount[:, 3])
    luminance = _luminance(flat)
    flat = luminance + (flat - luminance) * (1 + amount[:, 2])[:, None, None, None]
    mean = luminance.mean(dim=(1, 2, 3), keepdim=True)
    flat = mean + (flat - mean) * (1 + amount[:, 1])[:, None, None, None]
    flat = (flat * (1 + amount[:, 0])[:, None, None, None]).clamp(0, 1)
    flat = flat.clamp_min(1e-6) ** amount[:, 4].exp()[:, None, None, None]
    return flat.view_as(views)


def _luminance(images: Tensor) -> Tensor:
    weights = images.new_tensor([0.299, 0.587, 0.114])
    return (images * weights[:, None, None]).sum(dim=-3, keepdim=True)


def _sensor(
    views: Tensor, config: AugmentConfig, generators: Sequence[np.random.Generator]
) -> Tensor:
    """Vignetting, blur and noise, drawn per view."""
    height, width = views.shape[-2:]
    drawn = _draw(generators, (2, 4), views) / 2 + 0.5  # (B, 2, 4) in 0..1
    flat, amount = views.flatten(0, 1), drawn.flatten(0, 1)
    if config.vignette:
        x = torch.linspace(-1, 1, width, device=views.device)
        y = torch.linspace(-1, 1, height, device=views.device)[:, None]
        fall = (x * x + y * y) / 2
        flat = flat * (1 - config.vignette * amount[:, 0, None, None, None] * fall)
    if config.blur:
        with needs_extra("train"):
            from kornia.filters import gaussian_blur2d

        sigma = 0.05 + config.blur * amount[:, 1] * (amount[:, 2] < config.blur_probability)
        size = 2 * math.ceil(2.5 * config.blur) + 1
        flat = gaussian_blur2d(flat, size, sigma[:, None].expand(-1, 2))
    if config.noise:
        deviation = config.noise * amount[:, 3]
        flat = flat + deviation[:, None, None, None] * _grain(views, generators).flatten(0, 1)
    return flat.clamp(0, 1).view_as(views)


def _grain(views: Tensor, generators: Sequence[np.random.Generator]) -> Tensor:
    """Normal random numbers of the views' shape, drawn on their device."""
    grain = torch.empty_like(views)
    for of_pair, generator in zip(grain, generators, strict=True):
        source = torch.Generator(views.device).manual_seed(int(generator.integers(2**63)))
        of_pair.normal_(generator=source)
    return grain


def _patch(
    right: Tensor, config: AugmentConfig, generators: Sequence[np.random.Generator]
) -> Tensor:
    """Paint a rectangle of the right view in the view's mean colour.

    What the left view sees there has no partner, as behind a nearer object.
    """
    if not config.patch_probability:
        return right
    height, width = right.shape[-2:]
    right = right.clone()
    for image, generator in zip(right, generators, strict=True):
        if generator.uniform() >= config.patch_probability:
            continue
        rows, columns = generator.integers(config.patch[0], config.patch[1] + 1, 2)
        top, start = generator.integers(height), generator.integers(width)
        colour = image.mean(dim=(1, 2), keepdim=True)
        image[:, top : top + rows, start : start + columns] = colour
    return right
