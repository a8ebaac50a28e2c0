"""Rendering of stereo scenes: anti-aliased colour, exact disparity and occlusion."""

from __future__ import annotations

from collections.abc import Sequence

import torch
import torch.nn.functional as F
from torch import Tensor

from mobilestereonet.scenes.appearance import gather_appearance
from mobilestereonet.scenes.casting import cast_rays
from mobilestereonet.scenes.projection import (
    LAMP,
    LEFT,
    RIGHT,
    VIEWS,
    ProjectedSurfaces,
    project_surfaces,
)
from mobilestereonet.scenes.scene import QUADRIC, Scene
from mobilestereonet.scenes.shading import shade_images
from mobilestereonet.scenes.textures import TextureBank

# A right pixel that shows another surface hides the left one only if it is this much nearer (px).
OCCLUSION_MARGIN_PX = 0.25


def _occluded(projected: ProjectedSurfaces, disparity: Tensor, index: Tensor) -> Tensor:
    """Mask of the left pixels that the right camera does not see, (B, H, W)."""
    height, width = disparity.shape[-2:]
    x = torch.arange(width, device=disparity.device)
    left, surface = disparity[:, LEFT], index[:, LEFT].long()
    matched = x - left
    nearest = matched.round().long().clamp(0, width - 1)
    other = index[:, RIGHT].gather(-1, nearest)
    nearer = disparity[:, RIGHT].gather(-1, nearest) > left + OCCLUSION_MARGIN_PX
    hidden = (other != index[:, LEFT]) & nearer
    # A curved surface hides the points that it turns away from the right camera.
    at, which = (
        torch.nonzero((projected.shape == QUADRIC).index_select(0, surface.flatten()))[:, 0],
        surface,
    )
    which = surface.flatten()[at]
    depth = projected.focal_baseline[which] / left.flatten()[at] - projected.anchor[which, LEFT]
    position = torch.stack([at % width, at // width % height, torch.ones_like(at)], -1)[:, None]
    local = (projected.origin[which, LEFT] * position).sum(-1)
    local = local + depth[:, None] * (projected.direction[which, LEFT] * position).sum(-1)
    alpha, beta, _ = projected.quadric[which].T
    gradient = torch.stack([local[:, 0], local[:, 1], alpha * local[:, 2] + 0.5 * beta], -1)
    side = ((projected.eye[which, :LAMP] - local[:, None]) * gradient[:, None]).sum(-1)
    hidden.view(-1)[at] |= side[:, LEFT] * side[:, RIGHT] < 0
    return hidden | (matched < -0.5)


def render_scenes(
    scenes: Sequence[Scene], size: tuple[int, int], rays: int, bank: TextureBank, masks: Tensor
) -> tuple[Tensor, Tensor, Tensor]:
    """Render both views of every scene on the device of ``bank``.

    Args:
        scenes: B scenes.
        size: Height and width of the images, in pixels.
        rays: Rays per pixel: 1 (the centre) or 2 (the centre and shared corners).
        bank: Textures.
        masks: Masks of shape (M, S, S), bool; S is a power of two.

    Returns:
        Images (B, 2, 3, H, W) in 0..1, the left view's disparity (B, H, W) in pixels, and whether
        the left pixel is hidden from the right camera (B, H, W).
    """
    projected = project_surfaces(scenes, size, masks.device)
    appearance = gather_appearance(scenes, projected, size, bank)
    disparity, index = cast_rays(projected, len(scenes), size, 0.0, masks, len(VIEWS))
    lamp = disparity[:, LAMP], index[:, LAMP]
    disparity, index = disparity[:, :LAMP], index[:, :LAMP]
    colour = shade_images(projected, appearance, bank, (disparity, index), lamp, 0.0, -0.5)
    if rays > 1:
        # A pixel is the mean of its centre and of its four corners, which neighbours share: five
        # samples for two rays. Ground truth is the centre's.
        found = cast_rays(projected, len(scenes), size, -0.5, masks, LAMP)
        corners = shade_images(projected, appearance, bank, found, lamp, -0.5, 0.0)
        corners = F.pad(corners.flatten(0, 2), (0, 1, 0, 1), mode="replicate")
        across = corners[..., 1:] + corners[..., :-1]
        colour = 0.5 * colour + 0.125 * (across[:, 1:] + across[:, :-1]).view_as(colour)
    colour = colour.permute(1, 2, 0, 3, 4)
    brightness = torch.tensor([scene.brightness for scene in scenes], device=masks.device)
    # The geometric mean lets a bright sky burn out, as cameras do.
    exposure = brightness / colour.clamp_min(0.01).log().mean(dim=(1, 2, 3, 4)).exp()
    colour = colour.clamp_min(0) * exposure.view(-1, 1, 1, 1, 1)
    squared = colour * colour
    colour = colour / (1 + squared * squared).sqrt().sqrt()  # a film's shoulder, below 1
    return colour, disparity[:, LEFT].contiguous(), _occluded(projected, disparity, index)
