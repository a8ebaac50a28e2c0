"""GA-Net's guided layers line by line, in memory that stays in a cache, with their gradients.

A direction of the semi-global aggregation needs the line before each line. Lines that lie together
in memory, one after the other, and sums in place are several times faster than the plain form;
a backward pass of its own keeps the aggregated volume alone, where autograd keeps every term.
"""

from __future__ import annotations

from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from mobilestereonet.accelerate.modules import replace_modules
from mobilestereonet.nets.guided_aggregation import (
    DEPTH,
    WINDOW,
    LocalAggregation,
    SemiGlobalAggregation,
    direction_weights,
)

_CACHED_ELEMENTS = 1 << 17
"""Elements of a temporary that stays in the processor's cache."""


def aggregate_in_lines(net: nn.Module) -> None:
    """Replace the guided layers of a network, in place."""
    replace_modules(net, SemiGlobalAggregation, lambda _: LinewiseSemiGlobalAggregation())
    replace_modules(net, LocalAggregation, lambda _: RowwiseLocalAggregation())


class LinewiseSemiGlobalAggregation(SemiGlobalAggregation):
    """`SemiGlobalAggregation` on lines that lie together in memory."""

    def forward(self, cost: Tensor, guidance: Tensor) -> Tensor:
        """See `SemiGlobalAggregation`."""
        down, up, right, left = direction_weights(guidance, cost.shape[1])
        vertical = _both_ways(cost, down, up, dim=-2)
        return torch.maximum(vertical, _both_ways(cost, right, left, dim=-1))


def _both_ways(cost: Tensor, forwards: Tensor, backwards: Tensor, dim: int) -> Tensor:
    lines = cost.movedim(dim, 0).contiguous()
    ways = ((forwards, False), (backwards, True))
    one, other = (scan(lines, w.movedim(dim, 0).contiguous(), reverse) for w, reverse in ways)
    return torch.maximum(one, other).movedim(0, dim)


@torch.library.custom_op("mobilestereonet::guided_scan", mutates_args=())
def scan(cost: Tensor, weights: Tensor, reverse: bool) -> Tensor:
    """Aggregate a line after the other, see `nets.guided_aggregation.aggregate`.

    Args:
        cost: Lines (L, B, C, D, N), contiguous.
        weights: (L, B, C, 5, N), contiguous.
        reverse: From the last line to the first.

    Returns:
        (L, B, C, D, N).
    """
    result = torch.empty_like(cost)
    before: Tensor | None = None
    for line, all_weights, total in _lines(reverse, cost, weights, result):
        w0, w1, w2, w3, w4 = all_weights.split(1, dim=2)
        if before is None:
            torch.mul(line, all_weights.sum(dim=2, keepdim=True), out=total)
        else:
            torch.mul(line, w0, out=total)
            total.addcmul_(before, w1)
            total[:, :, 1:].addcmul_(before[:, :, :-1], w2)
            total[:, :, :1].addcmul_(line[:, :, :1], w2)
            total[:, :, :-1].addcmul_(before[:, :, 1:], w3)
            total[:, :, -1:].addcmul_(line[:, :, -1:], w3)
            total.addcmul_(before.amax(dim=2, keepdim=True), w4)
        before = total
    return result


