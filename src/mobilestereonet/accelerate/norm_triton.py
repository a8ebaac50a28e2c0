"""Batch norm and the activation after it in one, on NVIDIA GPUs, in Triton.

In channels last a tensor is rows of channels, and a norm is sums down its columns, then one affine
map of them. PyTorch runs the activation by itself, and reads and writes everything once more for
it, in both directions.
"""

from __future__ import annotations

import math

import torch
import triton
import triton.language as tl
from torch import Tensor

from mobilestereonet.accelerate.layout import channels_last

Limits = tuple[float, float]
"""An activation's least and largest value."""

NO_LIMITS: Limits = (-math.inf, math.inf)
"""No activation."""

_ROWS, _CHANNELS = 128, 32
"""Rows and channels of a block."""

_STEPS = 16
"""Blocks below each other that a program sums up."""


@triton.jit(do_not_specialize=("rows", "eighths", "low", "high"))
def _column_sums(  # type: ignore[no-untyped-def]
    source,
    grad,
    centre,
    scale,
    shift,
    partial,  # (programs, 2, channels)
    rows,
    eighths,  # of the channels: rows begin where eight values are read at once
    low,
    high,
    backward: tl.constexpr,
    steps: tl.constexpr,
    block_rows: tl.constexpr,
    block_channels: tl.constexpr,
):
    """Sums of x - centre and its square or, backward, of the gradient and its product with it."""
    channels = 8 * eighths
    program = tl.program_id(0)
    channel = tl.program_id(1) * block_channels + tl.arange(0, block_channels)
    used = channel < channels
    middle = tl.load(centre + channel, mask=used, other=0.0)
    if backward:
        factor = tl.load(scale + channel, mask=used, other=0.0)
        offset = tl.load(shift + channel, mask=used, other=0.0)
    first = tl.zeros((block_rows, block_channels), tl.float32)
    second = tl.zeros((block_rows, block_channels), tl.float32)
    for step in range(steps):
        row = (program * steps + step) * block_rows + tl.arange(0, block_rows)
        place = row.to(tl.int64)[:, None] * channels + channel[None]
        inside = (row < rows)[:, None] & used[None]
        x = tl.load(source + place, mask=inside, other=0.0).to(tl.float32)
        if backward:
            z = x * factor[None] + offset[None]
            change = tl.load(grad + place, mask=inside, other=0.0).to(tl.float32)
            change = tl.where((z > low) & (z < high), change, 0.0)
            first += change
            second += change * (x - middle[None])
        else:
            x = tl.where(inside, x - middle[None], 0.0)
            first += x
            second += x * x
    place = partial + program * 2 * channels + channel
    tl.store(place, tl.sum(first, axis=0), mask=used)
    tl.store(place + channels, tl.sum(second, axis=0), mask=used)


@triton.jit(do_not_specialize=("rows", "eighths", "low", "high"))
def _map_columns(  # type: ignore[no-untyped-def]
    source,
    grad,
    result,
    scale,
    shift,
    slope,
    level,
    rows,
    eighths,  # of the channels: rows begin where eight values are read at once
    low,
    high,
    backward: tl.constexpr,
    block_rows: tl.constexpr,
    block_channels: tl.constexpr,
):
    """Norm and activation or, backward, the gradient through both."""
    channels = 8 * eighths
    row = tl.program_id(0) * block_rows + tl.arange(0, block_rows)
    channel = tl.program_id(1) * block_channels + tl.arange(0, block_channels)
    used = channel < channels
    factor = tl.load(scale + channel, mask=used, other=0.0)[None]
    place = row.to(tl.int64)[:, None] * channels + channel[None]
    inside = (row < rows)[:, None] & used[None]
    x = tl.load(source + place, mask=inside, other=0.0).to(tl.float32)
    z = x * factor + tl.load(shift + channel, mask=used, other=0.0)[None]
    if backward:
        change = tl.load(grad + place, mask=inside, other=0.0).to(tl.float32)
        change = tl.where((z > low) & (z < high), change, 0.0)
        z = change * factor + x * tl.load(slope + channel, mask=used, other=0.0)[None]
        z += tl.load(level + channel, mask=used, other=0.0)[None]
    else:
        # As PyTorch's activations: what is not a number stays so.
        z = tl.maximum(z, low, propagate_nan=tl.PropagateNan.ALL)
        z = tl.minimum(z, high, propagate_nan=tl.PropagateNan.ALL)
    tl.store(result + place, z.to(result.dtype.element_ty), mask=inside)


