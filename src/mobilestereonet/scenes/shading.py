"""Shading of rays: texture, light, shadow and highlight."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from mobilestereonet.scenes.casting import (
    ProjectedSurfaces,
    concat_field,
    lamp_axes,
    lamp_focal,
    to_device,
)
from mobilestereonet.scenes.scene import QUADRIC, Scene
from mobilestereonet.scenes.textures import TextureBank

# Rays shaded at once on the CPU: the working set stays in the cache.
CPU_BLOCK_RAYS = 1 << 16


@dataclass(frozen=True)
class Materials:
    """Appearance of the surfaces of a batch of scenes; n surfaces.

    Columns lie in the first dimension, as picking from one column at a time is fastest.

    Attributes:
        curved: Whether the surface is a quadric, (n,).
        start: Texel coordinates of the eye seen through a rectangle's frame, (2, 2 n): x and y,
            for surface and view in this order.
        step: Change of the texel coordinates with depth: rows of x and y, (6, n).
        curve: Rows of a quadric's local position at its anchor and of its change with depth, for
            surface and view in this order, (18, 2 n).
        turn: Local gradient of a quadric to the camera's frame, (9, n).
        texels: Local surface coordinates to texels, (6, n).
        normal: A rectangle's unit normal, (3, n).
        footprint: Texels per pixel times disparity, seen head-on, (n,).
        texture: Index of the texture, (n,).
        base: Colour that does not vary, (3, n).
        gain: Factor on the texture's bytes, (3, n).
        gloss: Strength of the highlight, (n,).
        light: One row per scene: the camera and the lamp, (B, 22).
    """

    curved: Tensor
    start: Tensor
    step: Tensor
    curve: Tensor
    turn: Tensor
    texels: Tensor
    normal: Tensor
    footprint: Tensor
    texture: Tensor
    base: Tensor
    gain: Tensor
    gloss: Tensor
    light: Tensor


def _light_row(scene: Scene, size: tuple[int, int]) -> list[float]:
    camera = [scene.focal, scene.cx, scene.cy, scene.baseline]
    lamp = [*scene.light, scene.ambient, scene.diffuse, scene.reach**2, scene.shininess]
    # Beyond the lit region, as on the sky, nothing casts a shadow.
    farthest = float(np.linalg.norm(scene.focus - scene.light)) + 4 * scene.spread
    return [*camera, *lamp, lamp_focal(scene, size), *lamp_axes(scene).ravel(), farthest]


def make_materials(
    scenes: Sequence[Scene], projected: ProjectedSurfaces, size: tuple[int, int], bank: TextureBank
) -> Materials:
    """Gather the materials of all scenes on the device of ``bank``."""
    device = bank.pixels.device
    baseline = np.repeat(
        [scene.baseline for scene in scenes], [len(scene.surfaces.shape) for scene in scenes]
    )
    texture = to_device(concat_field(scenes, "texture"), device)
    colour = to_device(concat_field(scenes, "colour"), device).T
    contrast = to_device(concat_field(scenes, "contrast"), device)
    texels = to_device(concat_field(scenes, "texels"), device)
    across = texels[:, None, :, :2, None]
    start = (across * projected.eye[:, :2, None, :2, None]).sum((3, 4)) + texels[:, None, :, 2]
    step = (across * projected.direction[:, :1, None, :2]).sum(3)[:, 0]
    normal = projected.normal[:, :, 2]
    curve = torch.cat(
        [projected.origin[:, :2].flatten(2), projected.direction[:, :2].flatten(2)], 2
    )
    return Materials(
        curved=projected.shape == QUADRIC,
        start=start.permute(2, 0, 1).reshape(2, -1).contiguous(),
        step=step.reshape(-1, 6).T.contiguous(),
        curve=curve.flatten(0, 1).T.contiguous(),
        turn=projected.normal.flatten(1).T.contiguous(),
        texels=texels.flatten(1).T.contiguous(),
        normal=torch.nn.functional.normalize(normal, dim=-1).T.contiguous(),
        footprint=to_device(concat_field(scenes, "density") * baseline, device),
        texture=texture,
        base=(colour * bank.means[texture].T * (1 - contrast)).contiguous(),
        gain=(colour * contrast / 255).contiguous(),
        gloss=to_device(concat_field(scenes, "gloss"), device),
        light=to_device(np.array([_light_row(scene, size) for scene in scenes]), device),
    )


@dataclass(frozen=True)
class Rays:
    """Block of rays: h rows of both views of b scenes."""

    x: Tensor  # (W,)
    y: Tensor  # (h, 1)
    disparity: Tensor  # (b, 2, h, W)
    surface: Tensor  # (b, 2, h, W)
    light: Tensor  # (b, 22)
    lamp: tuple[Tensor, Tensor]  # the lamp's view: disparity and surface, (b, H, W)


def _dot(a: Sequence[Tensor], b: Sequence[Tensor]) -> Tensor:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _shade_quadrics(
    projected: ProjectedSurfaces,
    materials: Materials,
    rays: Rays,
    depth: Tensor,
    flat: Sequence[Tensor],
) -> None:
    """Overwrite texel coordinates and normals, flattened, where the surface is a quadric."""
    surface = rays.surface.flatten()
    where = torch.nonzero(materials.curved.index_select(0, surface))[:, 0]
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

    rows = pick(materials.curve, 2 * which + view)
    place = [rows[i] * x + rows[i + 1] * y + rows[i + 2] for i in range(0, 18, 3)]
    lx, ly, lz = (place[i] + beyond * place[i + 3] for i in range(3))
    alpha, beta, _ = pick(projected.quadric.T.contiguous(), which)
    gradient = (lx, ly, alpha * lz + 0.5 * beta)
    rows = pick(materials.turn, which)
    normal = [_dot(rows[i : i + 3], gradient) for i in range(0, 9, 3)]
    length = _dot(normal, normal).rsqrt()
    angle = torch.atan2(ly, lx)
    rows = pick(materials.texels, which)
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


def shade(
    projected: ProjectedSurfaces,
    materials: Materials,
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
    seen_from = (2 * rays.surface + view).flatten()
    texel = [
        materials.start[i].index_select(0, seen_from).view(shape)
        + depth
        * (
            pick(materials.step[3 * i]) * rays.x
            + (pick(materials.step[3 * i + 1]) * rays.y)
            + pick(materials.step[3 * i + 2])
        )
        for i in range(2)
    ]
    normal = [pick(column) for column in materials.normal]
    _shade_quadrics(
        projected, materials, rays, depth, [values.view(-1) for values in (*texel, *normal)]
    )
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
    highlight = pick(materials.gloss) * lit * torch.exp2(shininess * glance.log2())
    # Between the footprint's short and long side: a slanted surface's foreshortening is shared
    # by the five samples per pixel and some blur.
    footprint = pick(materials.footprint) / (rays.disparity * (cosine * cosine.sqrt()).sqrt())
    texture = materials.texture.index_select(0, surface)
    colour = bank.sample(
        texture, texel[0].flatten(), texel[1].flatten(), footprint.log2().flatten() + coarser
    )
    return torch.stack(
        [
            (pick(materials.base[i]) + pick(materials.gain[i]) * colour[i].view(shape)) * shading
            + highlight
            for i in range(3)
        ]
    )


def shade_images(
    projected: ProjectedSurfaces,
    materials: Materials,
    bank: TextureBank,
    found: tuple[Tensor, Tensor],
    lamp: tuple[Tensor, Tensor],
    offset: float,
    coarser: float,
) -> Tensor:
    """Shade one ray per pixel.

    Args:
        projected: Surfaces.
        materials: Their appearance.
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
            light=materials.light[part],
            lamp=(lamp[0][part], lamp[1][part]),
        )
        image[:, part, :, rows] = shade(projected, materials, bank, rays, coarser)
    return image
