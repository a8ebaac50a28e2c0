"""What converters trace networks with."""

from __future__ import annotations

import copy
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from mobilestereonet.accelerate import accelerate
from mobilestereonet.nets.model import StereoModel

if TYPE_CHECKING:
    from mobilestereonet.accelerate.export import ExportableNet

Size = tuple[int, int]
"""Height and width in pixels."""


def exportable(
    net: StereoModel, *, rgb: bool = False, scores: bool = False, conv3d_as_2d: bool = False
) -> ExportableNet:
    """A copy of a network on the CPU, in float32, in the form that converters take.

    Args:
        net: The network, in any mode and on any device; it stays as it is.
        rgb: Take RGB in 0..1 and preprocess it inside.
        scores: Give the scores of a `VolumeModel`, not the disparity.
        conv3d_as_2d: Write 3D layers as 2D layers, where the network's form for export can.
    """
    return accelerate(
        copy.deepcopy(net).cpu().float(),
        "export",
        rgb=rgb,
        scores=scores,
        conv3d_as_2d=conv3d_as_2d,
    )


def example_pair(network: ExportableNet, size: Size | None = None) -> tuple[Tensor, Tensor]:
    """A pair of zeros to trace with, of the given size or of a small one."""
    if size is None:
        size = (4 * network.size_multiple, network.min_width)
    left, right = torch.zeros(2, 1, 3, *size)  # two tensors: one would be taken as one input
    return left, right
