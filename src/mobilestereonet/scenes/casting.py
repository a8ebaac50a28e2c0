"""Ray casting: the first surface and the disparity of each ray of each view.

Every surface is one of three shapes in its own local frame: a rectangle (z = 0, |x|, |y| <= 1), a
rectangle with a mask, or a piece of a quadric (|z| <= 1). Over the image the disparity of a plane
is affine and its local position projective, so that a rectangle costs three affine maps and a few
comparisons per ray. Images are cut into tiles; a tile is cast only against the surfaces that can
touch it, the tiles of all scenes and views together.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from mobilestereonet.scenes.scene import MASKED, QUADRIC, RECTANGLE, Floats, Scene

TILE = (16, 32)  # height and width, in pixels
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
        anchor: Depth of the surface's centre, near which small and distant things do not cancel,
            (n, 3).
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
    corners = np.stack(np.meshgrid([-1, 1], [-1, 1], [-1, 1]), -1).reshape(8, 3)
    points = centre[:, None] + np.einsum("nij,kj->nki", axes, corners)
    points = np.einsum("nvij,nvkj->nvki", view_axes, points[:, None] - eyes[:, :, None])
    depth = points[..., 2].clip(1e-3)
    columns = points[..., 0] / depth * focal[..., None] + cx[..., None]
    rows = points[..., 1] / depth * focal[..., None] + cy[..., None]
    bounds = np.stack([columns.min(-1), rows.min(-1), columns.max(-1), rows.max(-1)], -1)
    bounds[(points[..., 2] <= 1e-3).any(-1)] = -1e6  # layouts keep quadrics before the cameras
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
        "bounds": bounds,
        "mask": concat_field(scenes, "mask"),
        "mask_repeat": concat_field(scenes, "mask_repeat"),
        "one_sided": concat_field(scenes, "one_sided"),
        "normal": inverse.swapaxes(-1, -2),
    }
    return ProjectedSurfaces(**{name: to_device(values, device) for name, values in arrays.items()})


def _touched(
    projected: ProjectedSurfaces, members: Tensor, shape: int, tiles: Tensor, views: int
) -> Tensor:
    """Which tiles (t, 4: x0, y0, x1, y1) each member can touch: (views, tiles, members).

    A rectangle is where disparity plus or minus (local x or y times disparity), four affine maps,
    are positive: a tile misses it if one of them is negative at all its corners.
    """
    x0, y0, x1, y1 = tiles.T[:, None, :, None]
    if shape == QUADRIC:
        left, top, right, bottom = projected.bounds[members, :views].permute(2, 1, 0)[:, :, None]
        touched: Tensor = (left <= x1) & (right >= x0) & (top <= y1) & (bottom >= y0)
        return touched
    disparity, u, v = projected.plane[members, :views].permute(2, 3, 1, 0)[:, :, :, None]
    facing = (projected.eye[members, :views, 2] > 0) | ~projected.one_sided[members, None]
    touched = facing.T[:, None]
    for edge in (disparity, disparity + u, disparity - u, disparity + v, disparity - v):
        along_x = torch.maximum(edge[0] * x0, edge[0] * x1)
        along_y = torch.maximum(edge[1] * y0, edge[1] * y1)
        touched = touched & (along_x + along_y + edge[2] > 0)
    return touched


@dataclass(frozen=True)
class _TilePairs:
    """Pairs of a tile and a surface of one shape, in steps that visit a tile at most once."""

    row: Tensor  # (pairs,) the tile's row in the depth buffer
    surface: Tensor  # (pairs,)
    view: Tensor  # (pairs,)
    corner: Tensor  # (pairs, 2) x, y of the tile's first pixel
    steps: list[int]

    def __iter__(self) -> Iterator[tuple[Tensor, Tensor, Tensor, Tensor]]:
        columns = (self.row, self.surface, self.view, self.corner)
        return zip(*(column.split(self.steps) for column in columns), strict=True)


def _pair_tiles(
    projected: ProjectedSurfaces, shape: int, tiles: Tensor, scenes: int, views: int
) -> _TilePairs | None:
    members = torch.nonzero(projected.shape == shape)[:, 0]
    # One pixel of margin on each side covers the corner rays.
    margin = torch.tensor([-1.0, -1.0, 1.0, 1.0], device=tiles.device)
    touched = _touched(projected, members, shape, tiles + margin, views)
    view, tile, member = torch.nonzero(touched).T
    if not len(member):
        return None
    surface = members[member]
    # Sorted by view, tile and scene already: the rank within such a group is the step.
    row = (view * len(tiles) + tile) * scenes + projected.scene[surface]
    _, count = torch.unique_consecutive(row, return_counts=True)
    first = torch.cumsum(count, 0) - count
    rank = torch.arange(len(row), device=row.device) - torch.repeat_interleave(first, count)
    order = torch.argsort(rank, stable=True)
    steps = torch.bincount(rank).tolist()
    return _TilePairs(row[order], surface[order], view[order], tiles[tile[order], :2], steps)


def _affine(rows: Tensor, x: Tensor, y: Tensor) -> Tensor:
    """Affine map of positions: rows (n, 3), x (n, 1, w), y (n, h, 1) -> (n, h, w)."""
    a, b, c = rows.T[:, :, None, None]
    values: Tensor = a * x + (b * y + c)
    return values


def _hit_rectangle(
    projected: ProjectedSurfaces,
    surface: Tensor,
    view: Tensor,
    x: Tensor,
    y: Tensor,
    masks: Tensor | None,
) -> Tensor:
    """Disparity where rays meet the rectangles, not positive elsewhere."""
    plane = projected.plane[surface, view]
    disparity = _affine(plane[:, 0], x, y)
    u, v = _affine(plane[:, 1], x, y), _affine(plane[:, 2], x, y)
    inside = torch.maximum(u.abs(), v.abs()) <= disparity
    if masks is not None:
        size = masks.shape[-1]
        half = (0.5 * size * projected.mask_repeat[surface]).T[:, :, None, None]
        scale = 1 / disparity
        # Outside the rectangle the cell is wrong but within the bank: the size is a power of two.
        column = ((u * scale + 1) * half[0]).int() & (size - 1)
        row = ((v * scale + 1) * half[1]).int() & (size - 1)
        start = projected.mask[surface].int()[:, None, None] * (size * size)
        cell = (start + row * size + column).flatten()
        inside &= masks.view(-1).index_select(0, cell).view_as(inside)
    return disparity * inside


def _hit_quadric(
    projected: ProjectedSurfaces,
    surface: Tensor,
    view: Tensor,
    x: Tensor,
    y: Tensor,
    masks: Tensor | None,
) -> Tensor:
    """Disparity of the nearest point with |z| <= 1 on the quadric, not positive elsewhere."""
    origin, direction = projected.origin[surface, view], projected.direction[surface, view]
    ox, oy, oz = (_affine(origin[:, i], x, y) for i in range(3))
    dx, dy, dz = (_affine(direction[:, i], x, y) for i in range(3))
    a, b, c = projected.quadric[surface].T[:, :, None, None]
    second = dx * dx + dy * dy + a * (dz * dz)
    first = ox * dx + oy * dy + (a * oz + 0.5 * b) * dz
    constant = ox * ox + oy * oy + (a * oz + b) * oz + c
    root = (first * first - second * constant).sqrt()  # NaN, a miss, compares false
    anchor = projected.anchor[surface, view][:, None, None]
    focal_baseline = projected.focal_baseline[surface][:, None, None]
    nearest = torch.zeros_like(ox)
    for numerator in (-first - root, root - first):
        beyond = numerator / second
        depth = beyond + anchor
        hit = ((oz + beyond * dz).abs() <= 1) & (depth > 0)
        nearest = torch.where(hit, torch.maximum(nearest, focal_baseline / depth), nearest)
    return nearest


def make_tiles(grid: tuple[int, int], device: torch.device) -> Tensor:
    """Borders x0, y0, x1, y1 of the tiles of a grid, (tiles, 4)."""
    rows, columns = torch.meshgrid(
        torch.arange(grid[0]) * TILE[0], torch.arange(grid[1]) * TILE[1], indexing="ij"
    )
    first = torch.stack([columns.flatten(), rows.flatten()], -1).float()
    return torch.cat([first, first + torch.tensor([TILE[1], TILE[0]])], -1).to(device)


def cast_rays(
    projected: ProjectedSurfaces,
    scenes: int,
    size: tuple[int, int],
    offset: float,
    masks: Tensor,
    views: int,
) -> tuple[Tensor, Tensor]:
    """Cast one ray per pixel and find the nearest surface.

    Args:
        projected: Surfaces of B scenes.
        scenes: B.
        size: Height and width of the images.
        offset: Added to the pixels' positions, in x and y.
        masks: Masks (M, S, S), bool.
        views: Number of views to cast: the cameras, then the lamp.

    Returns:
        Disparity (B, views, H, W), 0 where nothing is met, and the surface's index, int32.
    """
    height, width = TILE
    device = masks.device
    grid = (-(-size[0] // height), -(-size[1] // width))
    tiles = make_tiles(grid, device)
    rows = views * len(tiles) * scenes
    disparity = torch.zeros(rows, height, width, device=device)
    index = torch.zeros(rows, height, width, dtype=torch.int32, device=device)
    columns = torch.arange(width, device=device)[None, None] + offset
    lines = torch.arange(height, device=device)[None, :, None] + offset
    hits = ((RECTANGLE, _hit_rectangle), (MASKED, _hit_rectangle), (QUADRIC, _hit_quadric))
    for shape, hit in hits:
        used = masks if shape == MASKED else None
        for row, surface, view, corner in _pair_tiles(projected, shape, tiles, scenes, views) or ():
            x = corner[:, 0, None, None] + columns
            y = corner[:, 1, None, None] + lines
            found = hit(projected, surface, view, x, y, used)
            before = disparity.index_select(0, row)
            nearer = found > before
            disparity.index_copy_(0, row, torch.where(nearer, found, before))
            old = index.index_select(0, row)
            new = torch.where(nearer, surface.int()[:, None, None], old)
            index.index_copy_(0, row, new)

    def images(values: Tensor) -> Tensor:
        parts = values.view(views, *grid, scenes, height, width).permute(3, 0, 1, 4, 2, 5)
        whole = parts.reshape(scenes, views, grid[0] * height, grid[1] * width)
        return whole[..., : size[0], : size[1]].contiguous()

    return images(disparity), images(index)
