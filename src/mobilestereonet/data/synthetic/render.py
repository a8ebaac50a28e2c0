"""Ray casting of a batch of scenes: exact disparity, exact occlusion, anti-aliased colour.

Every surface is one of three shapes in its own local frame: a rectangle (z = 0, |x|, |y| <= 1),
a rectangle with a mask, or a piece of a quadric (|z| <= 1). Along an image row and column the
local position of a plane is projective and its disparity affine, so that a rectangle costs three
affine maps and a few comparisons per ray. Images are cut into tiles; a tile is cast only against
the surfaces that can touch it, all tiles of all scenes and both views together.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from mobilestereonet.data.synthetic.layout import MASKED, QUADRIC, RECTANGLE, Scene
from mobilestereonet.data.synthetic.textures import TextureBank

TILE = (16, 32)
# Colour is the mean of the pixel's centre and of its four corners, which neighbours share: five
# samples for two rays per pixel. Ground truth is the centre's.
RAY_OFFSETS = ((0.0, 0.0), (-0.5, -0.5))
# A right pixel that shows another surface hides the left one only if it is this much nearer (px).
OCCLUSION_MARGIN = 0.25
# Rays shaded at once on the CPU: the working set stays in the cache.
CPU_CHUNK = 1 << 16


@dataclass(frozen=True)
class _Surfaces:
    """The surfaces of all scenes of a batch, as seen by each view; n surfaces, 2 views.

    Rows are the coefficients of (x, y, 1), in pixels. ``plane`` holds the rows of disparity and of
    local x and y times disparity; ``origin`` and ``direction`` those of the local position at
    depth ``anchor`` and of its change with depth.
    """

    scene: Tensor  # (n,)
    shape: Tensor  # (n,)
    plane: Tensor  # (n, 2, 3, 3)
    origin: Tensor  # (n, 2, 3, 3)
    direction: Tensor  # (n, 3, 3)
    camera: Tensor  # (n, 2, 3) the camera centre in local coordinates
    anchor: Tensor  # (n,)
    focal_baseline: Tensor  # (n,)
    quadric: Tensor  # (n, 3)
    bounds: Tensor  # (n, 2, 4) x0, y0, x1, y1 of a quadric
    mask: Tensor  # (n,)
    mask_repeat: Tensor  # (n, 2)
    normal: Tensor  # (n, 3, 3) local gradient to camera frame
    texels: Tensor  # (n, 2, 3) local surface coordinates to texels
    footprint: Tensor  # (n,) texels per pixel times disparity, seen head-on
    texture: Tensor  # (n,)
    base: Tensor  # (n, 3)
    gain: Tensor  # (n, 3)
    gloss: Tensor  # (n,)


def _local_frames(scenes: Sequence[Scene]) -> dict[str, np.ndarray]:
    """What the surfaces look like from both cameras; float64, as small and distant ones cancel."""
    count = [len(scene.surfaces.shape) for scene in scenes]

    def join(name: str) -> np.ndarray:
        return np.concatenate([getattr(scene.surfaces, name) for scene in scenes])

    def spread(name: str) -> np.ndarray:
        return np.repeat([getattr(scene, name) for scene in scenes], count)

    focal, baseline = spread("focal"), spread("baseline")
    focal_baseline = focal * baseline
    axes, centre = join("axes"), join("centre")
    inverse = np.linalg.inv(axes)
    to_ray = np.zeros((len(axes), 3, 3))
    to_ray[:, 0, 0] = to_ray[:, 1, 1] = 1 / focal
    to_ray[:, 0, 2] = -spread("cx") / focal
    to_ray[:, 1, 2] = -spread("cy") / focal
    to_ray[:, 2, 2] = 1
    direction = inverse @ to_ray
    eye = np.zeros((len(axes), 2, 3))
    eye[:, 1, 0] = baseline
    camera = np.einsum("nij,nvj->nvi", inverse, eye - centre[:, None])
    anchor = np.maximum(centre[:, 2], 0)
    origin = (anchor[:, None, None] * direction)[:, None].repeat(2, axis=1)
    origin[..., 2] += camera
    # A plane through the camera centre is a line in the image: the sign keeps it finite.
    away = np.where(np.abs(camera[..., 2]) < 1e-9, 1e-9, camera[..., 2])
    scaled = focal_baseline[:, None, None, None] * direction[:, None]
    disparity = -scaled[:, :, 2] / away[..., None]
    plane = np.stack(
        [disparity] + [camera[..., i, None] * disparity + scaled[:, :, i] for i in (0, 1)],
        axis=2,
    )
    corners = np.stack(np.meshgrid([-1, 1], [-1, 1], [-1, 1]), -1).reshape(8, 3)
    points = (centre[:, None] + np.einsum("nij,kj->nki", axes, corners))[:, None] - eye[:, :, None]
    depth = np.maximum(points[..., 2], 1e-3)
    columns = points[..., 0] / depth * focal[:, None, None] + spread("cx")[:, None, None]
    rows = points[..., 1] / depth * focal[:, None, None] + spread("cy")[:, None, None]
    bounds = np.stack([columns.min(-1), rows.min(-1), columns.max(-1), rows.max(-1)], -1)
    # Behind a camera there is no rectangle; layouts place quadrics wholly in front.
    bounds[(points[..., 2] <= 1e-3).any(-1)] = -1e6
    return {
        "scene": np.repeat(np.arange(len(scenes)), count),
        "shape": join("shape"),
        "plane": plane,
        "origin": origin,
        "direction": direction,
        "camera": camera,
        "anchor": anchor,
        "focal_baseline": focal_baseline,
        "quadric": join("quadric"),
        "bounds": bounds,
        "mask": join("mask"),
        "mask_repeat": join("mask_repeat"),
        "normal": inverse.transpose(0, 2, 1),
        "texels": join("texels"),
        "footprint": join("density") * baseline,
        "texture": join("texture"),
        "gloss": join("gloss"),
    }


def _surfaces(scenes: Sequence[Scene], bank: TextureBank, device: torch.device) -> _Surfaces:
    arrays = {
        name: torch.from_numpy(
            value.astype(np.int64 if value.dtype.kind == "i" else np.float32)
        ).to(device)
        for name, value in _local_frames(scenes).items()
    }

    def join(name: str) -> Tensor:
        value = np.concatenate([getattr(scene.surfaces, name) for scene in scenes])
        return torch.from_numpy(value.astype(np.float32)).to(device)

    colour, contrast = join("colour"), join("contrast")[:, None]
    mean = bank.means[arrays["texture"]]
    return _Surfaces(**arrays, base=colour * mean * (1 - contrast), gain=colour * contrast / 255.0)


def _tile_mask(surfaces: _Surfaces, members: Tensor, tiles: Tensor) -> Tensor:
    """Which tiles each of the ``members`` can touch: (2 views, tiles, members).

    ``tiles`` (t, 4) holds x0, y0, x1, y1. A rectangle is the set where four affine maps (disparity
    plus or minus local x or y times disparity) are positive: a tile misses it if one of them is
    negative at all its corners.
    """
    x0, y0, x1, y1 = tiles.T[:, None, :, None]
    if int(surfaces.shape[members[0]]) == QUADRIC:
        left, top, right, bottom = surfaces.bounds[members].permute(2, 1, 0)[:, :, None]
        return (left <= x1) & (right >= x0) & (top <= y1) & (bottom >= y0)
    disparity, u, v = surfaces.plane[members].permute(2, 3, 1, 0)[:, :, :, None]
    touched = None
    for edge in (disparity, disparity + u, disparity - u, disparity + v, disparity - v):
        along_x = torch.maximum(edge[0] * x0, edge[0] * x1)
        along_y = torch.maximum(edge[1] * y0, edge[1] * y1)
        reached = along_x + along_y + edge[2] > 0
        touched = reached if touched is None else touched & reached
    assert touched is not None
    return touched


@dataclass(frozen=True)
class _Cast:
    """Which tile to cast against which surface, in steps that visit a tile at most once."""

    tile: Tensor  # (pairs,) row of the depth buffer
    surface: Tensor  # (pairs,)
    view: Tensor  # (pairs,)
    corner: Tensor  # (pairs, 2) x, y of the tile's first pixel
    steps: list[int]

    def __iter__(self) -> Iterator[tuple[Tensor, Tensor, Tensor, Tensor]]:
        start = 0
        for size in self.steps:
            part = slice(start, start + size)
            yield self.tile[part], self.surface[part], self.view[part], self.corner[part]
            start += size


def _pairs(surfaces: _Surfaces, shape: int, tiles: Tensor, scenes: int) -> _Cast | None:
    members = torch.nonzero(surfaces.shape == shape)[:, 0]
    if not len(members):
        return None
    view, tile, member = torch.nonzero(_tile_mask(surfaces, members, tiles)).T
    surface = members[member]
    # Sorted by view, tile and scene already: the rank within each group is the step.
    row = (view * len(tiles) + tile) * scenes + surfaces.scene[surface]
    _, count = torch.unique_consecutive(row, return_counts=True)
    first = torch.cumsum(count, 0) - count
    rank = torch.arange(len(row), device=row.device) - torch.repeat_interleave(first, count)
    order = torch.argsort(rank, stable=True)
    return _Cast(
        tile=row[order],
        surface=surface[order],
        view=view[order],
        corner=tiles[tile[order], :2] + 1.0,
        steps=torch.bincount(rank).tolist(),
    )


def _affine(rows: Tensor, x: Tensor, y: Tensor) -> Tensor:
    """Affine map of pixel positions: rows (n, 3), x (n, 1, w), y (n, h, 1) -> (n, h, w)."""
    a, b, c = rows.T[:, :, None, None]
    return a * x + torch.addcmul(c, b, y)


def _hit_rectangle(
    surfaces: _Surfaces, surface: Tensor, view: Tensor, x: Tensor, y: Tensor, masks: Tensor
) -> Tensor:
    """Disparity where the ray meets the rectangle, else -1."""
    plane = surfaces.plane[surface, view]
    disparity = _affine(plane[:, 0], x, y)
    u, v = _affine(plane[:, 1], x, y), _affine(plane[:, 2], x, y)
    inside = torch.maximum(u.abs(), v.abs()) <= disparity
    if int(surfaces.shape[surface[0]]) == MASKED:
        size = masks.shape[-1]
        half = 0.5 * size * surfaces.mask_repeat[surface]
        scale = 1 / disparity.clamp_min(1e-6)
        column = ((u * scale + 1) * half[:, 0, None, None]).long() % size
        row = ((v * scale + 1) * half[:, 1, None, None]).long() % size
        cell = surfaces.mask[surface][:, None, None] * (size * size) + row * size + column
        inside &= masks.view(-1)[cell]
    return torch.where(inside, disparity, -1.0)


def _hit_quadric(
    surfaces: _Surfaces, surface: Tensor, view: Tensor, x: Tensor, y: Tensor, masks: Tensor
) -> Tensor:
    """Disparity of the nearest point with |z| <= 1 on x^2 + y^2 + a z^2 + b z + c = 0, else -1."""
    origin, direction = surfaces.origin[surface, view], surfaces.direction[surface]
    ox, oy, oz = (_affine(origin[:, i], x, y) for i in range(3))
    dx, dy, dz = (_affine(direction[:, i], x, y) for i in range(3))
    a, b, c = surfaces.quadric[surface].T[:, :, None, None]
    second = dx * dx + dy * dy + a * dz * dz
    first = ox * dx + oy * dy + (a * oz + 0.5 * b) * dz
    constant = ox * ox + oy * oy + (a * oz + b) * oz + c
    root = (first * first - second * constant).sqrt()  # NaN compares false: a miss
    anchor = surfaces.anchor[surface][:, None, None]
    focal_baseline = surfaces.focal_baseline[surface][:, None, None]
    nearest = torch.full_like(ox, -1.0)
    for sign in (1.0, -1.0):
        depth = (-first + sign * root) / second
        hit = ((oz + depth * dz).abs() <= 1) & (depth + anchor > 0)
        nearest = torch.where(
            hit, torch.maximum(nearest, focal_baseline / (depth + anchor)), nearest
        )
    return nearest


def _cast(
    surfaces: _Surfaces,
    casts: dict[int, _Cast],
    rows: int,
    offset: tuple[float, float],
    masks: Tensor,
) -> tuple[Tensor, Tensor]:
    """Nearest surface of every ray: its disparity and index, (tile rows, h, w)."""
    height, width = TILE
    device = surfaces.shape.device
    disparity = torch.zeros(rows, height, width, device=device)
    index = torch.zeros(rows, height, width, dtype=torch.int32, device=device)
    columns = torch.arange(width, device=device)[None, None] + offset[0]
    lines = torch.arange(height, device=device)[None, :, None] + offset[1]
    for shape, cast in casts.items():
        hit = _hit_quadric if shape == QUADRIC else _hit_rectangle
        for tile, surface, view, corner in cast:
            x = corner[:, 0, None, None] + columns
            y = corner[:, 1, None, None] + lines
            found = hit(surfaces, surface, view, x, y, masks)
            before = disparity[tile]
            nearer = found > before
            disparity[tile] = torch.where(nearer, found, before)
            index[tile] = torch.where(nearer, surface.int()[:, None, None], index[tile])
    return disparity, index


def _shade(
    surfaces: _Surfaces,
    bank: TextureBank,
    lights: Tensor,
    rays: tuple[Tensor, Tensor, Tensor, Tensor, Tensor],
    coarser: float,
) -> Tensor:
    """Colour of rays: (n, 3). ``rays``: x, y, view, surface, disparity, each (n,)."""
    x, y, view, surface, disparity = rays

    def pick(values: Tensor) -> Tensor:
        return values.contiguous().index_select(0, surface)

    def map_rows(rows: Tensor, at: Tensor, px: Tensor, py: Tensor) -> Tensor:
        a, b, c = (column.contiguous().index_select(0, at) for column in rows.T)
        return a * px + b * py + c

    def local(axis: int, at: Tensor, seen: Tensor, px: Tensor, py: Tensor, t: Tensor) -> Tensor:
        origin = surfaces.origin[:, :, axis].reshape(-1, 3)
        return map_rows(origin, 2 * at + seen, px, py) + t * map_rows(
            surfaces.direction[:, axis], at, px, py
        )

    depth = pick(surfaces.focal_baseline) / disparity
    beyond = depth - pick(surfaces.anchor)
    u = local(0, surface, view, x, y, beyond)
    v = local(1, surface, view, x, y, beyond)
    normals = [pick(surfaces.normal[:, i, 2]) for i in range(3)]
    curved = torch.nonzero(pick(surfaces.shape) == QUADRIC)[:, 0]
    if len(curved):
        which = surface[curved]
        w = local(2, which, view[curved], x[curved], y[curved], beyond[curved])
        lx, ly = u[curved], v[curved]
        alpha, beta, _ = surfaces.quadric[which].T
        gradient = (lx, ly, alpha * w + 0.5 * beta)
        for i in range(3):
            row = surfaces.normal[which, i].T
            normals[i][curved] = sum(row[j] * gradient[j] for j in range(3))  # type: ignore[call-overload]
        u[curved] = torch.atan2(ly, lx)
        v[curved] = w
    light = lights.index_select(0, pick(surfaces.scene)).T
    focal, cx, cy, baseline = light[7:11]
    px = (x - cx) / focal * depth + view * baseline
    py = (y - cy) / focal * depth
    nx, ny, nz = normals
    length = (nx * nx + ny * ny + nz * nz).rsqrt()
    ex, ey, ez = view * baseline - px, -py, -depth
    to_eye = (ex * ex + ey * ey + ez * ez).rsqrt()
    facing = (nx * ex + ny * ey + nz * ez) * length * to_eye
    length = torch.where(facing < 0, -length, length)
    cosine = facing.abs().clamp_min(0.05)
    lx, ly, lz = light[0] - px, light[1] - py, light[2] - depth
    squared = lx * lx + ly * ly + lz * lz
    to_light = squared.rsqrt()
    lambert = ((nx * lx + ny * ly + nz * lz) * length * to_light).clamp_min(0)
    falloff = light[5] / (light[5] + squared)
    shade = light[3] * (1 - 0.25 * ny * length) + light[4] * lambert * falloff
    hx, hy, hz = (
        lx * to_light + ex * to_eye,
        ly * to_light + ey * to_eye,
        lz * to_light + ez * to_eye,
    )
    half = (nx * hx + ny * hy + nz * hz) * length * (hx * hx + hy * hy + hz * hz).rsqrt()
    highlight = pick(surfaces.gloss) * falloff * half.clamp_min(0).pow(light[6])
    texels = surfaces.texels
    tx = pick(texels[:, 0, 0]) * u + pick(texels[:, 0, 1]) * v + pick(texels[:, 0, 2])
    ty = pick(texels[:, 1, 0]) * u + pick(texels[:, 1, 1]) * v + pick(texels[:, 1, 2])
    # Between the short and the long side of the footprint: the five samples per pixel and the
    # remaining blur share a slanted surface's foreshortening.
    footprint = pick(surfaces.footprint) / (disparity * cosine.pow(0.7))
    level = torch.log2(footprint) + coarser
    colour = bank.sample(pick(surfaces.texture), tx, ty, level)
    lit = torch.stack(
        [pick(surfaces.base[:, i]) + pick(surfaces.gain[:, i]) * colour[:, i] for i in range(3)]
    )
    return lit * shade + highlight


def _untile(values: Tensor, scenes: int, grid: tuple[int, int], size: tuple[int, int]) -> Tensor:
    """Tile rows (2 views * tiles * scenes, h, w) as images (scenes, 2, H, W)."""
    tall, wide = TILE
    images = values.view(2, *grid, scenes, tall, wide).permute(3, 0, 1, 4, 2, 5)
    return images.reshape(scenes, 2, grid[0] * tall, grid[1] * wide)[..., : size[0], : size[1]]


def _occluded(surfaces: _Surfaces, disparity: Tensor, index: Tensor) -> Tensor:
    """Which left pixels the right camera does not see: (scenes, H, W)."""
    width = disparity.shape[-1]
    x = torch.arange(width, device=disparity.device).expand_as(disparity[:, 0])
    y = torch.arange(disparity.shape[-2], device=disparity.device)[:, None].expand_as(x)
    left, surface = disparity[:, 0], index[:, 0].long()
    matched = x - left
    nearest = matched.round().long().clamp(0, width - 1)
    other = index[:, 1].long().gather(-1, nearest)
    hidden = (other != surface) & (disparity[:, 1].gather(-1, nearest) > left + OCCLUSION_MARGIN)
    # A curved surface hides the points that it turns away from the right camera.
    curved = torch.nonzero(surfaces.shape[surface] == QUADRIC, as_tuple=True)
    which = surface[curved]
    depth = surfaces.focal_baseline[which] / left[curved] - surfaces.anchor[which]
    ray = torch.stack([x[curved], y[curved], torch.ones_like(which)], -1)[:, None]
    local = (surfaces.origin[which, 0] * ray).sum(-1)
    local = local + depth[:, None] * (surfaces.direction[which] * ray).sum(-1)
    alpha, beta, _ = surfaces.quadric[which].T
    gradient = torch.stack([local[:, 0], local[:, 1], alpha * local[:, 2] + 0.5 * beta], -1)
    side = ((surfaces.camera[which] - local[:, None]) * gradient[:, None]).sum(-1)
    turned = torch.zeros_like(hidden)
    turned[curved] = side[:, 0] * side[:, 1] < 0
    return hidden | turned | (matched < -0.5)


def render(
    scenes: Sequence[Scene], size: tuple[int, int], rays: int, bank: TextureBank, masks: Tensor
) -> tuple[Tensor, Tensor, Tensor]:
    """Both views of every scene.

    Args:
        scenes: What to render; B of them.
        size: Height and width of the images, in pixels.
        rays: Rays per pixel: 1 (the centre) or 2 (the centre and shared corners).
        bank: Textures; its device is where everything is computed.
        masks: Masks of shape (M, S, S), bool.

    Returns:
        Images (B, 2, 3, H, W) in 0..1, left view's disparity (B, H, W) in pixels, and whether the
        left pixel is hidden from the right camera (B, H, W).
    """
    device = masks.device
    tall, wide = TILE
    grid = (-(-size[0] // tall), -(-size[1] // wide))
    surfaces = _surfaces(scenes, bank, device)
    ty, tx = torch.meshgrid(torch.arange(grid[0]), torch.arange(grid[1]), indexing="ij")
    first = torch.stack([tx.flatten() * wide, ty.flatten() * tall], -1).float().to(device)
    # One pixel of margin on each side covers the corner rays.
    tiles = torch.cat([first - 1, first + torch.tensor([wide, tall], device=device)], -1)
    casts = {
        shape: pairs
        for shape in (RECTANGLE, MASKED, QUADRIC)
        if (pairs := _pairs(surfaces, shape, tiles, len(scenes))) is not None
    }
    lights = torch.tensor(
        np.array([scene.light_row() for scene in scenes]), dtype=torch.float32
    ).to(device)
    images: list[Tensor] = []
    truth: tuple[Tensor, Tensor] | None = None
    for offset, coarser in zip(RAY_OFFSETS[:rays], (-0.5, 0.0), strict=False):
        found = _cast(surfaces, casts, 2 * len(tiles) * len(scenes), offset, masks)
        disparity, index = (_untile(value, len(scenes), grid, size) for value in found)
        truth = truth or (disparity, index)
        columns = (torch.arange(size[1], device=device) + offset[0]).expand_as(disparity)
        lines = (torch.arange(size[0], device=device)[:, None] + offset[1]).expand_as(disparity)
        view = torch.arange(2, device=device)[None, :, None, None].expand_as(disparity)
        flat = [value.reshape(-1) for value in (columns, lines, view, index.long(), disparity)]
        chunk = CPU_CHUNK if device.type == "cpu" else flat[0].numel()
        colours = [
            _shade(surfaces, bank, lights, rays_, coarser)
            for rays_ in zip(*(value.split(chunk) for value in flat), strict=True)
        ]
        image = torch.cat(colours, 1).view(3, len(scenes), 2, *size).permute(1, 2, 0, 3, 4)
        images.append(image)
    assert truth is not None
    colour = images[0]
    if rays > 1:
        corners = F.pad(images[1].flatten(0, 1), (0, 1, 0, 1), mode="replicate")
        mean = F.avg_pool2d(corners, 2, stride=1).view_as(colour)
        colour = 0.5 * (colour + mean)
    exposure = torch.tensor([scene.brightness for scene in scenes], device=device)
    exposure = exposure / colour.mean(dim=(1, 2, 3, 4)).clamp_min(1e-3)
    colour = (colour * exposure.view(-1, 1, 1, 1, 1)).clamp(0, 1)
    disparity, index = truth
    return colour, disparity[:, 0].contiguous(), _occluded(surfaces, disparity, index)
