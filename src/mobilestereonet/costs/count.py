"""MACs and parameters of any network at any input size: exact, and as ptflops counts.

One MAC (multiply-accumulate) is one product of a weight and a value. Two columns:

- **Exact**: convolutions, transposed convolutions and linear layers, each product once; no bias,
  norm, activation, correlation or upsampling. Products with a border's zeros count, as is usual.
- **As the paper counts**: what ptflops printed before its version 0.7.5, by which the authors
  counted. It adds one for the bias of an output element, two for an element of a norm with weights
  (one without), one for an element of an activation or of an average's or maximum's input, and
  takes transposed convolutions at their *output*, which is the square (2D) or cube (3D) of the
  stride too many. Only modules count: the ReLU after an hourglass's two sums is a function.

Both columns count one forward pass in eval mode, so both views and the last head alone, and a
learned cost volume on the columns that have a partner, W/4 - i of plane i. At 256 x 512 that is
29.798 G (exact) and 32.204 G (paper) for the 2D network, 64.673 G and 153.141 G for the 3D one.

The exact parameters are all of them; the paper's leave out the heads that only training calls.
"""

from __future__ import annotations

import copy
import math
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import torch
from torch import Tensor, nn

from mobilestereonet.errors import InputError, check_multiple
from mobilestereonet.nets import StereoModel, build_model


@dataclass(frozen=True)
class Cost:
    """Cost of a part of a network, or of all of it.

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


_TRANSPOSED = (nn.ConvTranspose1d, nn.ConvTranspose2d, nn.ConvTranspose3d)
_CONVOLUTIONS = (nn.Conv1d, nn.Conv2d, nn.Conv3d)
_NORMS = (
    *(nn.BatchNorm1d, nn.BatchNorm2d, nn.BatchNorm3d),
    *(nn.InstanceNorm1d, nn.InstanceNorm2d, nn.InstanceNorm3d),
    *(nn.GroupNorm, nn.LayerNorm),
)
_ACTIVATIONS = (nn.ReLU, nn.ReLU6, nn.PReLU, nn.LeakyReLU, nn.ELU, nn.GELU)
_POOLS = (
    *(nn.AvgPool2d, nn.AvgPool3d, nn.MaxPool2d, nn.MaxPool3d),
    *(nn.AdaptiveAvgPool2d, nn.AdaptiveAvgPool3d, nn.AdaptiveMaxPool2d, nn.AdaptiveMaxPool3d),
)


def layer_macs(layer: nn.Module, x: Tensor, y: Tensor) -> tuple[int, int]:
    """MACs of one layer: exact, and as the paper counts.

    Args:
        layer: Any module; one that holds others costs nothing itself.
        x: Its input. Only shapes are looked at, so both may be meta tensors.
        y: Its output.
    """
    if isinstance(layer, _TRANSPOSED):
        kernel = math.prod(layer.kernel_size)
        exact = x.numel() * kernel * layer.out_channels // layer.groups
        paper = y.numel() * kernel * layer.in_channels // layer.groups
    elif isinstance(layer, _CONVOLUTIONS):
        exact = paper = y.numel() * math.prod(layer.kernel_size) * layer.in_channels // layer.groups
    elif isinstance(layer, nn.Linear):
        exact = paper = y.numel() * layer.in_features
    elif isinstance(layer, _NORMS):
        return 0, (2 if getattr(layer, "affine", False) else 1) * y.numel()
    elif isinstance(layer, _ACTIVATIONS):
        return 0, y.numel()
    elif isinstance(layer, _POOLS):
        return 0, x.numel()
    elif isinstance(layer, nn.Upsample):
        return 0, y.numel()
    else:
        return 0, 0
    return exact, paper + (y.numel() if layer.bias is not None else 0)


@torch.no_grad()
def count_costs(
    network: StereoModel | str,
    height: int = 256,
    width: int = 512,
    config: Mapping[str, Any] | None = None,
    *,
    elementwise: bool = True,
) -> dict[str, Cost]:
    """MACs and parameters per part and in total, by shapes alone: nothing is computed.

    Args:
        network: A network as `nets` writes it, or its name (see `model_info`).
        height: Height of a view, a multiple of the network's ``size_multiple``.
        width: Width of a view, likewise.
        config: With a name, fields of the network's config to change.
        elementwise: Count norms, activations, pools and upsampling in the paper's column, too.

    Returns:
        Cost of each part, by the names of the network's attributes, and, last, "total".

    Raises:
        FileNotFoundError: See `model_info`.
        InputError: If the size is not a positive multiple, the name or a field is unknown, or a
            value is refused.
    """
    net = _on_meta(network, config or {})
    multiple = net.size_multiple
    for name, size in (("height", height), ("width", width)):
        check_multiple(name, size, multiple)
    costs: defaultdict[str, Cost] = defaultdict(Cost)
    called: set[str] = set()
    for name, module in net.named_modules():
        module.register_forward_hook(partial(_record, name, costs, called, elementwise))
        if isinstance(module, (*_NORMS, *_ACTIVATIONS)):
            # Most of the time of a pass would go into their meta kernels.
            module.forward = _same  # type: ignore[method-assign, assignment]
    view = torch.empty(1, 3, height, width, device="meta")
    net(view, view)
    for name, parameter in net.named_parameters():
        count, owner = parameter.numel(), name.rpartition(".")[0]
        part = Cost(params=count, paper_params=count if owner in called else 0)
        costs[name.partition(".")[0]] += part
    parts = [name for name, _ in net.named_children() if name in costs]
    parts += [name for name in costs if name not in parts]
    return {**{part: costs[part] for part in parts}, "total": sum(costs.values(), Cost())}


def _on_meta(network: StereoModel | str, overrides: Mapping[str, Any]) -> StereoModel:
    """A copy of a network in eval mode, without the values of its weights."""
    if isinstance(network, str):
        with torch.device("meta"):
            return build_model(network, **overrides).eval()
    if overrides:
        raise InputError(f"{', '.join(overrides)}: a network has its config already: give its name")
    return copy.deepcopy(network).to("meta").eval()


def _record(
    name: str,
    costs: defaultdict[str, Cost],
    called: set[str],
    elementwise: bool,
    layer: nn.Module,
    inputs: tuple[Any, ...],
    output: Any,
) -> None:
    """Forward hook of the module of this name."""
    called.add(name)
    if isinstance(output, Tensor) and inputs and isinstance(inputs[0], Tensor):
        exact, paper = layer_macs(layer, inputs[0], output)
        if exact or (paper and elementwise):
            costs[name.partition(".")[0]] += Cost(macs=exact, paper_macs=paper)


def _same(x: Tensor) -> Tensor:
    return x
