"""Appearance of the surfaces of a batch of scenes, as tensors for shading."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from mobilestereonet.scenes.projection import (
    ProjectedSurfaces,
    concat_field,
    lamp_axes,
    lamp_focal,
    to_device,
)
from mobilestereonet.scenes.scene import QUADRIC, Scene
from mobilestereonet.scenes.textures import TextureBank


@dataclass(frozen=True)
class Appearance:
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
        mirror: Share of the light that is mirrored, seen head-on, (n,).
        light: One row per scene: the camera and the lamp, (B, 22).
        surroundings: Index of the texture that mirrors show, (B,).
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
    mirror: Tensor
    light: Tensor
    surroundings: Tensor


def _light_row(scene: Scene, size: tuple[int, int]) -> list[float]:
    camera = [scene.focal, scene.cx, scene.cy, scene.baseline]
    lamp = [*scene.light, scene.ambient, scene.diffuse, scene.reach**2, scene.shininess]
    # Beyond the lit region, as on the sky, nothing casts a shadow.
    farthest = float(np.linalg.norm(scene.focus - scene.light)) + 4 * scene.spread
    return [*camera, *lamp, lamp_focal(scene, size), *lamp_axes(scene).ravel(), farthest]


def gather_appearance(
    scenes: Sequence[Scene], projected: ProjectedSurfaces, size: tuple[int, int], bank: TextureBank
) -> Appearance:
    """Gather the appearance of all scenes' surfaces on the device of ``bank``."""
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
    return Appearance(
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
        mirror=to_device(concat_field(scenes, "mirror"), device),
        light=to_device(np.array([_light_row(scene, size) for scene in scenes]), device),
        surroundings=to_device(np.array([scene.surroundings for scene in scenes]), device),
    )
