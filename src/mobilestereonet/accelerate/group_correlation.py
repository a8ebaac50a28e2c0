"""Group-wise correlation by products of matrices, some rows of the views at a time.

The products of a left and a right pixel's features, one per channel, are a row of memory. Their
means per group are this row times a matrix (channels, groups), which processors multiply faster
than they add up groups; and some rows of the views stay in a processor's cache for all planes.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import torch
from torch import Tensor

from mobilestereonet.nets.cost_volumes import Correlation

_CACHED_BYTES = 1 << 23
"""Bytes of the products of some rows, which stay in the processor's cache."""


class StackedCorrelation(Correlation):
    """`Correlation` for inference, in the memory order of the encoder.

    With ``columns_first`` that is by columns, disparities, rows and channels, else by disparities,
    rows, columns and channels.
    """

    def __init__(self, volume: Correlation, *, columns_first: bool) -> None:
        super().__init__(volume.groups)
        self.columns_first = columns_first

    def forward(
        self, left: Tensor, right: Tensor, planes: int, start: Tensor | None = None
    ) -> Tensor:
        """(B, C, H, W) twice -> (B, groups, D, H, W), D being ``planes``; see `Correlation`."""
        batch, _, height, width = left.shape
        if self.columns_first:
            memory = left.new_empty(batch, width, planes, height, self.groups)
            volume = memory.permute(0, 4, 2, 3, 1)
        else:
            volume = left.new_empty(batch, planes, height, width, self.groups).movedim(-1, 1)
        fill_correlation(volume, left, right, start)
        return volume


class BatchedCorrelation(Correlation):
    """`Correlation` for training, in channels last, each product made once in either direction.

    Autograd through slices would add up 2 D padded gradients, in the features' own precision.
    """

    def __init__(self, volume: Correlation) -> None:
        super().__init__(volume.groups)

    def forward(
        self, left: Tensor, right: Tensor, planes: int, start: Tensor | None = None
    ) -> Tensor:
        """(B, C, H, W) twice -> (B, groups, D, H, W), D being ``planes``; see `Correlation`."""
        volume: Tensor = group_means(left, right, start, planes, self.groups)
        return volume


