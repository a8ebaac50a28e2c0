"""Depthwise convolutions whose gradients come quickly, and rightly.

oneDNN is fast at the gradients of plain 2D depthwise convolutions only (PyTorch 2.13, channels
last). The others are put together from layers that it does well. On NVIDIA GPUs those in 3D have
kernels of their own, see `training.depthwise_triton`.
"""

from __future__ import annotations

import os
import shutil
from functools import cache
from importlib.util import find_spec
from typing import Any, cast

import torch
import torch.nn.functional as F
from torch import Tensor, nn
from torch.nn.grad import conv2d_weight


@cache
def has_triton() -> bool:
    """Whether Triton's kernels can be built for an NVIDIA GPU.

    PyTorch brings Triton along where it was built for CUDA, on Linux; it needs a C compiler.
    """
    compilers = (os.environ.get("CC", "cc"), "gcc", "clang")
    return (
        find_spec("triton") is not None
        and torch.version.hip is None
        and any(map(shutil.which, compilers))
    )


class DepthwiseConv3d(nn.Conv3d):
    """A 3x3x3 depthwise convolution with padding 1 and stride 1 or 2.

    On a CPU its gradients are a forward pass with the kernel turned around, and 2D depthwise
    convolutions: some forty times faster than oneDNN's.
    """

    def forward(self, input: Tensor) -> Tensor:
        """(B, C, D, H, W) -> (B, C, D / stride, H / stride, W / stride), rounded up."""
        if self.bias is not None:  # of a batch norm that was folded in
            return super().forward(input)
        if input.is_cuda and has_triton() and input.dtype != torch.float64 and not self.groups % 8:
            from mobilestereonet.accelerate.depthwise_triton import TritonDepthwise3d

            if torch.is_autocast_enabled("cuda"):
                input = input.to(torch.get_autocast_dtype("cuda"))
            return cast(Tensor, TritonDepthwise3d.apply(input, self.weight, self.stride[0]))  # type: ignore[no-untyped-call]
        if input.device.type != "cpu" or not torch.is_grad_enabled():
            return super().forward(input)
        return cast(Tensor, _Depthwise.apply(input, self.weight, self.stride[0]))  # type: ignore[no-untyped-call]


class DilatedDepthwiseConv2d(nn.Conv2d):
    """A dilated 3x3 depthwise convolution, padded by its dilation.

    Each of the dilation's interleaved images is convolved on its own, without dilation. oneDNN is
    ten times slower, and its bfloat16 gradient of the weight is uninitialised memory; cuDNN's
    gradient of the weight was slower than without dilation, too.
    """

    def forward(self, input: Tensor) -> Tensor:
        """(B, C, H, W), H and W multiples of the dilation -> the same shape."""
        step = self.dilation[0]
        images = input.permute(0, 2, 3, 1)
        images = images.unflatten(2, (-1, step)).unflatten(1, (-1, step))
        images = images.permute(0, 2, 4, 1, 3, 5)  # (B, step, step, H / step, W / step, C)
        plain = images.flatten(0, 2).permute(0, 3, 1, 2)
        output: Tensor = F.conv2d(plain, self.weight, self.bias, padding=1, groups=self.groups)
        output = output.permute(0, 2, 3, 1).unflatten(0, images.shape[:3])
        output = output.permute(0, 3, 1, 4, 2, 5).flatten(3, 4).flatten(1, 2)
        return output.permute(0, 3, 1, 2)


def speed_up_depthwise(net: nn.Module) -> None:
    """Let such convolutions of ``net`` be the classes above; their weights stay as they are."""
    for module in net.modules():
        if isinstance(module, nn.Conv2d | nn.Conv3d) and module.groups == module.out_channels > 1:
            if isinstance(module, nn.Conv3d):
                module.__class__ = DepthwiseConv3d
            elif module.dilation != (1, 1):
                module.__class__ = DilatedDepthwiseConv2d


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