@torch.library.custom_op("mobilestereonet::guided_scan_backward", mutates_args=())
def _scan_backward(
    grad: Tensor, cost: Tensor, weights: Tensor, result: Tensor, reverse: bool
) -> tuple[Tensor, Tensor]:
    """Gradients of the costs and of the weights, from the last line of the scan to its first."""
    grad_cost, grad_weights = torch.empty_like(cost), torch.empty_like(weights)
    lines = list(_lines(not reverse, cost, weights, result, grad, grad_cost, grad_weights))
    from_next: Tensor | None = None
    for index, (line, all_weights, _, g, g_line, g_weights) in enumerate(lines):
        w0, w1, w2, w3, w4 = all_weights.split(1, dim=2)
        g = g if from_next is None else g + from_next
        if index == len(lines) - 1:
            torch.mul(g, all_weights.sum(dim=2, keepdim=True), out=g_line)
            g_weights.copy_((g * line).sum(dim=2, keepdim=True))
            break
        before = lines[index + 1][2]
        most = before.amax(dim=2, keepdim=True)
        torch.mul(g, w0, out=g_line)
        g_line[:, :, :1].addcmul_(g[:, :, :1], w2)
        g_line[:, :, -1:].addcmul_(g[:, :, -1:], w3)
        sums = g.sum(dim=2)
        g_weights[:, :, 0] = (g * line).sum(dim=2)
        g_weights[:, :, 1] = (g * before).sum(dim=2)
        g_weights[:, :, 2] = (g[:, :, 1:] * before[:, :, :-1]).sum(dim=2) + g[:, :, 0] * line[
            :, :, 0
        ]
        g_weights[:, :, 3] = (g[:, :, :-1] * before[:, :, 1:]).sum(dim=2) + g[:, :, -1] * line[
            :, :, -1
        ]
        g_weights[:, :, 4] = most[:, :, 0] * sums
        from_next = g * w1
        from_next[:, :, :-1].addcmul_(g[:, :, 1:], w2)
        from_next[:, :, 1:].addcmul_(g[:, :, :-1], w3)
        largest = (before == most).to(before.dtype)
        from_next.addcmul_(largest / largest.sum(dim=2, keepdim=True), w4 * sums.unsqueeze(2))
    return grad_cost, grad_weights


def _lines(reverse: bool, *tensors: Tensor) -> Any:
    """The lines of all tensors together, in the order of a scan."""
    lines = zip(*(tensor.unbind(0) for tensor in tensors), strict=True)
    return reversed(list(lines)) if reverse else lines


@scan.register_fake
def _(cost: Tensor, weights: Tensor, reverse: bool) -> Tensor:
    return torch.empty_like(cost)


@_scan_backward.register_fake
def _(
    grad: Tensor, cost: Tensor, weights: Tensor, result: Tensor, reverse: bool
) -> tuple[Tensor, Tensor]:
    return torch.empty_like(cost), torch.empty_like(weights)


def _keep_scan(ctx: Any, inputs: Any, output: Tensor) -> None:
    cost, weights, ctx.reverse = inputs
    ctx.save_for_backward(cost, weights, output)


def _backward_of_scan(ctx: Any, grad: Tensor) -> tuple[Tensor, Tensor, None]:
    return *_scan_backward(grad.contiguous(), *ctx.saved_tensors, ctx.reverse), None


scan.register_autograd(_backward_of_scan, setup_context=_keep_scan)


class RowwiseLocalAggregation(LocalAggregation):
    """`LocalAggregation` on some rows at a time."""

    def aggregate(self, volume: Tensor, weights: Tensor) -> Tensor:
        """See `LocalAggregation`."""
        total: Tensor = local_aggregation(volume.contiguous(), weights.contiguous())
        return total


@torch.library.custom_op("mobilestereonet::local_aggregation", mutates_args=())
def local_aggregation(volume: Tensor, weights: Tensor) -> Tensor:
    """`aggregate_locally`: (B, D, H, W) and (B, 75, H, W) -> (B, D, H, W).

    Beyond the borders are zeros; what falls there is added at the centre.
    """
    padded = F.pad(volume, _AROUND)
    inside, outside = _split(weights)
    total = volume * outside.sum(dim=1, keepdim=True)
    total[:, 0] += volume[:, 0] * inside[:, : WINDOW**2].sum(dim=1)
    total[:, -1] += volume[:, -1] * inside[:, -(WINDOW**2) :].sum(dim=1)
    for rows in _blocks(volume):
        block = total[:, :, rows]
        for weight, part in zip(inside[:, :, rows].split(1, 1), _parts(padded, rows), strict=True):
            block.addcmul_(part, weight)
    return total


