"""The optimizer Muon for convolutions."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Iterable
from typing import Any

import torch
from torch import Tensor, nn

MOMENTUM = 0.95
_RMS = 0.2
"""Root mean square of an update of a matrix at learning rate 1: about that of Adam's."""


class Muon(torch.optim.Adam):
    """Muon for kernels that mix channels, Adam for depthwise kernels, norms and biases.

    Muon (Jordan et al., 2024) moves a matrix by its momentum, made orthogonal: all directions are
    learnt at one pace, not the few strong ones first. A kernel is a matrix with one row per entry
    of its first dimension. Updates are scaled to those of Adam (Liu et al., 2025), so that both
    groups share one learning rate. (PyTorch's own Muon takes parameters of two dimensions only.)

    Args:
        parameters: Parameters of a network.
        lr: Learning rate.
    """

    def __init__(self, parameters: Iterable[nn.Parameter], lr: float) -> None:
        groups: dict[bool, list[nn.Parameter]] = {False: [], True: []}
        for parameter in parameters:
            groups[parameter.ndim > 1 and min(parameter.shape[:2]) > 1].append(parameter)
        super().__init__([{"params": groups[False]}, {"params": groups[True]}], lr=lr)

    @torch.no_grad()
    def step(self, closure: Callable[[], Any] | None = None) -> Any:
        """Take one step; parameters without a gradient stay as they are."""
        loss = None
        if closure is not None:
            with torch.enable_grad():
                loss = closure()
        kernels = self.param_groups[1]
        # Those of one shape go together: a GPU spends no time on many small products.
        moves: dict[torch.Size, list[tuple[nn.Parameter, Tensor]]] = defaultdict(list)
        for kernel in kernels["params"]:
            if kernel.grad is None:
                continue
            state = self.state[kernel]
            if not state:
                # The names are Adam's, whose checkpoints have both.
                state["step"], state["exp_avg"] = torch.zeros(()), torch.zeros_like(kernel)
            state["step"] += 1
            average = state["exp_avg"].lerp_(kernel.grad, 1 - MOMENTUM)
            matrix = kernel.grad.lerp(average, MOMENTUM).flatten(1)
            moves[matrix.shape].append((kernel, matrix))
            kernel.grad = None  # for Adam
        for shape, alike in moves.items():
            scale = _RMS * math.sqrt(max(shape))
            matrices = orthogonal(torch.stack([matrix for _, matrix in alike]))
            for (kernel, _), matrix in zip(alike, matrices, strict=True):
                kernel.sub_(matrix.reshape(kernel.shape), alpha=kernels["lr"] * scale)
        super().step()
        return loss


def orthogonal(matrices: Tensor) -> Tensor:
    """The nearest matrices with orthonormal rows or columns, roughly: singular values about 1.

    Five steps of Jordan's quintic Newton-Schulz iteration, which leaves them in 0.7 .. 1.2.

    Args:
        matrices: (..., M, N); zeros stay zeros.
    """
    tall = matrices.shape[-2] > matrices.shape[-1]
    wide = matrices.mT if tall else matrices
    x: Tensor = (wide / wide.norm(dim=(-2, -1), keepdim=True).clamp_min(1e-12)).bfloat16()
    for _ in range(5):
        gram = x @ x.mT
        x = 3.4445 * x + (-4.775 * gram + 2.0315 * gram @ gram) @ x
    return (x.mT if tall else x).to(matrices.dtype)
