"""Batch norm and the activation after it in one, on NVIDIA GPUs, in Triton.

In channels last a tensor is rows of channels, and a norm is sums down its columns, then one affine
map of them. PyTorch runs the activation by itself, and reads and writes everything once more for
it, in both directions.
"""

from __future__ import annotations

from typing import Any

import torch
import triton
import triton.language as tl
from torch import Tensor
from torch.autograd.function import once_differentiable

from mobilestereonet.accelerate.norm import Limits

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


def channels_last(x: Tensor) -> Tensor:
    """Images or volumes in channels last."""
    layout = torch.channels_last if x.dim() == 4 else torch.channels_last_3d
    return x.contiguous(memory_format=layout)


def norm_activation(
    x: Tensor,
    mean: Tensor,
    variance: Tensor,
    weight: Tensor,
    bias: Tensor,
    eps: float,
    limits: Limits,
) -> Tensor:
    """Norm by known statistics (C,) and activation of (B, C, ...), without a gradient."""
    scale = weight * (variance + eps).rsqrt()
    return _mapped(channels_last(x), None, (scale, bias - mean * scale), limits)


class TritonNormActivation(torch.autograd.Function):
    """Norm by the batch's own statistics, and activation. Channels are multiples of 8.

    Statistics are taken in float32; the result has the type of x.
    """

    @staticmethod
    def forward(
        ctx: Any, x: Tensor, weight: Tensor, bias: Tensor, eps: float, limits: Limits
    ) -> tuple[Tensor, Tensor, Tensor]:
        """(B, C, ...) -> the same shape, the mean (C,) and the biased variance (C,)."""
        x = channels_last(x)
        count = x.numel() // x.shape[1]
        # Squares of what is left of the first place's values keep their digits.
        first = x.flatten(2)[0, :, 0].float()
        offset, square = _sums(x, None, first, (), limits) / count
        variance = (square - offset * offset).clamp_min_(0)
        mean = first + offset
        inverse = (variance + eps).rsqrt()
        scale = weight * inverse
        shift = bias - mean * scale
        ctx.limits = limits
        ctx.save_for_backward(x, mean, inverse, scale, shift)
        ctx.mark_non_differentiable(mean, variance)
        return _mapped(x, None, (scale, shift), limits), mean, variance

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor | None, ...]:
        """The gradients of x, weight and bias."""
        x, mean, inverse, scale, shift = ctx.saved_tensors
        grad = channels_last(grads[0])
        count = x.numel() // x.shape[1]
        total, product = _sums(x, grad, mean, (scale, shift), ctx.limits)
        product = product * inverse
        slope = -scale * inverse * product / count
        level = -scale * total / count - slope * mean
        grad_x = _mapped(x, grad, (scale, shift, slope, level), ctx.limits)
        return grad_x, product, total, None, None