def fill_correlation(
    volume: Tensor, left: Tensor, right: Tensor, start: Tensor | None = None
) -> None:
    """Compute a `Correlation` into a volume that exists.

    Args:
        volume: (B, groups, D, H, W), in any memory order.
        left: Features of the left views, (B, C, H, W), best in channels last.
        right: Features of the right views, likewise.
        start: First disparity of each pixel's band, (B, H, W) int64; None: 0.
    """
    groups, channels = volume.shape[1], left.shape[1]
    volume = volume.permute(0, 2, 3, 4, 1)
    left, right = (view.permute(0, 2, 3, 1).contiguous() for view in (left, right))
    means = torch.eye(groups, dtype=left.dtype, device=left.device)
    means = means.repeat_interleave(channels // groups, dim=0) * (groups / channels)
    for images, rows in _blocks(left):
        block = volume[images, :, rows].unbind(1)
        views = left[images, rows], right[images, rows]
        if start is None:
            _fill_planes(block, *views, means)
        else:
            _fill_band(block, *views, means, start[images, rows])


def _blocks(view: Tensor) -> Iterator[tuple[slice, slice]]:
    """Images and rows of a view (B, H, W, C) to work on together; all of them on a GPU."""
    batch, height, width, channels = view.shape
    if view.is_cuda:
        yield slice(batch), slice(height)
        return
    step = max(1, _CACHED_BYTES // (width * channels * view.element_size()))
    for image in range(batch):
        for top in range(0, height, step):
            yield slice(image, image + 1), slice(top, top + step)


def _fill_planes(planes: tuple[Tensor, ...], left: Tensor, right: Tensor, means: Tensor) -> None:
    width = left.shape[2]
    for i, plane in enumerate(planes):
        plane[:, :, :i] = 0  # columns without a partner
        if i < width:
            plane[:, :, i:] = (left[:, :, i:] * right[:, :, : width - i]) @ means


def _fill_band(
    planes: tuple[Tensor, ...], left: Tensor, right: Tensor, means: Tensor, start: Tensor
) -> None:
    for i, plane in enumerate(planes):
        partner, there = _partners(right, start + i)
        plane[:] = (partner.mul_(left) @ means).mul_(there)


def _partners(right: Tensor, shift: Tensor) -> tuple[Tensor, Tensor]:
    """Right features (B, H, W, C) at other shifts (B, H, W) of each column.

    The features of a pixel are one row of memory, so that this is a copy of rows.

    Returns:
        (B, H, W, C), and where there is such a column, (B, H, W, 1).
    """
    column = torch.arange(right.shape[2], device=right.device)
    pixel = torch.arange(shift.numel(), device=right.device).view(shift.shape)
    rows = (pixel - shift.minimum(column)).flatten()
    partner = right.flatten(0, 2).index_select(0, rows).view(right.shape)
    return partner, (shift <= column).unsqueeze(-1)


@torch.library.custom_op("mobilestereonet::group_means", mutates_args=())
def group_means(
    left: Tensor, right: Tensor, start: Tensor | None, planes: int, groups: int
) -> Tensor:
    """`fill_correlation` of a new volume, with a derivative."""
    batch, _, height, width = left.shape
    volume = left.new_empty(batch, planes, height, width, groups).permute(0, 4, 1, 2, 3)
    fill_correlation(volume, left, right, start)
    return volume


@group_means.register_fake
def _(left: Tensor, right: Tensor, start: Tensor | None, planes: int, groups: int) -> Tensor:
    batch, _, height, width = left.shape
    return left.new_empty(batch, planes, height, width, groups).permute(0, 4, 1, 2, 3)


@torch.library.custom_op("mobilestereonet::group_means_backward", mutates_args=())
def _group_means_backward(
    grad: Tensor, left: Tensor, right: Tensor, start: Tensor | None
) -> tuple[Tensor, Tensor]:
    groups, planes = grad.shape[1:3]
    grad = grad.permute(0, 2, 3, 4, 1).unsqueeze(-1)
    views = [view.permute(0, 2, 3, 1).unflatten(-1, (groups, -1)) for view in (left, right)]
    width, share = left.shape[-1], groups / left.shape[1]
    dtype = torch.promote_types(left.dtype, torch.float32)
    totals = [torch.zeros_like(view, dtype=dtype) for view in views]
    column = torch.arange(width, device=left.device)
    for i in range(planes):
        if start is None:
            plane, end = grad[:, i, :, i:], max(0, width - i)
            totals[0][:, :, i:].addcmul_(plane, views[1][:, :, :end], value=share)
            totals[1][:, :, :end].addcmul_(plane, views[0][:, :, i:], value=share)
        else:
            partner, there = _partners(views[1].flatten(-2), start + i)
            plane = grad[:, i] * there.unsqueeze(-1)
            totals[0].addcmul_(plane, partner.view(views[0].shape), value=share)
            rows = (column - start - i).clamp_min(0)[..., None, None].expand(views[0].shape)
            totals[1].scatter_add_(2, rows, (plane * views[0] * share).to(dtype))
    grad_left, grad_right = (
        total.flatten(-2).permute(0, 3, 1, 2).to(left.dtype) for total in totals
    )
    return grad_left, grad_right


@_group_means_backward.register_fake
def _(grad: Tensor, left: Tensor, right: Tensor, start: Tensor | None) -> tuple[Tensor, Tensor]:
    return torch.empty_like(left), torch.empty_like(right)


def _keep_views(ctx: Any, inputs: tuple[Any, ...], output: Tensor) -> None:
    left, right, start = inputs[:3]
    ctx.save_for_backward(left, right, start)


def _group_means_gradient(ctx: Any, grad: Tensor) -> tuple[Tensor | None, ...]:
    return *_group_means_backward(grad, *ctx.saved_tensors), None, None, None


group_means.register_autograd(_group_means_gradient, setup_context=_keep_views)
