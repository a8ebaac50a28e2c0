"""`FusedConv`: convolution, sum and activation in one pass over memory, by oneDNN.

See ``docs/how-it-works.md``, "Exact accelerations".
"""

from __future__ import annotations

import functools
from typing import Any, cast

import torch
import torch.nn.functional as F
from torch import Tensor, nn

_ONEDNN: dict[str, tuple[str, list[float]]] = {
    "none": ("none", []),
    "relu": ("relu", []),
    "relu6": ("hardtanh", [0.0, 6.0]),
}
"""oneDNN's names and limits of the activations that it can append to a convolution."""


def activation_name(layer: nn.Module) -> str:
    """What `FusedConv` calls an activation: "relu" or "relu6"; "none" for other layers."""
    if isinstance(layer, nn.ReLU):
        return "relu"
    return "relu6" if isinstance(layer, nn.ReLU6) else "none"


class FusedConv(nn.Module):
    """``activation(conv(x) + other)`` in 2D or 3D: by oneDNN where it can, else by PyTorch.

    Next to 1x1 and depthwise convolutions, which wait for memory, an activation of its own costs
    about a third of the convolution before it.
    """

    def __init__(self, conv: nn.Conv2d | nn.Conv3d, activation: str = "none") -> None:
        super().__init__()
        self.conv = conv
        self.activation = activation

    def forward(self, x: Tensor, other: Tensor | None = None, *, pad_first: bool = True) -> Tensor:
        """Convolve.

        Args:
            x: (B, C, H, W) or (B, C, D, H, W).
            other: Tensor of the result's shape that is added to the convolution.
            pad_first: False leaves out the padding along the first of the spatial axes.
        """
        conv = self.conv
        padding = list(cast(tuple[int, ...], conv.padding))
        if not pad_first:
            padding[0] = 0
        size = (padding, conv.stride, conv.dilation, conv.groups)
        if not _runs_onednn(x):
            y = _convolve(x, conv.weight, conv.bias, *size)
            return _activate(y if other is None else y + other, self.activation)
        if other is None:
            return _onednn(x, conv.weight, conv.bias, *size, activation=self.activation)
        if other.shape[2:].numel() == 1:  # PyTorch 2.11 has no sum of single pixels
            return _activate(_onednn(x, conv.weight, conv.bias, *size) + other, self.activation)
        if self.activation == "relu6":  # oneDNN can follow a sum by a ReLU alone
            return _activate(_onednn_sum(x, other, conv.weight, conv.bias, *size), "relu6")
        relu = self.activation == "relu"
        return _onednn_sum(x, other, conv.weight, conv.bias, *size, relu=relu)


def _convolve(x: Tensor, weight: Tensor, bias: Tensor | None, padding: Any, *size: Any) -> Tensor:
    convolve = F.conv2d if x.ndim == 4 else F.conv3d
    stride, dilation, groups = size
    return convolve(x, weight, bias, stride, padding, dilation, groups)


def _onednn(
    x: Tensor, weight: Tensor, bias: Tensor | None, *size: Any, activation: str = "none"
) -> Tensor:
    """``activation(conv(x))`` by a private operator of PyTorch, which torch.compile uses."""
    call = torch.ops.mkldnn._convolution_pointwise
    return cast(Tensor, call(x, weight, bias, *size, *_ONEDNN[activation], ""))


def _onednn_sum(
    x: Tensor, other: Tensor, weight: Tensor, bias: Tensor | None, *size: Any, relu: bool = False
) -> Tensor:
    """``conv(x) + other`` likewise, and a ReLU of that."""
    call = torch.ops.mkldnn._convolution_pointwise.binary
    unary = "relu" if relu else None
    return cast(Tensor, call(x, other, weight, bias, *size, "add", 1.0, unary, [], None))


def _activate(x: Tensor, activation: str) -> Tensor:
    if activation == "relu":
        return F.relu(x, inplace=True)
    return F.relu6(x, inplace=True) if activation == "relu6" else x


def _runs_onednn(x: Tensor) -> bool:
    if x.device.type != "cpu" or x.dtype not in (torch.float32, torch.bfloat16):
        return False
    return has_onednn_operators(x.dtype)


@functools.cache
def has_onednn_operators(dtype: torch.dtype) -> bool:
    """Whether this PyTorch has the private operators, and they do what they did in PyTorch 2.13."""
    x = torch.linspace(-2, 2, 64).view(1, 4, 4, 4)
    weight = torch.linspace(-8, 8, 144).view(4, 4, 3, 3)
    x, weight = (t.to(dtype, memory_format=torch.channels_last) for t in (x, weight))
    size = ([1, 1], [1, 1], [1, 1], 1)
    expected = _convolve(x, weight, None, *size).float()
    try:
        clipped = _onednn(x, weight, None, *size, activation="relu6").float()
        total = _onednn_sum(x, x, weight, None, *size).float()
    except (AttributeError, NotImplementedError, RuntimeError, TypeError):
        return False
    pairs = ((clipped, expected.clamp(0, 6)), (total, expected + x.float()))
    return all(torch.allclose(found, right, rtol=0.02, atol=1) for found, right in pairs)
