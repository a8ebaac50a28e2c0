"""Depthwise 3D convolutions whose gradient a CPU computes quickly."""

from __future__ import annotations

from typing import Any, cast

import torch
import torch.nn.functional as F
from torch import Tensor, nn
from torch.nn.grad import conv2d_weight


class DepthwiseConv3d(nn.Conv3d):
    """A 3x3x3 depthwise convolution with padding 1 and stride 1 or 2, without bias.

    oneDNN's gradients of it are some forty times slower than its forward pass, channels last
    (PyTorch 2.13). On a CPU they are computed by layers that it does well: a forward pass with the
    kernel turned around, and 2D depthwise convolutions.
    """

    def forward(self, input: Tensor) -> Tensor:
        """(B, C, D, H, W) -> (B, C, D / stride, H / stride, W / stride), rounded up."""
        if input.device.type != "cpu" or not torch.is_grad_enabled():
            return super().forward(input)
        return cast(Tensor, _Depthwise.apply(input, self.weight, self.stride[0]))  # type: ignore[no-untyped-call]


def speed_up_depthwise(net: nn.Module) -> None:
    """Let the depthwise 3D convolutions of ``net`` be `DepthwiseConv3d`; weights stay theirs."""
    for module in net.modules():
        if isinstance(module, nn.Conv3d) and module.groups == module.out_channels > 1:
            module.__class__ = DepthwiseConv3d


class _Depthwise(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, x: Tensor, weight: Tensor, stride: int) -> Tensor:
        ctx.save_for_backward(x, weight)
        ctx.stride = stride
        return F.conv3d(x, weight, stride=stride, padding=1, groups=x.shape[1])

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor, Tensor, None]:
        x, weight = ctx.saved_tensors
        grad = grads[0].contiguous(memory_format=torch.channels_last_3d)
        grad_x = _input_gradient(grad, weight.to(grad.dtype), x.shape, ctx.stride)
        grad_weight = _weight_gradient(grad, x.to(grad.dtype), ctx.stride)
        return grad_x.to(x.dtype), grad_weight.to(weight.dtype), None


def _input_gradient(grad: Tensor, weight: Tensor, shape: torch.Size, stride: int) -> Tensor:
    """A convolution of the gradient, zeros in place of the positions that the stride skips."""
    if stride > 1:
        spread = torch.zeros(shape, dtype=grad.dtype, device=grad.device)
        spread = spread.contiguous(memory_format=torch.channels_last_3d)
        spread[:, :, ::stride, ::stride, ::stride] = grad
        grad = spread
    return F.conv3d(grad, weight.flip(2, 3, 4), padding=1, groups=grad.shape[1])


def _weight_gradient(grad: Tensor, x: Tensor, stride: int) -> Tensor:
    """Each of the kernel's three layers is the kernel of a 2D convolution of all planes."""
    channels, depth = grad.shape[1:3]
    planes = _planes(grad)
    x = F.pad(x, (0, 0, 0, 0, 1, 1))
    layers = [
        conv2d_weight(
            _planes(x[:, :, layer : layer + stride * (depth - 1) + 1 : stride]),
            (channels, 1, 3, 3),
            planes,
            stride=stride,
            padding=1,
            groups=channels,
        )
        for layer in range(3)
    ]
    return torch.stack(layers, dim=2)


def _planes(volume: Tensor) -> Tensor:
    """(B, C, D, H, W) -> (B D, C, H, W), channels last."""
    return volume.permute(0, 2, 3, 4, 1).flatten(0, 1).permute(0, 3, 1, 2)
