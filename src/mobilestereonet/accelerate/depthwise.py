"""Depthwise convolutions with fast gradients.

oneDNN is fast at the gradients of plain 2D depthwise convolutions only (PyTorch 2.13, channels
last). The others are put together from layers that it does well. On NVIDIA GPUs those in 3D have
kernels of their own, see `accelerate.depthwise_triton`. See also ``docs/how-it-works.md``, "Exact
accelerations".
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

from mobilestereonet.accelerate.layout import channels_last, empty_channels_last
from mobilestereonet.accelerate.modules import replace_modules


@cache
def has_triton() -> bool:
    """Whether Triton's kernels can be built for an NVIDIA GPU.

    PyTorch brings Triton along where it was built for CUDA, on Linux; it needs a C compiler, and a
    GPU of compute capability 7.0 or above.
    """
    compilers = (os.environ.get("CC", "cc"), "gcc", "clang")
    return (
        find_spec("triton") is not None
        and torch.version.hip is None
        and any(map(shutil.which, compilers))
        and (not torch.cuda.is_available() or torch.cuda.get_device_capability() >= (7, 0))
    )


def fast_depthwise(net: nn.Module) -> None:
    """Replace 3x3x3 and dilated 3x3 depthwise convolutions without bias, in place.

    The replacements share the weights, under the same names.
    """
    replace_modules(net, (nn.Conv2d, nn.Conv3d), _fast)


def _fast(conv: nn.Conv2d | nn.Conv3d) -> nn.Module:
    depthwise = conv.groups == conv.in_channels == conv.out_channels > 1 and conv.bias is None
    if not depthwise or set(conv.kernel_size) != {3} or conv.padding_mode != "zeros":
        return conv
    if isinstance(conv, nn.Conv3d):
        plain = set(conv.dilation) == set(conv.padding) == {1} and len(set(conv.stride)) == 1
        return DepthwiseConv3d(conv) if plain else conv
    (step,) = set(conv.dilation) if len(set(conv.dilation)) == 1 else (1,)
    fits = step > 1 and set(conv.padding) == {step} and set(conv.stride) == {1}
    return DilatedDepthwiseConv2d(conv) if fits else conv


class DepthwiseConv3d(nn.Module):
    """A 3x3x3 depthwise convolution with padding 1, with the weight of another.

    On a CPU its gradients are a forward pass with the kernel turned around, and 2D depthwise
    convolutions: some forty times faster than oneDNN's.
    """

    def __init__(self, conv: nn.Conv3d) -> None:
        super().__init__()
        self.weight = conv.weight
        self.stride = conv.stride[0]

    def forward(self, x: Tensor) -> Tensor:
        """(B, C, D, H, W) -> (B, C, D / stride, H / stride, W / stride), rounded up."""
        weight, channels = self.weight, x.shape[1]
        if torch.is_autocast_enabled(x.device.type) and x.dtype != torch.float64:
            x = x.to(torch.get_autocast_dtype(x.device.type))
        if x.is_cuda and has_triton() and x.dtype != torch.float64 and channels % 8 == 0:
            return cast(Tensor, depthwise_conv3d(x, weight, self.stride))
        weight = weight.to(x.dtype)
        if x.device.type == "cpu" and torch.is_grad_enabled():
            return cast(Tensor, depthwise_conv3d(x, weight, self.stride))
        return F.conv3d(x, weight, stride=self.stride, padding=1, groups=channels)


class DilatedDepthwiseConv2d(nn.Module):
    """A dilated 3x3 depthwise convolution, padded by its dilation, with the weight of another.

    Each of the dilation's interleaved images is convolved on its own, without dilation. oneDNN is
    ten times slower, and its bfloat16 gradient of the weight is uninitialised memory; cuDNN's
    gradient of the weight was slower than without dilation, too.
    """

    def __init__(self, conv: nn.Conv2d) -> None:
        super().__init__()
        self.weight = conv.weight
        self.dilation = conv.dilation[0]

    def forward(self, x: Tensor) -> Tensor:
        """(B, C, H, W) -> the same shape."""
        step = self.dilation
        if x.shape[2] % step or x.shape[3] % step:
            return F.conv2d(x, self.weight, padding=step, dilation=step, groups=x.shape[1])
        images = x.permute(0, 2, 3, 1)
        images = images.unflatten(2, (-1, step)).unflatten(1, (-1, step))
        images = images.permute(0, 2, 4, 1, 3, 5)  # (B, step, step, H / step, W / step, C)
        plain = images.flatten(0, 2).permute(0, 3, 1, 2)
        output: Tensor = F.conv2d(plain, self.weight, padding=1, groups=x.shape[1])
        output = output.permute(0, 2, 3, 1).unflatten(0, images.shape[:3])
        output = output.permute(0, 3, 1, 4, 2, 5).flatten(3, 4).flatten(1, 2)
        return output.permute(0, 3, 1, 2)


@torch.library.custom_op("mobilestereonet::depthwise_conv3d", mutates_args=())
def depthwise_conv3d(x: Tensor, weight: Tensor, stride: int) -> Tensor:
    """3x3x3 depthwise convolution, padding 1.

    Args:
        x: Volume (B, C, D, H, W).
        weight: Kernels (C, 1, 3, 3, 3); on a CPU in the volume's type, on a GPU in any.
        stride: Stride along all three axes.

    Returns:
        (B, C, D / stride, H / stride, W / stride), rounded up, in channels last.
    """
    if x.is_cuda:
        from mobilestereonet.accelerate.depthwise_triton import convolve

        with torch.cuda.device(x.device):
            return convolve(x, weight, stride)
    y = F.conv3d(x, weight, stride=stride, padding=1, groups=x.shape[1])
    return channels_last(y)


@depthwise_conv3d.register_fake
def _(x: Tensor, weight: Tensor, stride: int) -> Tensor:
    size = [-(-side // stride) for side in x.shape[2:]]
    return empty_channels_last(x, (*x.shape[:2], *size))


@torch.library.custom_op("mobilestereonet::depthwise_conv3d_backward", mutates_args=())
def _depthwise_backward(
    grad: Tensor, x: Tensor, weight: Tensor, stride: int
) -> tuple[Tensor, Tensor]:
    if x.is_cuda:
        from mobilestereonet.accelerate.depthwise_triton import convolve_backward

        with torch.cuda.device(x.device):
            return convolve_backward(grad, x, weight, stride)
    grad = channels_last(grad)
    grad_x = _input_gradient(grad, weight, x.shape, stride)
    return channels_last(grad_x), _weight_gradient(grad, x, stride).contiguous()


@_depthwise_backward.register_fake
def _(grad: Tensor, x: Tensor, weight: Tensor, stride: int) -> tuple[Tensor, Tensor]:
    return empty_channels_last(x, x.shape), weight.new_empty(weight.shape)


def _keep_inputs(ctx: Any, inputs: tuple[Any, ...], output: Tensor) -> None:
    x, weight, ctx.stride = inputs
    ctx.save_for_backward(x, weight)


def _gradient(ctx: Any, grad: Tensor) -> tuple[Tensor, Tensor, None]:
    return *_depthwise_backward(grad, *ctx.saved_tensors, ctx.stride), None


depthwise_conv3d.register_autograd(_gradient, setup_context=_keep_inputs)


def _input_gradient(grad: Tensor, weight: Tensor, shape: torch.Size, stride: int) -> Tensor:
    """A convolution of the gradient, zeros in place of the positions that the stride skips."""
    if stride > 1:
        spread = torch.zeros(shape, dtype=grad.dtype, device=grad.device)
        spread = channels_last(spread)
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
