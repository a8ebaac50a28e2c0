"""Shading of rays: texture, light, shadow and highlight."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from mobilestereonet.scenes.appearance import Appearance
from mobilestereonet.scenes.projection import ProjectedSurfaces
from mobilestereonet.scenes.textures import TextureBank

MIRRORED_TEXTURES = 1.5
"""Textures, beside each other, that make up half of the surroundings of a mirror."""

# Rays shaded at once on the CPU: the working set stays in the cache.
CPU_BLOCK_RAYS = 1 << 16


@dataclass(frozen=True)
class Rays:
    """Block of rays: h rows of both views of b scenes."""

    x: Tensor  # (W,)
    y: Tensor  # (h, 1)
    disparity: Tensor  # (b, 2, h, W)
    surface: Tensor  # (b, 2, h, W)
    light: Tensor  # (b, 22)
    surroundings: Tensor  # (b,)
    lamp: tuple[Tensor, Tensor]  # the lamp's view: disparity and surface, (b, H, W)


def _dot(a: Sequence[Tensor], b: Sequence[Tensor]) -> Tensor:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _shade_quadrics(
    projected: ProjectedSurfaces,
    appearance: Appearance,
    rays: Rays,
    depth: Tensor,
    flat: Sequence[Tensor],
) -> None:
    """Overwrite texel coordinates and normals, flattened, where the surface is a quadric."""
    surface = rays.surface.flatten()
    where = torch.nonzero(appearance.curved.index_select(0, surface))[:, 0]
    if not len(where):
        return
    width = rays.x.shape[0]
    height = rays.y.shape[0]
    which = surface[where]
    view = where // (height * width) % 2
    x = rays.x[where % width]
    y = rays.y[where // width % height, 0]
    beyond = depth.flatten()[where] - projected.anchor[which, view]

    def pick(columns: Tensor, at: Tensor) -> list[Tensor]:
        return [column.index_select(0, at) for column in columns]

    rows = pick(appearance.curve, 2 * which + view)
    place = [rows[i] * x + rows[i + 1] * y + rows[i + 2] for i in range(0, 18, 3)]
    lx, ly, lz = (place[i] + beyond * place[i + 3] for i in range(3))
    alpha, beta, _ = pick(projected.quadric.T.contiguous(), which)
    gradient = (lx, ly, alpha * lz + 0.5 * beta)
    rows = pick(appearance.turn, which)
    normal = [_dot(rows[i : i + 3], gradient) for i in range(0, 9, 3)]
    length = _dot(normal, normal).rsqrt()
    angle = torch.atan2(ly, lx)
    rows = pick(appearance.texels, which)
    texel = [rows[i] * angle + rows[i + 1] * lz + rows[i + 2] for i in (0, 3)]
    values = (*texel, *(length * component for component in normal))
    for target, value in zip(flat, values, strict=True):
        target[where] = value


def _lamp_visibility(rays: Rays, light: Tensor, from_lamp: Sequence[Tensor], own: Tensor) -> Tensor:
    """Shadow map look-up: share of the lamp's light that reaches the rays' points, 0..1.

    A point lies in shadow if the lamp sees another surface there that is clearly nearer to it.
    """
    lamp_disparity, lamp_surface = rays.lamp
    height, width = lamp_surface.shape[-2:]
    axes = light[12:21].unflatten(0, (3, 3))
    depth = _dot(from_lamp, axes[2])
    scale = light[11] / depth
    x = _dot(from_lamp, axes[0]) * scale + 0.5 * width
    y = _dot(from_lamp, axes[1]) * scale + 0.5 * height
    seen = (
        (depth > 0) & (depth < light[21]) & (x > 1) & (x < width - 1) & (y > 1) & (y < height - 1)
    )
    scenes = torch.arange(len(lamp_surface), device=x.device, dtype=torch.int32)
    column = x.nan_to_num(0.0).clamp(0, width - 2).int()
    row = y.nan_to_num(0.0).clamp(0, height - 2).int()
    cell = scenes.view(-1, 1, 1, 1) * (height * width) + row * width + column
    # Disparity in the lamp's view is focal * baseline of the camera over the lamp's depth.
    limit = 1.03 * light[0] * light[3] / depth
    lit = torch.zeros_like(x)
    x, y = x - column, y - row
    for step, weight in (
        (0, (1 - y) * (1 - x)),
        (1, (1 - y) * x),
        (width, y * (1 - x)),
        (width + 1, y * x),
    ):
        at = (cell + step).flatten()
        blocker = lamp_disparity.flatten().index_select(0, at).view_as(x)
        same = lamp_surface.flatten().index_select(0, at).view_as(own) == own
        lit += ((blocker <= limit) | same) * weight
    return torch.where(seen, lit, 1.0)


def _texels_and_normals(
    projected: ProjectedSurfaces, appearance: Appearance, rays: Rays, depth: Tensor
) -> tuple[list[Tensor], list[Tensor]]:
    """Texel coordinates (x, y) and normals (x, y, z) of the rays' points, (b, 2, h, W) each."""
    surface = rays.surface.flatten()
    view = torch.arange(2, device=surface.device)[None, :, None, None]

    def pick(values: Tensor) -> Tensor:
        return values.index_select(0, surface).view(rays.surface.shape)

    seen_from = (2 * rays.surface + view).flatten()
    texel = [
        appearance.start[i].index_select(0, seen_from).view(rays.surface.shape)
        + depth
        * (
            pick(appearance.step[3 * i]) * rays.x
            + (pick(appearance.step[3 * i + 1]) * rays.y)
            + pick(appearance.step[3 * i + 2])
        )
        for i in range(2)
    ]
    normal = [pick(column) for column in appearance.normal]
    _shade_quadrics(
        projected, appearance, rays, depth, [values.view(-1) for values in (*texel, *normal)]
    )
    return texel, normal