@torch.library.custom_op("mobilestereonet::local_aggregation_backward", mutates_args=())
def _local_backward(grad: Tensor, volume: Tensor, weights: Tensor) -> tuple[Tensor, Tensor]:
    """Gradients of the volume and of the weights."""
    padded = F.pad(volume, _AROUND)
    inside, outside = _split(weights)
    grad_padded = torch.zeros_like(padded)
    grad_inside = torch.empty_like(weights)
    for rows in _blocks(volume):
        g = grad[:, :, rows]
        parts = zip(_parts(padded, rows), _parts(grad_padded, rows), strict=True)
        for index, (part, grad_part) in enumerate(parts):
            grad_part.addcmul_(g, inside[:, index : index + 1, rows])
            grad_inside[:, index, rows] = (g * part).sum(dim=1)
    grad_volume = grad_padded[:, 1:-1, 2:-2, 2:-2].contiguous()
    products = grad * volume
    ends = ((0, slice(None, WINDOW**2)), (-1, slice(-(WINDOW**2), None)))
    for plane, taps in ends:
        grad_volume[:, plane] += grad[:, plane] * inside[:, taps].sum(dim=1)
        grad_inside[:, taps] += products[:, plane].unsqueeze(1)
    grad_volume.addcmul_(grad, outside.sum(dim=1, keepdim=True))
    beyond = _beyond(weights)
    return grad_volume, torch.where(beyond, products.sum(dim=1, keepdim=True), grad_inside)


_AROUND = (*(WINDOW // 2,) * 4, *(DEPTH // 2,) * 2)
"""Padding of columns, rows and disparities."""


def _beyond(weights: Tensor) -> Tensor:
    """Which weights (1, 75, H, W) are of rows or columns outside the view."""
    height, width = weights.shape[-2:]
    inside = F.pad(weights.new_ones(1, 1, height, width), _AROUND[:4])
    return F.unfold(inside, WINDOW).view(1, -1, height, width).repeat(1, DEPTH, 1, 1) == 0


def _split(weights: Tensor) -> tuple[Tensor, Tensor]:
    """Weights of positions inside the view, and of those outside; zero for the others."""
    beyond = _beyond(weights)
    return weights.masked_fill(beyond, 0), weights.masked_fill(~beyond, 0)


def _blocks(volume: Tensor) -> list[slice]:
    """Rows that are worked on together."""
    batch, depth, height, width = volume.shape
    step = height if volume.is_cuda else max(1, _CACHED_ELEMENTS // (batch * depth * width))
    return [slice(top, min(top + step, height)) for top in range(0, height, step)]


def _parts(padded: Tensor, rows: slice) -> list[Tensor]:
    """What each of the 75 weights multiplies, for some rows."""
    depth, _, width = (
        side - 2 * pad for side, pad in zip(padded.shape[1:], (1, 2, 2), strict=True)
    )
    return [
        padded[:, k : k + depth, rows.start + i : rows.stop + i, j : j + width]
        for k in range(DEPTH)
        for i in range(WINDOW)
        for j in range(WINDOW)
    ]


@local_aggregation.register_fake
def _(volume: Tensor, weights: Tensor) -> Tensor:
    return torch.empty_like(volume)


@_local_backward.register_fake
def _(grad: Tensor, volume: Tensor, weights: Tensor) -> tuple[Tensor, Tensor]:
    return torch.empty_like(volume), torch.empty_like(weights)


def _keep_local(ctx: Any, inputs: Any, output: Tensor) -> None:
    ctx.save_for_backward(*inputs)


def _backward_of_local(ctx: Any, grad: Tensor) -> tuple[Tensor, Tensor]:
    gradients: tuple[Tensor, Tensor] = _local_backward(grad.contiguous(), *ctx.saved_tensors)
    return gradients


local_aggregation.register_autograd(_backward_of_local, setup_context=_keep_local)
