"""Warping and resampling of feature maps, as the layers of the Caffe releases do."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor


def along_rows(shift: Tensor) -> Tensor:
    """The flow (B, 2, H, W) of a shift along the rows, (B, 1, H, W)."""
    return torch.cat((shift, torch.zeros_like(shift)), dim=1)


def remap(image: Tensor, flow: Tensor) -> Tensor:
    """Sample an image where a flow points (Remap in CRL's release).

    Args:
        image: (B, C, H, W).
        flow: Shift (u, v) along the columns and along the rows, (B, 2, H, W), in pixels.

    Returns:
        (B, C, H, W): the image at (x + u, y + v), bilinear; a neighbour outside counts as 0.
    """
    return _sample(image, *_targets(flow), "zeros")


def flow_warp(image: Tensor, flow: Tensor) -> Tensor:
    """Sample an image where a flow points (FlowWarp in the releases of iResNet and the DispNets).

    Args:
        image: (B, C, H, W).
        flow: Shift (u, v) along the columns and along the rows, (B, 2, H, W), in pixels.

    Returns:
        (B, C, H, W): the image at (x + u, y + v), bilinear; 0 unless 0 <= x + u < W and
        0 <= y + v < H. Beyond the last column's centre that column counts alone, rows likewise.
    """
    height, width = image.shape[-2:]
    x, y = _targets(flow)
    inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
    return torch.where(inside.unsqueeze(1), _sample(image, x, y, "border"), 0)


def downsample(image: Tensor, height: int, width: int) -> Tensor:
    """Shrink with aligned corners and a triangle filter (Downsample in CRL's release).

    Args:
        image: (B, C, H, W).
        height: Height to reach, less than H.
        width: Width to reach, less than W.

    Returns:
        (B, C, height, width).
    """
    values = image.to(torch.promote_types(image.dtype, torch.float32))
    rows = _triangles(values, image.shape[-2], height)
    columns = _triangles(values, image.shape[-1], width)
    return (rows @ values @ columns.T).to(image.dtype)


def _targets(flow: Tensor) -> tuple[Tensor, Tensor]:
    """Columns and rows where a flow points, (B, H, W) each."""
    height, width = flow.shape[-2:]
    flow = flow.to(torch.promote_types(flow.dtype, torch.float32))  # bfloat16 counts to 256
    columns = torch.arange(width, dtype=flow.dtype, device=flow.device)
    rows = torch.arange(height, dtype=flow.dtype, device=flow.device)
    return flow[:, 0] + columns, flow[:, 1] + rows[:, None]


def _sample(image: Tensor, x: Tensor, y: Tensor, outside: str) -> Tensor:
    """Bilinear values at columns x and rows y; ``outside`` is the padding mode of grid_sample."""
    height, width = image.shape[-2:]
    # -1 and 1 are the image's borders, half a pixel beyond the outermost centres.
    grid = torch.stack(((2 * x + 1) / width - 1, (2 * y + 1) / height - 1), dim=-1)
    values = image.to(grid.dtype)
    values = F.grid_sample(values, grid, padding_mode=outside, align_corners=False)
    return values.to(image.dtype)


def _triangles(like: Tensor, inputs: int, outputs: int) -> Tensor:
    """Weights (outputs, inputs) of a triangle filter as wide as its step, with rows of sum 1."""
    step = (inputs - 1) / max(outputs - 1, 1)
    centres = step * torch.arange(outputs, dtype=like.dtype, device=like.device)
    places = torch.arange(inputs, dtype=like.dtype, device=like.device)
    weights = (1 - (places - centres[:, None]).abs() / step).clamp_min(0)
    return weights / weights.sum(dim=1, keepdim=True)
