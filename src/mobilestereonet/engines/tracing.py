"""What converters trace networks with."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
from torch import Tensor

if TYPE_CHECKING:
    from mobilestereonet.accelerate.export import ExportableNet

Size = tuple[int, int]
"""Height and width in pixels."""


def example_pair(network: ExportableNet, size: Size | None = None) -> tuple[Tensor, Tensor]:
    """A pair of zeros to trace with, of the given size or of a small one."""
    if size is None:
        size = (4 * network.size_multiple, network.min_width)
    left, right = torch.zeros(2, 1, 3, *size)  # two tensors: one would be taken as one input
    return left, right
