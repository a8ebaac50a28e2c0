"""Surfaces of a batch of scenes as seen from each view: both cameras and the lamp.

Over the image the disparity of a plane is affine and its local position projective: coefficients
of (x, y, 1) are all that ray casting needs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from mobilestereonet.scenes.scene import Floats, Scene

# The lamp is a third camera: what it does not see lies in shadow.
LEFT, RIGHT, LAMP = VIEWS = range(3)


@dataclass(frozen=True)
class ProjectedSurfaces:
    """Surfaces of a batch of scenes as coefficients per view; n surfaces, 3 views.

    The last dimension of ``plane``, ``origin`` and ``direction`` holds the coefficients of
    (x, y, 1), a position in the image. Disparity stands for focal * baseline / depth in any view.

    Attributes:
        scene: Number of the scene, (n,).
        shape: RECTANGLE, MASKED or QUADRIC, (n,).
        plane: Disparity, and local x and y times disparity, of a rectangle's plane, (n, 3, 3, 3).
        origin: Local position at depth ``anchor``, (n, 3, 3, 3).
        direction: Change of the local position with depth, (n, 3, 3, 3).
        eye: The views' centres in local coordinates, (n, 3, 3).
        anchor: Depth of the surface's centre, the reference that keeps small distant surfaces
            exact, (n, 3).
        focal_baseline: Disparity times depth, (n,).
        quadric: a, b, c of x^2 + y^2 + a z^2 + b z + c = 0, (n, 3).
        bounds: x0, y0, x1, y1 of a quadric in the image, (n, 3, 4).
        mask: Index of the mask, (n,).
        mask_repeat: Repeats of the mask along x and y, (n, 2).
        one_sided: Whether a rectangle is seen only from where its normal points, (n,).
        normal: Local gradient to the camera's frame, (n, 3, 3).
    """

    scene: Tensor
    shape: Tensor
    plane: Tensor
    origin: Tensor
    direction: Tensor
    eye: Tensor
    anchor: Tensor
    focal_baseline: Tensor
    quadric: Tensor
    bounds: Tensor
    mask: Tensor
    mask_repeat: Tensor
    one_sided: Tensor
    normal: Tensor


def concat_field(scenes: Sequence[Scene], name: str) -> NDArray[np.float64]:
    """Concatenate one field of the surfaces of all scenes."""
    return np.concatenate([getattr(scene.surfaces, name) for scene in scenes])


def to_device(values: NDArray[np.float64], device: torch.device) -> Tensor:
    """Move to ``device``, floats as float32."""
    floats = values.dtype.kind == "f"
    contiguous = np.ascontiguousarray(values, dtype=np.float32 if floats else None)
    return torch.from_numpy(contiguous).to(device)


def lamp_axes(scene: Scene) -> Floats:
    """Right, down and ahead of the lamp's view as rows, in the camera's frame."""
    ahead = scene.focus - scene.light
    ahead = ahead / np.linalg.norm(ahead)
    right = np.cross([0.3, 1.0, 0.2], ahead)
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(ahead, right), ahead])


def lamp_focal(scene: Scene, size: tuple[int, int]) -> float:
    """Focal length in pixels with which the lamp's view spans the lit region's height."""
    return float(0.5 * size[0] * np.linalg.norm(scene.focus - scene.light) / scene.spread)


def _views(scene: Scene, size: tuple[int, int]) -> tuple[Floats, Floats, Floats]:
    """Centres (3, 3), axes as rows (3, 3, 3) and intrinsics (3, 3: focal, cx, cy) of the views."""
    eyes = np.stack([np.zeros(3), [scene.baseline, 0, 0], scene.light])
    axes = np.stack([np.eye(3), np.eye(3), lamp_axes(scene)])
    camera = [scene.focal, scene.cx, scene.cy]
    lamp = [lamp_focal(scene, size), 0.5 * size[1], 0.5 * size[0]]
    return eyes, axes, np.array([camera, camera, lamp])


def _image_bounds(
    axes: Floats, centre: Floats, eyes: Floats, view_axes: Floats, intrinsics: Floats
) -> Floats:
    """Bounding boxes x0, y0, x1, y1 of the surfaces in each view, (n, 3, 4), in pixels."""
    focal, cx, cy = np.moveaxis(intrinsics, -1, 0)
    corners = np.stack(np.meshgrid([-1, 1], [-1, 1], [-1, 1]), -1).reshape(8, 3)
    points = centre[:, None] + np.einsum("nij,kj->nki", axes, corners)
    points = np.einsum("nvij,nvkj->nvki", view_axes, points[:, None] - eyes[:, :, None])
    depth = points[..., 2].clip(1e-3)
    columns = points[..., 0] / depth * focal[..., None] + cx[..., None]
    rows = points[..., 1] / depth * focal[..., None] + cy[..., None]
    bounds = np.stack([columns.min(-1), rows.min(-1), columns.max(-1), rows.max(-1)], -1)
    bounds[(points[..., 2] <= 1e-3).any(-1)] = -1e6  # layouts keep quadrics before the cameras
    return np.asarray(bounds)


def project_surfaces(
    scenes: Sequence[Scene], size: tuple[int, int], device: torch.device
) -> ProjectedSurfaces:
    """Coefficients of all surfaces in all views; float64 until they are known."""
    count = [len(scene.surfaces.shape) for scene in scenes]
    eyes, view_axes, intrinsics = (
        np.repeat(np.stack(part), count, axis=0)
        for part in zip(*(_views(scene, size) for scene in scenes), strict=True)
    )
    focal, cx, cy = np.moveaxis(intrinsics, -1, 0)
    focal_baseline = np.repeat([scene.focal * scene.baseline for scene in scenes], count)
    axes, centre = concat_field(scenes, "axes"), concat_field(scenes, "centre")
    inverse = np.linalg.inv(axes)
    to_view = np.zeros((*focal.shape, 3, 3))
    to_view[..., 0, 0] = to_view[..., 1, 1] = 1 / focal
    to_view[..., 0, 2], to_view[..., 1, 2], to_view[..., 2, 2] = -cx / focal, -cy / focal, 1
    direction = inverse[:, None] @ view_axes.swapaxes(-1, -2) @ to_view
    eye = np.einsum("nij,nvj->nvi", inverse, eyes - centre[:, None])
    anchor = np.einsum("nvj,nvj->nv", view_axes[:, :, 2], centre[:, None] - eyes).clip(0)
    origin = anchor[..., None, None] * direction
    origin[..., 2] += eye
    # A plane through the eye is a line in the image: the sign keeps its coefficients finite.
    away = np.where(np.abs(eye[..., 2:]) < 1e-9, 1e-9, eye[..., 2:])
    scaled = focal_baseline[:, None, None, None] * direction
    disparity = -scaled[:, :, 2] / away
    across = [eye[..., i, None] * disparity + scaled[:, :, i] for i in (0, 1)]
    arrays = {
        "scene": np.repeat(np.arange(len(scenes)), count),
        "shape": concat_field(scenes, "shape"),
        "plane": np.stack([disparity, *across], axis=2),
        "origin": origin,
        "direction": direction,
        "eye": eye,
        "anchor": anchor,
        "focal_baseline": focal_baseline,
        "quadric": concat_field(scenes, "quadric"),
        "bounds": _image_bounds(axes, centre, eyes, view_axes, intrinsics),
        "mask": concat_field(scenes, "mask"),
        "mask_repeat": concat_field(scenes, "mask_repeat"),
        "one_sided": concat_field(scenes, "one_sided"),
        "normal": inverse.swapaxes(-1, -2),
    }
    return ProjectedSurfaces(**{name: to_device(values, device) for name, values in arrays.items()})
