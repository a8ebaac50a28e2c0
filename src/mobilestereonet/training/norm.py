"""Batch norms that take the activation after them along, for training on one NVIDIA GPU."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import cast

import torch
from torch import Tensor, nn

_LIMITS: dict[type[nn.Module], tuple[float, float]] = {
    nn.ReLU: (0.0, math.inf),
    nn.ReLU6: (0.0, 6.0),
}


class _NormActivation(nn.modules.batchnorm._BatchNorm):
    """A batch norm and the activation after it, see `training.norm_triton`."""

    limits: tuple[float, float]

    def forward(self, input: Tensor) -> Tensor:
        """(B, C, ...) -> the same shape."""
        from mobilestereonet.training.norm_triton import TritonNormActivation, norm_activation

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


def fuse_activations(net: nn.Module) -> None:
    """Let batch norms of ``net`` take over the ReLU or ReLU6 that follows them in a sequence.

    What follows becomes the identity; the weights and their names stay as they are. Norms whose
    channels are no multiple of 8 are left alone.
    """

    def fits(module: nn.Module) -> bool:
        norm = isinstance(module, nn.BatchNorm2d | nn.BatchNorm3d)
        return norm and cast(nn.BatchNorm2d, module).num_features % 8 == 0

    limits = {module: (-math.inf, math.inf) for module in net.modules() if fits(module)}
    for sequence in net.modules():
        if isinstance(sequence, nn.Sequential):
            for norm, activation in pairwise(sequence):
                if norm in limits and type(activation) in _LIMITS:
                    limits[norm] = _LIMITS[type(activation)]
                    activation.__class__ = nn.Identity
    for norm, its in limits.items():
        norm.__class__ = _NormActivation
        cast(_NormActivation, norm).limits = its
