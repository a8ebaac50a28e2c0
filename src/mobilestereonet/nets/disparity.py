"""From scores at a quarter of the resolution to a disparity at full resolution, in closed form.

The paper upsamples (D, H/4, W/4) scores trilinearly to (4 D, H, W), half-pixel centres, and takes
the expectation of the disparity under their softmax. Between two neighbouring coarse disparities
the upsampled scores are linear in the disparity, so the four fine terms of the interval are a
geometric series: with r = exp(-|difference of the two scores| / 4) and e the largest of the four,

    e, e r, e r^2, e r^3,

from the better score's side. Their sum is e (1 + r)(1 + r^2), and the moments about the interval's
centre have closed forms as well. The two fine bins at either end repeat the outer score. Hence
(D, H, W) is enough, with two exponentials per coarse score instead of four.

An expectation over all disparities lies between foreground and background wherever both are
possible: edges come out blurred. The estimator "mode" takes it over the most likely neighbourhood
alone (the dominant mode of Xu et al., "Adaptive Multi-Modal Cross-Entropy Loss for Stereo
Matching", CVPR 2024; here three intervals, 12 px), where that holds enough of the probability.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Literal, NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor
from torch.autograd.function import once_differentiable

Estimator = Literal["mean", "mode"]

MODE_SHARE = 0.3
"""Probability in the most likely neighbourhood below which "mode" takes the mean over all."""


class _Moments(NamedTuple):
    """Sums over each interval's four terms, before the softmax's division."""

    mass: Tensor  # (B, D - 1, H, W)
    first: Tensor  # moment of the disparity about the interval's centre
    e: Tensor  # the largest term
    r: Tensor  # the ratio of the series
    left_end: Tensor  # (B, H, W), the two bins below the first interval
    right_end: Tensor
    centres: Tensor  # (D - 1, 1, 1)


def _moments(scores: Tensor, estimator: Estimator) -> _Moments:
    low, high = scores[:, :-1], scores[:, 1:]
    rise = high - low
    gap = rise.abs()
    best = torch.maximum(low, high) - gap / 8
    peak = best.amax(dim=1, keepdim=True)
    peak = torch.maximum(peak, torch.maximum(scores[:, :1], scores[:, -1:]))
    e = torch.exp(best - peak)
    r = torch.exp(-gap / 4)
    squares = 1 + r * r
    centres = torch.arange(scores.shape[1] - 1, dtype=scores.dtype, device=scores.device)
    moments = _Moments(
        mass=e * (1 + r) * squares,
        first=e * torch.sign(rise) * (1 - r) * (1.5 * squares + 2 * r),
        e=e,
        r=r,
        left_end=2 * torch.exp(scores[:, 0] - peak[:, 0]),
        right_end=2 * torch.exp(scores[:, -1] - peak[:, 0]),
        centres=(4 * centres + 3.5)[:, None, None],
    )
    return moments if estimator == "mean" else _of_mode(moments)


def _of_mode(m: _Moments) -> _Moments:
    """Without what the estimator "mode" leaves out."""
    keep = mode_mask(m.mass, m.left_end, m.right_end)
    return m._replace(
        mass=m.mass * keep[:, 1:-1],
        first=m.first * keep[:, 1:-1],
        e=m.e * keep[:, 1:-1],
        left_end=m.left_end * keep[:, 0],
        right_end=m.right_end * keep[:, -1],
    )


def mode_mask(mass: Tensor, left_end: Tensor, right_end: Tensor) -> Tensor:
    """What the estimator "mode" looks at: 1 there, 0 elsewhere. Plain operators only.

    Of neighbourhoods that are exactly as likely it looks at all.

    Args:
        mass: Sums over the intervals' fine terms, (B, D - 1, H, W).
        left_end: Sum over the two fine bins before them, (B, H, W).
        right_end: Sum over the two after them, likewise.

    Returns:
        (B, D + 1, H, W): the left end, the intervals, the right end.
    """
    mass = torch.cat((left_end.unsqueeze(1), mass, right_end.unsqueeze(1)), dim=1)
    three = mass[:, :-2] + mass[:, 1:-1] + mass[:, 2:]
    most = three.amax(dim=1, keepdim=True)
    centre = F.pad((three >= most).to(mass.dtype), (0, 0, 0, 0, 2, 2))
    keep = torch.maximum(torch.maximum(centre[:, :-2], centre[:, 1:-1]), centre[:, 2:])
    spread = most < MODE_SHARE * mass.sum(dim=1, keepdim=True)
    return torch.maximum(keep, spread.to(mass.dtype))


def _expectation(m: _Moments, planes: int) -> tuple[Tensor, Tensor]:
    """Expected disparity and the softmax's denominator, each (B, H, W)."""
    total = m.mass.sum(dim=1) + m.left_end + m.right_end
    moment = (m.centres * m.mass + m.first).sum(dim=1)
    ends = 0.5 * m.left_end + (4 * planes - 1.5) * m.right_end
    return (moment + ends) / total, total


