"""Convolution, v1 and v2 blocks, in 2D and 3D through one code path (Sec. 3.1, Fig. 2).

v1: MobileNets (Howard et al., 2017); v2: MobileNetV2 (Sandler et al., CVPR 2018).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, Literal, cast

from torch import Tensor, nn

Block = Literal["conv", "v1", "v2"]
"""Standard convolution, MobileNet-V1 block, MobileNet-V2 block."""

CONV: dict[int, Any] = {2: nn.Conv2d, 3: nn.Conv3d}
_TRANSPOSED: dict[int, Any] = {2: nn.ConvTranspose2d, 3: nn.ConvTranspose3d}
_NORM: dict[int, Any] = {2: nn.BatchNorm2d, 3: nn.BatchNorm3d}


def conv_norm(
    dims: int,
    inputs: int,
    outputs: int,
    *,
    kernel: int = 3,
    stride: int | tuple[int, ...] = 1,
    dilation: int = 1,
    groups: int = 1,
    bias: bool = False,
    activation: Callable[..., nn.Module] | None = nn.ReLU,
) -> nn.Sequential:
    """Convolution, without bias by default, batch norm and, unless None, an activation.

    The padding keeps the size at stride 1. Takes and gives (B, C, H, W) or (B, C, D, H, W).
    """
    layers: list[nn.Module] = [
        CONV[dims](
            inputs,
            outputs,
            kernel,
            stride=stride,
            padding=dilation * (kernel // 2),
            dilation=dilation,
            groups=groups,
            bias=bias,
        ),
        _NORM[dims](outputs),
    ]
    if activation is not None:
        layers.append(activation(inplace=True))
    return nn.Sequential(*layers)


def transposed_norm(
    dims: int,
    inputs: int,
    outputs: int,
    *,
    stride: int | tuple[int, ...] = 2,
    bias: bool = False,
) -> nn.Sequential:
    """3x3(x3) transposed convolution and batch norm: multiplies the size by the stride, 1 or 2."""
    layer = _TRANSPOSED[dims](inputs, outputs, 3, stride=stride, padding=1, bias=bias)
    layer.output_padding = tuple(step - 1 for step in layer.stride)
    return nn.Sequential(layer, _NORM[dims](outputs))


def depthwise_norm(dims: int, channels: int, *, stride: int, dilation: int) -> nn.Sequential:
    """Depthwise 3x3(x3) convolution with batch norm and ReLU6, see `conv_norm`."""
    return conv_norm(
        dims,
        channels,
        channels,
        stride=stride,
        dilation=dilation,
        groups=channels,
        activation=nn.ReLU6,
    )


def v1_block(
    dims: int,
    inputs: int,
    outputs: int,
    *,
    stride: int = 1,
    dilation: int = 1,
    last_activation: bool = True,
) -> nn.Sequential:
    """MobileNet-V1 block: depthwise 3x3(x3), then pointwise, each with batch norm and ReLU6."""
    last = nn.ReLU6 if last_activation else None
    return nn.Sequential(
        *depthwise_norm(dims, inputs, stride=stride, dilation=dilation),
        *conv_norm(dims, inputs, outputs, kernel=1, activation=last),
    )


class V2Block(nn.Module):
    """MobileNet-V2 block: expand by ``expansion``, depthwise 3x3(x3), project linearly.

    Adds its input when ``skip`` is set, the stride is 1 and the channels stay the same.
    """

    def __init__(
        self,
        dims: int,
        inputs: int,
        outputs: int,
        *,
        expansion: int,
        stride: int = 1,
        dilation: int = 1,
        skip: bool = True,
    ) -> None:
        super().__init__()
        hidden = expansion * inputs
        self.skip = skip and stride == 1 and inputs == outputs
        self.conv = nn.Sequential(
            *conv_norm(dims, inputs, hidden, kernel=1, activation=nn.ReLU6),
            *depthwise_norm(dims, hidden, stride=stride, dilation=dilation),
            *conv_norm(dims, hidden, outputs, kernel=1, activation=None),
        )

    def forward(self, x: Tensor) -> Tensor:
        """(B, inputs, ...) -> (B, outputs, ...), spatial sizes divided by the stride."""
        y = cast(Tensor, self.conv(x))
        return x + y if self.skip else y


def initialise(network: nn.Module) -> None:
    """Set fresh weights as the authors' release does.

    Convolutions start from a normal of standard deviation sqrt(2 / (kernel volume x out
    channels)); transposed convolutions, biases and norms keep PyTorch's defaults.
    """
    for module in network.modules():
        if isinstance(module, nn.Conv2d | nn.Conv3d):
            fan_out = math.prod(module.kernel_size) * module.out_channels
            nn.init.normal_(module.weight, 0.0, math.sqrt(2.0 / fan_out))
