"""Depthwise 3x3x3 convolutions on NVIDIA GPUs, in Triton.

cuDNN takes a depthwise 3D convolution in channels last for a grouped one. Here a program reads a
block of channels at a block of places, and its neighbours find what they share in the cache.
"""

from __future__ import annotations

import math

import torch
import triton
import triton.language as tl
from torch import Tensor

from mobilestereonet.accelerate.layout import channels_last, empty_channels_last

_TILE = (4, 4, 8)
"""Planes, rows and columns of a convolution's block: neighbours share what they read."""

_COLUMNS, _CHANNELS = 32, 32
"""Columns and channels of a block, the columns where a weight's gradient is summed."""

_ROWS = 64
"""Rows of the gradient over which a program sums the weight's gradient."""

_SIZES = (
    "rows",
    "depth",
    "height",
    "width",
    "result_depth",
    "result_height",
    "result_width",
    "grad_depth",
    "grad_height",
    "eighths",
)
"""What a kernel is not compiled anew for."""


@triton.jit(do_not_specialize=_SIZES)
def _convolve(  # type: ignore[no-untyped-def]
    source,
    weight,  # (27, channels)
    result,
    depth,  # of the source
    height,
    width,
    result_depth,
    result_height,
    result_width,
    eighths,  # of the channels: rows begin where eight values are read at once
    stride: tl.constexpr,
    transposed: tl.constexpr,
    block_planes: tl.constexpr,
    block_rows: tl.constexpr,
    block_columns: tl.constexpr,
    block_channels: tl.constexpr,
):
    """A block of one image's convolution, or of the transposed one."""
    channels = 8 * eighths
    block = tl.program_id(0)
    across = (result_width + block_columns - 1) // block_columns
    down = (result_height + block_rows - 1) // block_rows
    deep = (result_depth + block_planes - 1) // block_planes
    place = tl.arange(0, block_planes * block_rows * block_columns)
    x = block % across * block_columns + place % block_columns
    y = block // across % down * block_rows + place // block_columns % block_rows
    z = block // (across * down) % deep * block_planes + place // (block_columns * block_rows)
    image = (block // (across * down * deep)).to(tl.int64)
    channel = tl.program_id(1) * block_channels + tl.arange(0, block_channels)
    used = channel < channels
    source += image * depth * height * width * channels
    total = tl.zeros((block_planes * block_rows * block_columns, block_channels), tl.float32)
    for layer in range(3):  # not unrolled: fewer registers
        for tap in tl.static_range(9):
            if transposed:  # the place whose tap falls here, where the stride leaves one
                at_z, at_y, at_x = z + 1 - layer, y + 1 - tap // 3, x + 1 - tap % 3
                there = (at_z % stride == 0) & (at_y % stride == 0) & (at_x % stride == 0)
                there &= (at_z >= 0) & (at_y >= 0) & (at_x >= 0)
                at_z, at_y, at_x = at_z // stride, at_y // stride, at_x // stride
            else:
                at_z = z * stride + layer - 1
                at_y = y * stride + tap // 3 - 1
                at_x = x * stride + tap % 3 - 1
                there = (at_z >= 0) & (at_y >= 0) & (at_x >= 0)
            there &= (at_z < depth) & (at_y < height) & (at_x < width)
            first = ((at_z * height + at_y) * width + at_x) * channels
            inside = there[:, None] & used[None]
            values = tl.load(source + first[:, None] + channel[None], mask=inside, other=0.0)
            factors = weight + (9 * layer + tap) * channels + channel
            factor = tl.load(factors, mask=used, other=0.0).to(tl.float32)
            total += values.to(tl.float32) * factor[None]
    result += image * result_depth * result_height * result_width * channels
    first = ((z * result_height + y) * result_width + x) * channels
    inside = (z < result_depth) & (y < result_height) & (x < result_width)
    tl.store(
        result + first[:, None] + channel[None],
        total.to(result.dtype.element_ty),
        mask=inside[:, None] & used[None],
    )


@triton.jit(do_not_specialize=_SIZES)
def _correlate(  # type: ignore[no-untyped-def]
    source,
    grad,
    partial,  # (chunks, 27, channels)
    rows,  # of the gradient: images x depth x height
    depth,  # of the source
    height,
    width,
    grad_depth,
    grad_height,
    eighths,  # of the channels
    grad_width: tl.constexpr,
    stride: tl.constexpr,
    block_rows: tl.constexpr,
    block_columns: tl.constexpr,
    block_channels: tl.constexpr,
):
    """The share of some rows of the gradient in the gradient of one row of the kernel."""
    channels = 8 * eighths
    taps = tl.program_id(0)
    chunk = tl.program_id(1)
    channel = tl.program_id(2) * block_channels + tl.arange(0, block_channels)
    left = tl.zeros((block_columns, block_channels), tl.float32)
    middle = tl.zeros((block_columns, block_channels), tl.float32)
    right = tl.zeros((block_columns, block_channels), tl.float32)
    for step in range(block_rows):
        row = chunk * block_rows + step
        at_y = row % grad_height * stride + taps % 3 - 1
        at_z = row // grad_height % grad_depth * stride + taps // 3 - 1
        image = row // (grad_height * grad_depth)
        there = (row < rows) & (at_z >= 0) & (at_z < depth) & (at_y >= 0) & (at_y < height)
        first = ((tl.cast(image, tl.int64) * depth + at_z) * height + at_y) * width * channels
        end = tl.where(there, grad_width, 0)  # no column, where that row lies outside
        for start in range(0, grad_width, block_columns):
            x = start + tl.arange(0, block_columns)
            inside = (x < end)[:, None] & (channel < channels)[None]
            place = grad + tl.cast(row, tl.int64) * grad_width * channels
            change = tl.load(place + x[:, None] * channels + channel[None], mask=inside, other=0.0)
            change = change.to(tl.float32)
            at = x * stride - 1
            place = source + first + at[:, None] * channels + channel[None]
            outer = inside & (at >= 0)[:, None]
            values = tl.load(place, mask=outer & (at < width)[:, None], other=0.0)
            left += change * values.to(tl.float32)
            values = tl.load(place + channels, mask=inside & (at + 1 < width)[:, None], other=0.0)
            middle += change * values.to(tl.float32)
            values = tl.load(
                place + 2 * channels, mask=inside & (at + 2 < width)[:, None], other=0.0
            )
            right += change * values.to(tl.float32)
    place = partial + (chunk * 27 + taps * 3) * channels + channel
    tl.store(place, tl.sum(left, axis=0), mask=channel < channels)
    tl.store(place + channels, tl.sum(middle, axis=0), mask=channel < channels)
    tl.store(place + 2 * channels, tl.sum(right, axis=0), mask=channel < channels)


def _run_convolve(
    source: Tensor, weight: Tensor, result: Tensor, stride: int, *, transposed: bool
) -> None:
    channels = result.shape[1]
    blocks = math.prod(map(triton.cdiv, result.shape[2:], _TILE))
    _convolve[(len(result) * blocks, triton.cdiv(channels, _CHANNELS))](
        source,
        weight.reshape(channels, 27).t().contiguous(),
        result,
        *source.shape[2:],
        *result.shape[2:],
        channels // 8,
        stride=stride,
        transposed=transposed,
        block_planes=_TILE[0],
        block_rows=_TILE[1],
        block_columns=_TILE[2],
        block_channels=_CHANNELS,
    )


def convolve(x: Tensor, weight: Tensor, stride: int) -> Tensor:
    """Convolve volumes with a kernel per channel, padding 1.

    Sums are taken in float32.

    Args:
        x: Volumes (B, C, D, H, W), C a multiple of 8.
        weight: Kernels (C, 1, 3, 3, 3).
        stride: 1 or 2.

    Returns:
        (B, C, D / stride, H / stride, W / stride), rounded up, in the type of ``x``.
    """
    x = channels_last(x)
    size = (-(-side // stride) for side in x.shape[2:])
    y = empty_channels_last(x, (*x.shape[:2], *size))
    _run_convolve(x, weight, y, stride, transposed=False)
    return y


def convolve_backward(
    grad: Tensor, x: Tensor, weight: Tensor, stride: int
) -> tuple[Tensor, Tensor]:
    """Gradients of `convolve` with respect to the volumes and the kernels.

    Args:
        grad: Gradient of the result, of its shape.
        x: As for `convolve`, as the following.
        weight: Likewise.
        stride: Likewise.
    """
    x, grad = map(channels_last, (x, grad))
    grad_x = empty_channels_last(x, x.shape)
    _run_convolve(grad, weight, grad_x, stride, transposed=True)
    batch, channels, depth, height, _ = grad.shape
    rows = batch * depth * height
    chunks = triton.cdiv(rows, _ROWS)
    partial = torch.empty(chunks, 27, channels, device=x.device)
    _correlate[(9, chunks, triton.cdiv(channels, _CHANNELS))](
        x,
        grad,
        partial,
        rows,
        *x.shape[2:],
        *grad.shape[2:4],
        channels // 8,
        grad_width=grad.shape[4],
        stride=stride,
        block_rows=_ROWS,
        block_columns=_COLUMNS,
        block_channels=_CHANNELS,
    )
    grad_weight = partial.sum(0).t().reshape(weight.shape)
    return grad_x, grad_weight.to(weight.dtype)
