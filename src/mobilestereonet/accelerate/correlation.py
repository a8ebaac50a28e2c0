"""Correlation along the rows, and Fast DS-CS's census costs, by products of matrices.

All left columns of a row times all right ones are one product of matrices, (W, C) times (C, W'),
of which the displacements that are asked for are a band of diagonals: ``docs/how-it-works.md``,
"Exact accelerations", has an example. It computes more products than a loop over the
displacements, but reads each feature a few times instead of once per displacement.
"""

from __future__ import annotations

from collections.abc import Iterator

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from mobilestereonet.accelerate.modules import replace_modules
from mobilestereonet.nets.fast_ds_cs import MEANS, SCALES, YUV, CostSignatures, census
from mobilestereonet.nets.operations import Correlation1D

_CACHED_ELEMENTS = 1 << 17
"""Elements of a product of matrices, which stays in the processor's cache."""

_GPU_ELEMENTS = 1 << 26
"""Elements of a product of matrices on a GPU: 256 MB, most batches at once."""


def correlate_by_products(net: nn.Module) -> None:
    """Replace the correlations of a network, in place."""
    replace_modules(net, Correlation1D, lambda layer: BandedCorrelation1D(layer.reach))


def count_bits_by_products(net: nn.Module) -> None:
    """Replace the cost signatures of a network, in place."""
    replace_modules(net, CostSignatures, lambda layer: BandedCostSignatures(layer.planes))


class BandedCorrelation1D(Correlation1D):
    """`Correlation1D` by products of matrices."""

    def forward(self, left: Tensor, right: Tensor) -> Tensor:
        """See `Correlation1D`; the result is in channels last."""
        batch, channels, height, width = left.shape
        count = 2 * self.reach + 1
        lines = torch.cat(list(band(left / channels, right, -self.reach, count)))
        return lines.view(batch, height, width, count).permute(0, 3, 1, 2)


def band(left: Tensor, right: Tensor, first: int, count: int) -> Iterator[Tensor]:
    """Sums over the channels of left column x times right column x + first + k.

    Args:
        left: (B, C, H, W).
        right: Likewise.
        first: Least displacement.
        count: Number K of displacements.

    Yields:
        Some lines (N, W, K) of all B H at a time; zero where the right column is outside.
    """
    width = left.shape[-1]
    right = F.pad(right, (-first, first + count - 1))
    step = max(
        1, (_GPU_ELEMENTS if left.is_cuda else _CACHED_ELEMENTS) // (width * right.shape[-1])
    )
    lines = [view.permute(0, 2, 3, 1).flatten(0, 1) for view in (left, right)]  # (B H, W, C)
    for one, other in zip(*(view.split(step) for view in lines), strict=True):
        products = one @ other.mT
        # Element k of column x is that in column x + k.
        strides = (products.stride(0), products.stride(1) + 1, 1)
        yield products.as_strided((len(one), width, count), strides)


class BandedCostSignatures(CostSignatures):
    """`CostSignatures` by products of matrices, and in place.

    Codes of +1 and -1 that differ in n of 24 bits have the product 24 - 2 n.
    """

    def forward(self, left: Tensor, right: Tensor) -> Tensor:
        """See `CostSignatures`."""
        if torch.is_grad_enabled() and (left.requires_grad or right.requires_grad):
            return super().forward(left, right)
        batch, _, height, width = left.shape
        matrix = left.new_tensor(YUV)[:, :, None, None]
        left, right = F.conv2d(left, matrix), F.conv2d(right, matrix)
        code, other = (2 * census(view[:, :1]).to(view.dtype) - 1 for view in (left, right))
        count = min(self.planes, width)
        products = left.new_empty(count, batch * height, width)
        top = 0
        for lines in band(code, other, 1 - count, count):
            products[:, top : top + len(lines)] = lines.permute(2, 0, 1)
            top += len(lines)
        products = products.view(count, batch, height, width)
        bits = code.shape[1]
        mean, scale = (left.new_tensor(values)[:, None, None] for values in (MEANS, SCALES))
        costs = left.new_empty(batch, self.planes, 3, height, width)
        for plane in range(self.planes):
            i = min(plane, count - 1)
            here = costs[:, plane]
            here[:, 0, :, i:] = (bits - products[count - 1 - i, ..., i:]) / 2
            here[:, 1:, :, i:] = (left[:, 1:, :, i:] - right[:, 1:, :, : width - i]).abs_()
            here[..., :i] = here[..., i : i + 1]  # columns without a partner
            here.sub_(mean).mul_(scale)
        return costs.flatten(1, 2)
