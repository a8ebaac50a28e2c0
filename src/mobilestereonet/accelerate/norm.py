"""Batch norms that take the activation after them along, for training on one NVIDIA GPU."""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import pairwise
from typing import cast

import torch
from torch import Tensor, nn

Limits = tuple[float, float]
"""An activation's least and largest value."""

_LIMITS: dict[type[nn.Module], Limits] = {nn.ReLU: (0.0, math.inf), nn.ReLU6: (0.0, 6.0)}
_NONE: Limits = (-math.inf, math.inf)


class _NormActivation(nn.modules.batchnorm._BatchNorm):
    """A batch norm and the activation after it, see `training.norm_triton`."""

    limits: Limits

    def forward(self, input: Tensor) -> Tensor:
        """(B, C, ...) -> the same shape; in eval mode without gradients."""
        from mobilestereonet.accelerate.norm_triton import TritonNormActivation, norm_activation

        assert self.running_mean is not None and self.running_var is not None
        if not self.training:
            assert not torch.is_grad_enabled()
            statistics = self.running_mean, self.running_var
            return norm_activation(
                input, *statistics, self.weight, self.bias, self.eps, self.limits
            )
        output, mean, variance = TritonNormActivation.apply(  # type: ignore[no-untyped-call]
            input, self.weight, self.bias, self.eps, self.limits
        )
        count = input.numel() // input.shape[1]
        with torch.no_grad():
            assert self.num_batches_tracked is not None and self.momentum is not None
            self.num_batches_tracked += 1
            self.running_mean.lerp_(mean, self.momentum)
            self.running_var.lerp_(variance * (count / max(count - 1, 1)), self.momentum)
        return cast(Tensor, output)


def fuse_activations(net: nn.Module) -> Callable[[], None]:
    """Let batch norms of ``net`` take over the ReLU or ReLU6 that follows them in a sequence.

    What follows becomes the identity; the weights and their names stay as they are. Norms whose
    channels are no multiple of 8 are left alone. Until this is undone the network runs on an
    NVIDIA GPU only, and in eval mode without gradients.

    Returns:
        A function that undoes it.
    """

    def fits(module: nn.Module) -> bool:
        is_norm = isinstance(module, nn.BatchNorm2d | nn.BatchNorm3d)
        return is_norm and cast(nn.BatchNorm2d, module).num_features % 8 == 0

    limits = {module: _NONE for module in net.modules() if fits(module)}
    before: dict[nn.Module, type[nn.Module]] = {norm: type(norm) for norm in limits}
    for sequence in net.modules():
        if isinstance(sequence, nn.Sequential):
            for norm, activation in pairwise(sequence):
                if norm in limits and type(activation) in _LIMITS:
                    limits[norm] = _LIMITS[type(activation)]
                    before[activation] = type(activation)
                    activation.__class__ = nn.Identity
    for norm, its_limits in limits.items():
        norm.__class__ = _NormActivation
        cast(_NormActivation, norm).limits = its_limits

    def undo() -> None:
        for module, kind in before.items():
            module.__class__ = kind

    return undo
