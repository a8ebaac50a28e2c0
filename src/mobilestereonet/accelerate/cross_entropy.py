"""Cross entropy over all disparities in closed form, from scores at a quarter of the resolution.

With p the softmax of scores that are upsampled linearly from D planes to 4 D disparities, and q the
distribution that is wanted of the disparities,

    -sum_d q(d) log p(d) = log Z - sum_k Q(k) s(k),    Q(k) = sum_d q(d) hat_k(d),

where s(k) is the score of plane k, hat_k(d) its share in the upsampled score of disparity d, and Z
the softmax's denominator, whose terms between two planes are a geometric series (see
`accelerate.soft_argmax`). The derivative to s(k) is P(k) - Q(k), P being to p what Q is to q. So
where the loss is lowest p and q agree in all P(k), and hence in their means: the shares' mean
sum_k (4 k + 1.5) hat_k(d) is d.
"""

from __future__ import annotations

from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor

from mobilestereonet.accelerate.soft_argmax import SCALE, cached_rows, intervals, keep_derivative

LAPLACE_PX = 0.8
"""Scale of the Laplacian around a disparity, in px: that of Xu et al. (CVPR 2024)."""


def disparity_cross_entropy(scores: Tensor, centres: Tensor, shares: Tensor) -> Tensor:
    """Cross entropy of scores against Laplacians around some disparities.

    The Laplacian of a disparity between two whole ones mixes those of the two, so that its mean
    is that disparity to any fraction (but near the ends of the range).

    Args:
        scores: (B, D, H, W) float32 or float64, planes at the disparities 1.5, 5.5, 9.5 ...; their
            upsampling in height and width is done, or not wanted.
        centres: Disparities in 0 .. 4 D - 1, in px, (B, M, H, W).
        shares: Share of each of these, (B, M, H, W), with a sum of 1, or 0 where a pixel does not
            count.

    Returns:
        (B, H, W), 0 where a pixel does not count.
    """
    loss: Tensor = _cross_entropy(scores, centres, shares)[0]
    return loss


def laplacians(planes: int, like: Tensor) -> Tensor:
    """Q of the Laplacian around each whole disparity, (D, 4 D), in the type and on the device."""
    identity = torch.eye(planes, dtype=like.dtype, device=like.device)
    hats = F.interpolate(identity[None], scale_factor=float(SCALE), mode="linear")[0]
    disparity = torch.arange(SCALE * planes, dtype=like.dtype, device=like.device)
    distance = (disparity[:, None] - disparity).abs()
    return hats @ (-distance / LAPLACE_PX).softmax(dim=0)


@torch.library.custom_op("mobilestereonet::disparity_cross_entropy", mutates_args=())
def _cross_entropy(scores: Tensor, centres: Tensor, shares: Tensor) -> tuple[Tensor, Tensor]:
    """The loss and its derivative, row by row; see `accelerate.soft_argmax`."""
    loss, derivative = torch.empty_like(scores[:, 0]), torch.empty_like(scores)
    table = laplacians(scores.shape[1], scores)
    step = cached_rows(scores)
    blocks = zip(
        *(map_.split(step, 2) for map_ in (scores, centres, shares, derivative)),
        loss.split(step, 1),
        strict=True,
    )
    for rows, where, share, slopes, values in blocks:
        _loss_and_derivative(rows, _wanted(where, share, table), share.sum(dim=1), values, slopes)
    return loss, derivative


@_cross_entropy.register_fake
def _(scores: Tensor, centres: Tensor, shares: Tensor) -> tuple[Tensor, Tensor]:
    return torch.empty_like(scores[:, 0]), torch.empty_like(scores)


def _backward(ctx: Any, grad: Tensor, _: Tensor) -> tuple[Tensor, None, None]:
    if torch.is_grad_enabled():
        raise RuntimeError("the cross entropy in closed form has no second derivative")
    (derivative,) = ctx.saved_tensors
    return derivative * grad.unsqueeze(1), None, None


_cross_entropy.register_autograd(_backward, setup_context=keep_derivative)


def _loss_and_derivative(
    scores: Tensor, wanted: Tensor, counted: Tensor, loss: Tensor, derivative: Tensor
) -> None:
    """Fill in the loss (B, H, W), and what each score (B, D, H, W) changes of it."""
    m = intervals(scores)
    total = m.total
    torch.sub(counted * (total.log() + m.peak), (wanted * scores).sum(dim=1), out=loss)
    # A fine term at o px from its interval's centre weighs the two planes 1/2 -+ o/4.
    even, odd = m.mass / 2, m.first / SCALE
    torch.sub(even, odd, out=derivative[:, :-1])
    derivative[:, -1] = m.above
    derivative[:, 1:] += even.add_(odd)
    derivative[:, 0] += m.below
    derivative.mul_((counted / total).unsqueeze(1)).sub_(wanted)


def _wanted(centres: Tensor, shares: Tensor, table: Tensor) -> Tensor:
    """Q of Laplacians around disparities (B, M, H, W), weighed and summed up: (B, D, H, W)."""
    below = centres.floor().clamp(0, table.shape[1] - 1)
    upper = shares * (centres - below)
    total = torch.zeros((), dtype=table.dtype, device=table.device)
    for index, weight in ((below, shares - upper), (below + 1, upper)):
        columns = index.long().clamp(max=table.shape[1] - 1)
        total = total + (table[:, columns] * weight).sum(dim=2)  # (D, B, H, W)
    return total.movedim(0, 1)