def _mirror_surroundings(
    image: Tensor,
    mirror: Tensor,
    look: Sequence[Tensor],
    normal: Sequence[Tensor],
    level: Tensor,
    bank: TextureBank,
    rays: Rays,
) -> None:
    """Mix what mirrors show into the image (3, b, 2, h, W).

    The surroundings are infinitely far away: what is seen of them depends on the direction alone
    into which a surface throws a ray back, so it moves over the surface from view to view. At
    grazing angles everything mirrors (Schlick's approximation of Fresnel's equations).
    """
    where = torch.nonzero(mirror.flatten())[:, 0]
    scene = where // (mirror.numel() // len(mirror))

    def pick(values: Tensor) -> Tensor:
        return values.flatten().index_select(0, where)

    ray, across = [pick(part) for part in look], [pick(part) for part in normal]
    facing = _dot(ray, across)
    x, y, z = (a - 2 * facing * b for a, b in zip(ray, across, strict=True))
    share = pick(mirror)
    share = share + (1 - share) * (1 - facing.abs()).clamp_min(0) ** 5
    scale = MIRRORED_TEXTURES * bank.size / (1 + z.abs())
    seen = bank.sample(rays.surroundings[scene], x * scale, y * scale, pick(level)) / 255
    ambient, diffuse = rays.light[scene, 7], rays.light[scene, 8]
    seen = seen * (ambient + diffuse)
    for channel, shown in zip(image.view(3, -1), seen, strict=True):
        channel[where] = torch.lerp(channel[where], shown, share)


