"""Ray casting: the first surface and the disparity of each ray of each view.

Every surface is one of three shapes in its own local frame: a rectangle (z = 0, |x|, |y| <= 1), a
rectangle with a mask, or a piece of a quadric (|z| <= 1). Over the image the disparity of a plane
is affine and its local position projective, so that a rectangle costs three affine maps and a few
comparisons per ray. Images are cut into tiles; a tile is cast only against the surfaces that can
touch it, the tiles of all scenes and views together.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import torch
from torch import Tensor

from mobilestereonet.scenes.projection import ProjectedSurfaces
from mobilestereonet.scenes.scene import MASKED, QUADRIC, RECTANGLE

TILE = (16, 32)  # height and width, in pixels


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
