"""Channels-last tensors: images (B, C, H, W) and volumes (B, C, D, H, W)."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor


def channels_last(x: Tensor) -> Tensor:
    """An image or volume in channels last; itself where it is so already."""
    return x.contiguous(memory_format=_format(x.dim()))


def empty_channels_last(like: Tensor, shape: Sequence[int]) -> Tensor:
    """An uninitialised image or volume in channels last, of the dtype and device of ``like``."""
    shape = tuple(shape)
    layout = _format(len(shape))
    return torch.empty(shape, dtype=like.dtype, device=like.device, memory_format=layout)


def _format(dimensions: int) -> torch.memory_format:
    return torch.channels_last if dimensions == 4 else torch.channels_last_3d