def shade(
    projected: ProjectedSurfaces,
    appearance: Appearance,
    bank: TextureBank,
    rays: Rays,
    coarser: float,
) -> Tensor:
    """Shade a block of rays: colour (3, b, 2, h, W)."""
    surface = rays.surface.flatten()
    shape = rays.surface.shape
    light = rays.light.T[:, :, None, None, None]
    focal, cx, cy, baseline, *lamp = light[:7]
    ambient, diffuse, reach, shininess = light[7:11]
    view = torch.arange(2, device=surface.device)[None, :, None, None]

    def pick(values: Tensor) -> Tensor:
        return values.index_select(0, surface).view(shape)

    depth = focal * baseline / rays.disparity
    texel, normal = _texels_and_normals(projected, appearance, rays, depth)
    # The point seen, from the left camera, from the camera that sees it, and from the lamp.
    shift = view * baseline
    from_eye = (depth * ((rays.x - cx) / focal), depth * ((rays.y - cy) / focal), depth)
    from_lamp = (from_eye[0] + (shift - lamp[0]), from_eye[1] - lamp[1], from_eye[2] - lamp[2])
    to_eye = _dot(from_eye, from_eye).rsqrt()
    squared = _dot(from_lamp, from_lamp)
    to_lamp = squared.rsqrt()
    facing = _dot(normal, from_eye) * to_eye
    cosine = facing.abs().clamp_min(0.05)
    sign = -facing.sign()  # towards the camera
    lambert = (-_dot(normal, from_lamp) * to_lamp * sign).clamp_min(0)
    lit = _lamp_visibility(rays, light, from_lamp, rays.surface) * (reach / (reach + squared))
    shading = ambient * (1 - 0.25 * normal[1] * sign) + diffuse * lit * lambert
    half = [a * to_eye + b * to_lamp for a, b in zip(from_eye, from_lamp, strict=True)]
    glance = (-_dot(normal, half) * sign * _dot(half, half).rsqrt()).clamp_min(1e-6)
    highlight = pick(appearance.gloss) * lit * torch.exp2(shininess * glance.log2())
    # Between the footprint's short and long side: a slanted surface's foreshortening is shared
    # by the five samples per pixel and some blur.
    footprint = pick(appearance.footprint) / (rays.disparity * (cosine * cosine.sqrt()).sqrt())
    texture = appearance.texture.index_select(0, surface)
    colour = bank.sample(
        texture, texel[0].flatten(), texel[1].flatten(), footprint.log2().flatten() + coarser
    )
    image = torch.stack(
        [
            (pick(appearance.base[i]) + pick(appearance.gain[i]) * colour[i].view(shape)) * shading
            for i in range(3)
        ]
    )
    mirror = pick(appearance.mirror)
    if mirror.any():
        look = [component * to_eye for component in from_eye]
        coarse = 2.0 * pick(appearance.curved)  # a curved one shows them smaller
        _mirror_surroundings(image, mirror, look, normal, coarse, bank, rays)
    image += highlight
    return image


def shade_images(
    projected: ProjectedSurfaces,
    appearance: Appearance,
    bank: TextureBank,
    found: tuple[Tensor, Tensor],
    lamp: tuple[Tensor, Tensor],
    offset: float,
    coarser: float,
) -> Tensor:
    """Shade one ray per pixel.

    Args:
        projected: Surfaces.
        appearance: Their appearance.
        bank: Textures.
        found: Disparity and surface of the rays, (B, 2, H, W).
        lamp: Disparity and surface in the lamp's view, (B, H, W).
        offset: Added to the pixels' positions.
        coarser: Added to the textures' mip level.

    Returns:
        Images (3, B, 2, H, W).
    """
    disparity, surface = found
    scenes, _, height, width = disparity.shape
    x = torch.arange(width, device=disparity.device) + offset
    y = torch.arange(height, device=disparity.device)[:, None] + offset
    image = torch.empty(3, *disparity.shape, device=disparity.device)

    def blocks() -> Iterator[tuple[slice, slice]]:
        if disparity.device.type != "cpu":
            yield slice(None), slice(None)
            return
        step = max(1, CPU_BLOCK_RAYS // (2 * width))
        for scene in range(scenes):
            for top in range(0, height, step):
                yield slice(scene, scene + 1), slice(top, top + step)

    for part, rows in blocks():
        rays = Rays(
            x=x,
            y=y[rows],
            # A ray may slip through a seam between surfaces: finite for all that.
            disparity=disparity[part, :, rows].clamp_min(1e-4),
            surface=surface[part, :, rows].contiguous(),
            light=appearance.light[part],
            surroundings=appearance.surroundings[part],
            lamp=(lamp[0][part], lamp[1][part]),
        )
        image[:, part, :, rows] = shade(projected, appearance, bank, rays, coarser)
    return image