def _sums(
    x: Tensor, grad: Tensor | None, centre: Tensor, maps: tuple[Tensor, ...], limits: Limits
) -> Tensor:
    """Sums of x (B, C, ...) or, given a gradient, of that: (2, C), see `_column_sums`."""
    channels = x.shape[1]
    rows = x.numel() // channels
    programs = triton.cdiv(rows, _ROWS * _STEPS)
    partial = torch.empty(programs, 2, channels, device=x.device)
    _column_sums[(programs, triton.cdiv(channels, _CHANNELS))](
        x,
        x if grad is None else grad,  # any tensor, where none is read
        centre,
        *(maps or (centre, centre)),
        partial,
        rows,
        channels // 8,
        *limits,
        backward=grad is not None,
        steps=_STEPS,
        block_rows=_ROWS,
        block_channels=_CHANNELS,
    )
    return partial.sum(0)


def _mapped(x: Tensor, grad: Tensor | None, maps: tuple[Tensor, ...], limits: Limits) -> Tensor:
    """Norm and activation of x (B, C, ...) or, given a gradient, that of x."""
    channels = x.shape[1]
    rows = x.numel() // channels
    result = torch.empty_like(x)
    _map_columns[(triton.cdiv(rows, _ROWS), triton.cdiv(channels, _CHANNELS))](
        x,
        x if grad is None else grad,  # any tensor, where none is read
        result,
        *(maps if grad is not None else 2 * maps),
        rows,
        channels // 8,
        *limits,
        backward=grad is not None,
        block_rows=_ROWS,
        block_channels=_CHANNELS,
    )
    return result


def norm_activation(x: Tensor, scale: Tensor, shift: Tensor, limits: Limits) -> Tensor:
    """``clamp(scale * x + shift, *limits)`` per channel of (B, C, ...), C a multiple of 8."""
    return _mapped(channels_last(x), None, (scale, shift), limits)


def batch_statistics(x: Tensor) -> tuple[Tensor, Tensor]:
    """Mean (C,) and biased variance (C,) of (B, C, ...), in float32; C is a multiple of 8."""
    x = channels_last(x)
    count = x.numel() // x.shape[1]
    # Squares of what is left of the first place's values keep their digits.
    first = x.flatten(2)[0, :, 0].float()
    offset, square = _sums(x, None, first, (), NO_LIMITS) / count
    return first + offset, (square - offset * offset).clamp_min_(0)


def norm_activation_backward(
    grad: Tensor,
    x: Tensor,
    mean: Tensor,
    inverse: Tensor,
    maps: tuple[Tensor, Tensor],
    limits: Limits,
) -> tuple[Tensor, Tensor, Tensor]:
    """Gradients of a batch norm by the batch's own statistics, followed by an activation.

    Args:
        grad: Gradient of the result, (B, C, ...).
        x: The norm's input.
        mean: Its mean (C,).
        inverse: Its inverse standard deviation (C,).
        maps: Scale (C,) and shift (C,) of the norm.
        limits: The activation.

    Returns:
        Gradients with respect to the input, the weight and the bias.
    """
    x, grad = channels_last(x), channels_last(grad)
    count = x.numel() // x.shape[1]
    total, product = _sums(x, grad, mean, maps, limits)
    product = product * inverse
    slope = -maps[0] * inverse * product / count
    level = -maps[0] * total / count - slope * mean
    return _mapped(x, grad, (*maps, slope, level), limits), product, total
