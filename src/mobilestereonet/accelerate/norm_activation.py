"""Fused batch norm and activation, for training on one NVIDIA GPU.

PyTorch runs the activation by itself, and reads and writes everything once more for it. See
``docs/how-it-works.md``, "Exact accelerations".
"""

from __future__ import annotations

import math
from contextlib import AbstractContextManager, nullcontext
from itertools import pairwise
from typing import Any, cast

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from mobilestereonet.accelerate.layout import empty_channels_last
from mobilestereonet.accelerate.modules import is_plain

_LIMITS: dict[type[nn.Module], tuple[float, float]] = {
    nn.ReLU: (0.0, math.inf),
    nn.ReLU6: (0.0, 6.0),
}
"""Activations by their least and largest value."""

_NONE = (-math.inf, math.inf)


def fuse_activations(net: nn.Module) -> None:
    """Let batch norms take over the ReLU or ReLU6 that follows them in a sequence, in place.

    Each becomes a `NormActivation` with its parameters and statistics under the same names, and
    the activation the identity. Norms whose channels are no multiple of 8 are left alone, as are
    synchronised ones.
    """
    module: Any
    for module in list(net.modules()):
        if is_plain(module, nn.Sequential):
            for index, (norm, activation) in enumerate(pairwise(list(module))):
                if _fits(norm) and is_plain(activation, tuple(_LIMITS)):
                    module[index] = NormActivation(norm, _LIMITS[type(activation)])
                    module[index + 1] = nn.Identity()
        for name, child in module.named_children():
            if _fits(child):
                setattr(module, name, NormActivation(child, _NONE))


def _fits(module: Any) -> bool:
    return (
        is_plain(module, (nn.BatchNorm2d, nn.BatchNorm3d))
        and module.num_features % 8 == 0
        and module.affine
        and module.track_running_stats
        and module.momentum is not None
    )


class NormActivation(nn.Module):
    """A batch norm, with the parameters and statistics of another, and the activation after it.

    By Triton kernels on an NVIDIA GPU; in eval mode with gradients, as where a norm is frozen for
    fine-tuning, by PyTorch.
    """

    running_mean: Tensor
    running_var: Tensor
    num_batches_tracked: Tensor

    def __init__(self, norm: Any, limits: tuple[float, float]) -> None:
        super().__init__()
        self.weight, self.bias = norm.weight, norm.bias
        for name in ("running_mean", "running_var", "num_batches_tracked"):
            self.register_buffer(name, getattr(norm, name))
        self.eps, self.momentum, self.limits = norm.eps, norm.momentum, limits
        self.training = norm.training

    def forward(self, x: Tensor) -> Tensor:
        """(B, C, ...) -> the same shape."""
        if not self.training:
            statistics = self.running_mean, self.running_var
            if torch.is_grad_enabled():
                y = F.batch_norm(x, *statistics, self.weight, self.bias, eps=self.eps)
                return y.clamp(*self.limits)
            _, scale, shift = _maps(*statistics, self.weight, self.bias, self.eps)
            return _run_norm_activation(x, scale, shift, *self.limits)
        output, mean, variance = batch_norm_activation(
            x, self.weight, self.bias, self.eps, *self.limits
        )
        count = x.numel() // x.shape[1]
        with torch.no_grad():
            self.num_batches_tracked += 1
            self.running_mean.lerp_(mean, self.momentum)
            self.running_var.lerp_(variance * (count / max(count - 1, 1)), self.momentum)
        return cast(Tensor, output)


def _maps(
    mean: Tensor, variance: Tensor, weight: Tensor, bias: Tensor, eps: float
) -> tuple[Tensor, Tensor, Tensor]:
    """Inverse standard deviation, and scale and shift of the norm as an affine map; (C,) each."""
    inverse = (variance + eps).rsqrt()
    scale = weight * inverse
    return inverse, scale, bias - mean * scale


def _run_norm_activation(
    x: Tensor, scale: Tensor, shift: Tensor, low: float, high: float
) -> Tensor:
    from mobilestereonet.accelerate.norm_triton import norm_activation

    with _device_of(x):
        return norm_activation(x, scale, shift, (low, high))


def _device_of(x: Tensor) -> AbstractContextManager[Any]:
    """Triton runs on the current device: that of ``x``."""
    return torch.cuda.device(x.device) if x.is_cuda else nullcontext()


@torch.library.custom_op("mobilestereonet::batch_norm_activation", mutates_args=())
def batch_norm_activation(
    x: Tensor, weight: Tensor, bias: Tensor, eps: float, low: float, high: float
) -> tuple[Tensor, Tensor, Tensor]:
    """Batch norm by the batch's own statistics, and activation, by Triton kernels.

    Statistics are taken in float32; the result has the type of ``x``.

    Args:
        x: (B, C, ...), C a multiple of 8.
        weight: (C,).
        bias: (C,).
        eps: Added to the variance.
        low: Least value of the activation.
        high: Largest value of the activation.

    Returns:
        The result, of the shape of ``x``, the mean (C,) and the biased variance (C,).
    """
    from mobilestereonet.accelerate.norm_triton import batch_statistics

    with _device_of(x):
        mean, variance = batch_statistics(x)
    _, scale, shift = _maps(mean, variance, weight, bias, eps)
    return _run_norm_activation(x, scale, shift, low, high), mean, variance


@batch_norm_activation.register_fake
def _(
    x: Tensor, weight: Tensor, bias: Tensor, eps: float, low: float, high: float
) -> tuple[Tensor, Tensor, Tensor]:
    return empty_channels_last(x, x.shape), torch.empty_like(weight), torch.empty_like(weight)


@torch.library.custom_op("mobilestereonet::batch_norm_activation_backward", mutates_args=())
def _backward(
    grad: Tensor,
    x: Tensor,
    mean: Tensor,
    variance: Tensor,
    weight: Tensor,
    bias: Tensor,
    eps: float,
    low: float,
    high: float,
) -> tuple[Tensor, Tensor, Tensor]:
    from mobilestereonet.accelerate.norm_triton import norm_activation_backward

    inverse, scale, shift = _maps(mean, variance, weight, bias, eps)
    with _device_of(x):
        return norm_activation_backward(grad, x, mean, inverse, (scale, shift), (low, high))


@_backward.register_fake
def _(
    grad: Tensor,
    x: Tensor,
    mean: Tensor,
    variance: Tensor,
    weight: Tensor,
    bias: Tensor,
    eps: float,
    low: float,
    high: float,
) -> tuple[Tensor, Tensor, Tensor]:
    return empty_channels_last(x, x.shape), torch.empty_like(weight), torch.empty_like(bias)


def _keep(ctx: Any, inputs: tuple[Any, ...], output: tuple[Tensor, Tensor, Tensor]) -> None:
    x, weight, bias, *ctx.numbers = inputs
    ctx.mark_non_differentiable(*output[1:])
    ctx.save_for_backward(x, *output[1:], weight, bias)


def _gradient(ctx: Any, grad: Tensor, *_: Tensor) -> tuple[Tensor | None, ...]:
    return *_backward(grad, *ctx.saved_tensors, *ctx.numbers), None, None, None


batch_norm_activation.register_autograd(_gradient, setup_context=_keep)