def soft_argmax(scores: Tensor, estimator: Estimator = "mean") -> Tensor:
    """Expected disparity of scores whose spatial upsampling is done.

    Equals linear upsampling of the scores by 4 along D (half-pixel centres), a softmax over the
    4 D fine disparities and the expectation over 0 .. 4 D - 1. Plain operators only.

    Args:
        scores: (B, D, H, W), D coarse disparities 0, 4, 8 ... Higher is a better match.
        estimator: "mean" takes the expectation over all disparities, as the paper does; "mode"
            over the most likely neighbourhood.

    Returns:
        Disparity (B, H, W) in pixels.
    """
    return _expectation(_moments(scores, estimator), scores.shape[1])[0]


class _SoftArgmax(torch.autograd.Function):
    """`soft_argmax` and its derivative in closed form, row by row: what training needs.

    The temporaries of some rows stay in the processor's cache, and both come from the same ones:
    several times faster on a CPU than autograd through `soft_argmax`.
    """

    @staticmethod
    def forward(ctx: Any, scores: Tensor, estimator: Estimator) -> Tensor:
        disparity = torch.empty_like(scores[:, 0])
        derivative = torch.empty_like(scores)
        step = _cached_rows(scores)
        blocks = zip(
            scores.split(step, 2), disparity.split(step, 1), derivative.split(step, 2), strict=True
        )
        for rows, *targets in blocks:
            _soft_argmax_and_derivative(rows, estimator, *targets)
        ctx.save_for_backward(derivative)
        return disparity

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor, None]:
        (derivative,) = ctx.saved_tensors
        return derivative * grads[0].unsqueeze(1), None


def _soft_argmax_and_derivative(
    scores: Tensor, estimator: Estimator, disparity: Tensor, derivative: Tensor
) -> None:
    """Fill in the disparity (B, H, W), and what each score (B, D, H, W) changes of it."""
    m = _moments(scores, estimator)
    found, total = _expectation(m, scores.shape[1])
    disparity.copy_(found)
    scale = 0.5 / total.unsqueeze(1)
    offset = m.centres - found.unsqueeze(1)
    # A fine term at o from its interval's centre weighs the two scores 1/2 -+ o/4.
    even = torch.addcmul(m.first, offset, m.mass).mul_(scale)
    second = torch.addcmul(2.25 * m.mass, m.e * m.r, 1 + m.r, value=-2)
    odd = second.addcmul_(offset, m.first).mul_(scale / 2)
    ends = 2 * scale[:, 0]
    torch.sub(even, odd, out=derivative[:, :-1])
    derivative[:, -1] = ends * (4 * scores.shape[1] - 1.5 - found) * m.right_end
    derivative[:, 1:] += even.add_(odd)
    derivative[:, 0] += ends * (0.5 - found) * m.left_end


_CACHED = 1 << 17
"""Elements of a temporary that stays in the cache."""


def _cached_rows(scores: Tensor) -> int:
    if scores.is_cuda:
        return scores.shape[2]
    return max(1, _CACHED // (scores.shape[1] * scores.shape[3]))


def regress_disparity(scores: Tensor, estimator: Estimator = "mean") -> Tensor:
    """Disparity at full resolution from scores at a quarter of it.

    Args:
        scores: (B, D, H / 4, W / 4). Reduced precision is raised to float32 first.
        estimator: See `soft_argmax`.

    Returns:
        Disparity (B, H, W) in pixels, 0 <= d <= 4 D - 1.
    """
    if scores.dtype in (torch.float16, torch.bfloat16):
        scores = scores.float()
    # One graph for all sizes, which the engine divides itself; and on a GPU few large kernels.
    if torch.compiler.is_compiling() or (scores.is_cuda and not scores.requires_grad):
        return soft_argmax(_upsample(scores), estimator)
    if scores.requires_grad:
        fine = _upsample(scores)
        disparity: Tensor = _SoftArgmax.apply(fine, estimator)  # type: ignore[no-untyped-call]
        return disparity
    return torch.cat(list(_disparity_by_rows(scores, estimator)), dim=1)


def _upsample(scores: Tensor) -> Tensor:
    return F.interpolate(scores, scale_factor=4, mode="bilinear", align_corners=False)


def _disparity_by_rows(scores: Tensor, estimator: Estimator, step: int = 4) -> Iterator[Tensor]:
    """Disparity of some rows at a time, so that not even the upsampled scores exist as a whole."""
    height = scores.shape[2]
    for top in range(0, height, step):
        bottom = min(top + step, height)
        # The row above and the one below are what the interpolation also looks at.
        first = max(top - 1, 0)
        fine = _upsample(scores[:, :, first : bottom + 1])
        fine = fine[:, :, 4 * (top - first) : 4 * (bottom - first)]
        for rows in fine.split(_cached_rows(fine), dim=2):
            yield soft_argmax(rows, estimator)
