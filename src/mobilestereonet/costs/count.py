"""MACs and parameters of any network at any input size, exact and as the paper counts.

One MAC (multiply-accumulate) is one product of a weight and a value. Two columns:

- **Exact**: convolutions and transposed convolutions alone, each product once; no bias, norm,
  activation, correlation or upsampling. Products with a border's zeros count, as is usual.
- **As the paper counts**, pinned down on its two final networks: also one for the bias of an
  output element, two for each element of a batch norm and one for each element of a ReLU or ReLU6
  module (the ReLU after an hourglass's two sums is none), and transposed convolutions per
  *output* element, which is the square (2D) or cube (3D) of the stride too many.

Both columns count one forward pass in eval mode, so both views and the last head alone, and the
learned cost volume layer by layer on the columns that have a partner, W/4 - i of plane i. At
256 x 512 that is 29.798 G (exact) and 32.204 G (paper) for the 2D network, 64.673 G and 153.141 G
for the 3D one. Computing every column of each plane in one batch would make 33.791 G of the
29.798 G. `LearnedVolume` does that, but shares its first layer's products among the planes.

The exact parameters are all of them; the paper's leave out the heads that only training calls.
"""

from __future__ import annotations

import math
from contextlib import ExitStack
from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor, nn

from mobilestereonet.errors import InputError
from mobilestereonet.nets.cost_volumes import REDUCED_CHANNELS, LearnedVolume
from mobilestereonet.nets.msnet import StereoNet
from mobilestereonet.nets.msnet_config import NetConfig


@dataclass(frozen=True)
class Cost:
    """Cost of a module or a network.

    Attributes:
        macs: Multiply-accumulates, exact.
        paper_macs: Multiply-accumulates as the paper counts.
        params: Parameters, all of them.
        paper_params: Parameters that a forward pass in eval mode calls, as the paper counts.
    """

    macs: int = 0
    paper_macs: int = 0
    params: int = 0
    paper_params: int = 0

    def __add__(self, other: Cost) -> Cost:
        return Cost(
            self.macs + other.macs,
            self.paper_macs + other.paper_macs,
            self.params + other.params,
            self.paper_params + other.paper_params,
        )


_KEEP_SHAPE = (nn.BatchNorm2d, nn.BatchNorm3d, nn.ReLU, nn.ReLU6)


def _same(x: Tensor) -> Tensor:
    return x


def layer_macs(layer: nn.Module, x: Tensor, y: Tensor) -> tuple[int, int]:
    """MACs of one layer: exact, and as the paper counts.

    Args:
        layer: Any module; one that holds others costs nothing itself.
        x: Its input. Only shapes are looked at, so both may be meta tensors.
        y: Its output.
    """
    if isinstance(layer, nn.ConvTranspose2d | nn.ConvTranspose3d):
        kernel = math.prod(layer.kernel_size)
        exact = x.numel() * kernel * layer.out_channels // layer.groups
        paper = y.numel() * kernel * layer.in_channels // layer.groups
    elif isinstance(layer, nn.Conv2d | nn.Conv3d):
        kernel = math.prod(layer.kernel_size)
        exact = paper = y.numel() * kernel * layer.in_channels // layer.groups
    elif isinstance(layer, nn.BatchNorm2d | nn.BatchNorm3d):
        return 0, 2 * y.numel()
    elif isinstance(layer, nn.ReLU | nn.ReLU6):
        return 0, y.numel()
    else:
        return 0, 0
    return exact, paper + (y.numel() if layer.bias is not None else 0)


def _trace(module: nn.Module, x: Tensor) -> tuple[Cost, Tensor]:
    """Cost of a module on a meta tensor, and its output. The module is of no use afterwards."""
    macs: list[tuple[int, int]] = []

    def record(layer: nn.Module, inputs: tuple[Any, ...], output: Tensor) -> None:
        macs.append(layer_macs(layer, inputs[0], output))

    with ExitStack() as hooks:
        for layer in module.modules():
            hooks.enter_context(layer.register_forward_hook(record))
            if isinstance(layer, _KEEP_SHAPE):
                # On meta tensors these take nearly all of the time.
                layer.forward = _same  # type: ignore[method-assign, assignment]
        y = module(x)
    params = sum(parameter.numel() for parameter in module.parameters())
    cost = Cost(
        macs=sum(exact for exact, _ in macs),
        paper_macs=sum(paper for _, paper in macs),
        params=params,
        paper_params=params,
    )
    return cost, y


def _volume_cost(volume: nn.Module, planes: int, height: int, width: int) -> Cost:
    """Cost of the cost volume at a quarter of the resolution, on the columns with a partner."""
    if not isinstance(volume, LearnedVolume):
        return Cost()
    # Its own forward pass rewrites the layers. Here they are plain, on one plane as wide as all
    # the cropped ones together: every cost is proportional to the number of columns.
    columns = sum(width - i for i in range(min(planes, width)))
    layers = nn.Sequential()
    for conv, norm in zip(volume.conv, volume.norm, strict=True):
        layers.extend([conv, norm, nn.ReLU()])
    pair = torch.empty(1, 1, 2 * REDUCED_CHANNELS, height, columns, device="meta")
    planes_cost, x = _trace(layers, pair)
    return planes_cost + _trace(volume.squeeze, x.squeeze(2))[0]


@torch.no_grad()
def count_costs(config: NetConfig, height: int = 256, width: int = 512) -> dict[str, Cost]:
    """MACs and parameters per module and in total, by shapes alone: nothing is computed.

    Args:
        config: The network.
        height: Height of a view, a multiple of the config's ``size_multiple``.
        width: Width of a view, likewise.

    Returns:
        Cost of "features" (both views), "channel reduction" (both views), "cost volume",
        "pre-hourglass", "hourglasses", "heads", for a network with one "coarse pass" and, last,
        "total".

    Raises:
        InputError: If the size is not a positive multiple.
    """
    multiple = config.size_multiple
    for name, size in (("height", height), ("width", width)):
        if size < multiple or size % multiple:
            raise InputError(f"{name} must be a positive multiple of {multiple}, got {size}")
    with torch.device("meta"):
        net = StereoNet(config).eval()
        views = torch.empty(2, 3, height, width)
    costs = {}
    costs["features"], views = _trace(net.features, views)
    costs["channel reduction"], views = _trace(net.reduction, views)
    quarter = views.shape[-2:]
    costs["cost volume"] = _volume_cost(net.volume, config.planes, *quarter)
    volume = views.new_empty(1, config.volume_channels, config.planes, *quarter)
    costs["pre-hourglass"], x = _trace(
        net.pre_hourglass, volume.flatten(1, 2) if config.dims == 2 else volume
    )
    costs["hourglasses"], x = _trace(nn.Sequential(*net.hourglasses), x)
    costs["heads"], _ = _trace(net.heads[-1], x)
    training_heads = sum(parameter.numel() for parameter in net.heads[:-1].parameters())
    costs["heads"] += Cost(params=training_heads)
    if config.coarse_pass:
        half = replace(config, coarse_pass=False, max_disparity=config.max_disparity // 2)
        passed = count_costs(half, height // 2, width // 2)["total"]
        guide, _ = _trace(net.guide, views.new_empty(1, 1, config.planes, *quarter))
        costs["coarse pass"] = guide + Cost(macs=passed.macs, paper_macs=passed.paper_macs)
    costs["total"] = sum(costs.values(), Cost())
    return costs
