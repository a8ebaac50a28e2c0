"""Soft-argmax in closed form, from scores at a quarter of the resolution.

`nets.soft_argmax.SoftArgmax` upsamples scores (D, H, W) by 4 to (4 D, 4 H, 4 W) and takes the
expectation under their softmax. Between two neighbouring planes the upsampled scores are linear in
the disparity, so that the four fine terms between them are a geometric series: with
r = exp(-|difference of the two scores| / 4) and e the largest of the four,

    e, e r, e r^2, e r^3,

from the better score's side, at 1.5, 0.5, 0.5 and 1.5 px from the interval's centre. Their sum and
moments have closed forms, and the two fine terms at either end of the range repeat the outer
plane's. Hence (D, 4 H, 4 W) is enough, with two exponentials per plane instead of four. Drawing and
worked example: ``docs/how-it-works.md``, "The head".
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from typing import Any, NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from mobilestereonet.accelerate.modules import replace_modules
from mobilestereonet.errors import InputError
from mobilestereonet.nets.soft_argmax import (
    CONFIDENCE_RADIUS_PX,
    MIN_MODE_PROBABILITY,
    Estimator,
    SoftArgmax,
    dominant_mode,
)

SCALE = 4
"""The upsampling for which the closed form is written."""

_MARGIN = 7.0
"""Logarithm of how far the smallest exponential stays above what a type underflows at."""

_CACHED_ELEMENTS = 1 << 17
"""Elements of a temporary that stays in the processor's cache."""

_TILE = (4, 64)
"""Rows and columns of scores that are upsampled at a time."""

_KEPT = 2
"""Planes of a flat end that stay: the neighbourhoods that reach into it from inside need them."""


class ClosedFormSoftArgmax(SoftArgmax):
    """`SoftArgmax` with a scale of 4 and half-pixel centres, in closed form.

    Args:
        regression: What it replaces.
        in_tiles: Work on small tiles where no gradient is asked for. False for graphs that are
            traced: one graph serves all sizes, see `closed_form_by_phase`.

    Raises:
        InputError: If the scale is another one, or corners are aligned.
    """

    def __init__(self, regression: SoftArgmax, *, in_tiles: bool = True) -> None:
        super().__init__(regression.scale, regression.estimator)
        if not has_closed_form(regression):
            raise InputError(
                f"the closed form is for a scale of {SCALE} and half-pixel centres, not for "
                f"{regression.scale}{' and aligned corners' if regression.align_corners else ''}"
            )
        self.in_tiles = in_tiles

    def forward(self, scores: Tensor) -> Tensor:
        """Scores (B, D, H, W) to disparity (B, 4 H, 4 W) in pixels."""
        return self._regress(scores, self.estimator)

    def expectation(self, scores: Tensor) -> Tensor:
        """As `forward`, with the estimator "mean"."""
        return self._regress(scores, "mean")

    def _regress(self, scores: Tensor, estimator: Estimator) -> Tensor:
        scores = scores.to(torch.promote_types(scores.dtype, torch.float32))
        if scores.requires_grad and torch.is_grad_enabled():
            disparity: Tensor = _soft_argmax(upsample(scores), estimator == "mode")[0]
            return disparity
        if not self.in_tiles:
            return closed_form_by_phase(scores, estimator)
        # Elsewhere few large kernels are faster than tiles that stay in a cache.
        if scores.device.type != "cpu" or torch.compiler.is_compiling():
            return closed_form(upsample(scores), estimator)
        return _by_tiles(scores, estimator)

    def confidence(self, scores: Tensor) -> Tensor:
        """As `SoftArgmax.confidence`, on tensors of four dimensions."""
        with torch.autocast(scores.device.type, enabled=False):
            return self._confidence(scores.to(torch.promote_types(scores.dtype, torch.float32)))

    def _confidence(self, scores: Tensor) -> Tensor:
        planes = scores.shape[1]
        # Linear upsampling along D as a 1x1 convolution.
        identity = torch.eye(planes, dtype=scores.dtype, device=scores.device)
        weights = F.interpolate(identity[None], scale_factor=float(SCALE), mode="linear")[0].t()
        probability = F.conv2d(scores, weights[..., None, None]).softmax(dim=1)
        bins = torch.arange(SCALE * planes, dtype=scores.dtype, device=scores.device)
        disparity = closed_form(scores, self.estimator).unsqueeze(1)
        distance = (bins[:, None, None] - disparity).abs()
        within = (CONFIDENCE_RADIUS_PX + 0.5 - distance).clamp(0, 1)
        confidence = (probability * within).sum(dim=1, keepdim=True)
        return F.interpolate(confidence, scale_factor=float(SCALE), mode="bilinear").squeeze(1)


def has_closed_form(regression: SoftArgmax) -> bool:
    """Whether the closed form is that of a regression."""
    return regression.scale == SCALE and not regression.align_corners


def use_closed_form(net: nn.Module, *, in_tiles: bool = True) -> None:
    """Replace the soft-argmax of a network, in place, where it has a closed form."""
    replace_modules(
        net,
        SoftArgmax,
        lambda head: (
            ClosedFormSoftArgmax(head, in_tiles=in_tiles) if has_closed_form(head) else head
        ),
    )


class Intervals(NamedTuple):
    """Sums over the four fine terms between neighbouring planes, before the softmax's division."""

    mass: Tensor  # (B, D - 1, H, W)
    first: Tensor  # first moment of the disparity about the interval's centre
    sides: Tensor  # the two inner terms are this ...
    product: Tensor  # ... times this
    below: Tensor  # (B, H, W), the fine terms below the first plane
    above: Tensor  # those above the last plane
    peak: Tensor  # (B, H, W), the score whose exponential all sums are over
    centres: Tensor  # (D - 1, 1, 1), in pixels
    ends: tuple[float, float]  # centres of the fine terms below and above, in pixels
    left_out: tuple[int, int]  # planes below and above that are as the outer ones

    @property
    def total(self) -> Tensor:
        """The softmax's denominator, (B, H, W), over the peak's exponential."""
        return self.mass.sum(dim=1) + self.below + self.above

    @property
    def inner(self) -> Tensor:
        """Sum of the two inner terms, (B, D - 1, H, W)."""
        return self.sides * self.product

    def dominant(self) -> Intervals:
        """The same of the dominant mode alone; of scores of which no plane is left out."""
        assert self.left_out == (0, 0)
        masses = (self.below.unsqueeze(1), self.mass, self.above.unsqueeze(1))
        keep = dominant_mode(torch.cat(masses, dim=1))
        between = keep[:, 1:-1]
        return self._replace(
            mass=self.mass * between,
            first=self.first * between,
            sides=self.sides * between,
            below=self.below * keep[:, 0],
            above=self.above * keep[:, -1],
        )


def intervals(scores: Tensor, left_out: tuple[int, int] = (0, 0)) -> Intervals:
    """Sums over the fine terms of scores (B, D, H, W), as `closed_form` takes them.

    Between planes whose scores have the exponentials p^8 and q^8 the fine terms are p^7 q, p^5 q^3,
    p^3 q^5 and p q^7: with a = p^2 and b = q^2 their sum is p q (a + b) (a^2 + b^2). Exact unless
    a lone plane's score is more than 640 (float64: 5600) above all others'.
    """
    peak = scores.amax(dim=1, keepdim=True)
    # Limited, so that the fine terms beside a lone peak stay above zero.
    least = math.log(torch.finfo(scores.dtype).tiny) + _MARGIN
    eighth = (scores - peak).div_(8).clamp_min_(least).exp_()
    quarter = eighth * eighth
    half = quarter * quarter
    low, high = quarter[:, :-1], quarter[:, 1:]
    both = eighth[:, :-1] * eighth[:, 1:]
    sides = both * (low + high)
    squares = half[:, :-1] + half[:, 1:]
    product = low * high
    mass = sides * squares
    first = (high - low).mul_(both).mul_((1.5 * squares).add_(product, alpha=2))
    counts = [SCALE // 2 + SCALE * planes for planes in left_out]
    below, above = (n * end * end for n, end in zip(counts, (half[:, 0], half[:, -1]), strict=True))
    first_plane, planes = left_out[0], scores.shape[1] + sum(left_out)
    centres = torch.arange(scores.shape[1] - 1, dtype=scores.dtype, device=scores.device)
    centres = (SCALE * (centres + first_plane) + (SCALE + 3) / 2)[:, None, None]
    ends = (counts[0] - 1) / 2, SCALE * planes - (counts[1] + 1) / 2
    return Intervals(mass, first, sides, product, below, above, peak[:, 0], centres, ends, left_out)


def _expectation(m: Intervals) -> tuple[Tensor, Tensor]:
    """Expected disparity and the softmax's denominator, each (B, H, W)."""
    total = m.total
    moment = (m.centres * m.mass + m.first).sum(dim=1)
    ends = m.ends[0] * m.below + m.ends[1] * m.above
    return (moment + ends) / total, total


def closed_form(scores: Tensor, estimator: Estimator, left_out: tuple[int, int] = (0, 0)) -> Tensor:
    """Expected disparity of scores whose upsampling in height and width is done.

    Plain operators only.

    Args:
        scores: (B, D, H, W), planes at the disparities 1.5, 5.5, 9.5 ...
        estimator: See `SoftArgmax`.
        left_out: Planes below the first and above the last one that have the same scores as these,
            see `flat_ends`.

    Returns:
        Disparity (B, H, W) in pixels.
    """
    m = intervals(scores, left_out)
    return _dominant_expectation(m) if estimator == "mode" else _expectation(m)[0]


def _dominant_expectation(m: Intervals) -> Tensor:
    """Expected disparity of the dominant mode, (B, H, W): that of three intervals or of all."""
    below, above = m.below.unsqueeze(1), m.above.unsqueeze(1)
    masses = torch.cat((below, m.mass, above), dim=1)
    between = torch.addcmul(m.first, m.mass, m.centres)
    moments = torch.cat((m.ends[0] * below, between, m.ends[1] * above), dim=1)
    # An end that stands for planes left out is no interval, nor likely enough, see `flat_ends`.
    kept = slice(int(m.left_out[0] > 0), masses.shape[1] - int(m.left_out[1] > 0))
    mass, moment = (
        (of[:, :-2] + of[:, 1:-1]).add_(of[:, 2:]) for of in (masses[:, kept], moments[:, kept])
    )
    most = mass.amax(dim=1, keepdim=True)
    likeliest = (mass >= most).to(mass.dtype)
    mode = moment.mul_(likeliest).sum(dim=1) / (most[:, 0] * likeliest.sum(dim=1))
    total = masses.sum(dim=1)
    return torch.where(most[:, 0] < MIN_MODE_PROBABILITY * total, moments.sum(dim=1) / total, mode)


def upsample(scores: Tensor) -> Tensor:
    """Scores (B, D, H, W), upsampled in height and width: (B, D, 4 H, 4 W)."""
    return F.interpolate(scores, scale_factor=float(SCALE), mode="bilinear", align_corners=False)


def closed_form_by_phase(scores: Tensor, estimator: Estimator) -> Tensor:
    """Closed-form soft-argmax in four phases, traced for any size: (B, D, H, W) -> (B, 4 H, 4 W).

    Of all pixels that lie at the same place within their scores' pixel, one of 4 x 4 phases, the
    upsampled scores are one weighted sum of neighbouring scores. So one row of phases after the
    other needs a quarter of the memory, and no size stands in the graph.
    """
    phases = [
        phase
        for rows in _phases(scores, 2)
        for phase in closed_form(torch.cat(list(_phases(rows, 3))), estimator).split(len(scores))
    ]
    return F.pixel_shuffle(torch.stack(phases, dim=1), SCALE).squeeze(1)


def _phases(scores: Tensor, dim: int) -> Iterator[Tensor]:
    """The four phases of scores upsampled by 4 along a dimension, first to fourth."""
    around: tuple[slice, ...] = (slice(None),) * dim
    first, last = scores[(*around, slice(1))], scores[(*around, slice(-1, None))]
    before = torch.cat((first, scores[(*around, slice(-1))]), dim)
    after = torch.cat((scores[(*around, slice(1, None))], last), dim)
    for neighbour, weight in ((before, 0.375), (before, 0.125), (after, 0.125), (after, 0.375)):
        yield scores * (1 - weight) + neighbour * weight


def _by_tiles(scores: Tensor, estimator: Estimator) -> Tensor:
    """Disparity of one tile at a time, so that not even the upsampled scores exist as a whole."""
    (rows, columns), (height, width) = _TILE, scores.shape[2:]
    disparity = scores.new_empty(len(scores), SCALE * height, SCALE * width)
    # A band ends before the first or the last planes at each pixel.
    flat = [(scores[:, i] == scores[:, j]).float().mean() for i, j in ((0, 1), (-1, -2))]
    banded = bool(max(flat) >= 0.5)
    columns = columns if banded else width
    for top, left in itertools.product(range(0, height, rows), range(0, width, columns)):
        bottom, right = min(top + rows, height), min(left + columns, width)
        # The pixels around the tile are what the interpolation also looks at.
        y, x = max(top - 1, 0), max(left - 1, 0)
        tile = scores[:, :, y : bottom + 1, x : right + 1]
        left_out = flat_ends(tile) if banded else (0, 0)
        fine = upsample(tile[:, left_out[0] : tile.shape[1] - left_out[1]])
        fine = fine[:, :, SCALE * (top - y) :, SCALE * (left - x) :]
        result = disparity[:, SCALE * top : SCALE * bottom, SCALE * left : SCALE * right]
        fine = fine[:, :, : result.shape[1], : result.shape[2]]
        step = cached_rows(fine)
        for part, target in zip(fine.split(step, 2), result.split(step, 1), strict=True):
            target.copy_(closed_form(part, estimator, left_out))
    return disparity


def flat_ends(scores: Tensor) -> tuple[int, int]:
    """Planes at either end that can be left out, as those next to them have the same scores.

    So it is outside of the bands of a cascade. An end is shortened only if it has, at every pixel,
    the lowest score of all planes, and another plane a higher one: then no interval in it is in the
    dominant mode. Scores of few planes are kept whole: three intervals of a flat end could hold
    `MIN_MODE_PROBABILITY` there, and more than the neighbourhood of a plane at the opposite end.

    Args:
        scores: (B, D, H, W).

    Returns:
        How many to leave out below and above.
    """
    if scores.shape[1] * MIN_MODE_PROBABILITY <= 3:
        return 0, 0
    lowest, peak = scores.aminmax(dim=1)
    left_out = []
    for planes in (scores, scores.flip(1)):
        end = planes[:, 0]
        if bool(((end > lowest) | (end == peak)).any()):
            left_out.append(0)
        else:
            same = (planes == planes[:, :1]).flatten(2).all(dim=2).all(dim=0)
            left_out.append(max(0, int(same.logical_not().int().argmax()) - _KEPT))
    return left_out[0], left_out[1]


def cached_rows(scores: Tensor) -> int:
    """Rows of scores (B, D, H, W) whose temporaries stay in a CPU's cache; all on a GPU."""
    if scores.is_cuda:
        return scores.shape[2]
    return max(1, _CACHED_ELEMENTS // (scores.shape[1] * scores.shape[3]))


@torch.library.custom_op("mobilestereonet::soft_argmax", mutates_args=())
def _soft_argmax(scores: Tensor, mode: bool) -> tuple[Tensor, Tensor]:
    """`closed_form` and its derivative, row by row: what training needs.

    The temporaries of some rows stay in the processor's cache, and both come from the same ones:
    several times faster on a CPU than autograd through `closed_form`.
    """
    disparity = torch.empty_like(scores[:, 0])
    derivative = torch.empty_like(scores)
    step = cached_rows(scores)
    blocks = zip(
        scores.split(step, 2), disparity.split(step, 1), derivative.split(step, 2), strict=True
    )
    for rows, *targets in blocks:
        _disparity_and_derivative(rows, "mode" if mode else "mean", *targets)
    return disparity, derivative


@_soft_argmax.register_fake
def _(scores: Tensor, mode: bool) -> tuple[Tensor, Tensor]:
    return torch.empty_like(scores[:, 0]), torch.empty_like(scores)


def keep_derivative(ctx: Any, inputs: Any, output: tuple[Tensor, Tensor]) -> None:
    """Keep what an operator gives besides its result, its derivative, for the way back."""
    ctx.mark_non_differentiable(output[1])
    ctx.save_for_backward(output[1])


def _backward(ctx: Any, grad: Tensor, _: Tensor) -> tuple[Tensor, None]:
    if torch.is_grad_enabled():
        raise RuntimeError(
            "the soft-argmax in closed form has no second derivative: use the plain one"
        )
    (derivative,) = ctx.saved_tensors
    return derivative * grad.unsqueeze(1), None


_soft_argmax.register_autograd(_backward, setup_context=keep_derivative)


def _disparity_and_derivative(
    scores: Tensor, estimator: Estimator, disparity: Tensor, derivative: Tensor
) -> None:
    """Fill in the disparity (B, H, W), and what each score (B, D, H, W) changes of it."""
    m = intervals(scores)
    if estimator == "mode":
        m = m.dominant()
    found, total = _expectation(m)
    disparity.copy_(found)
    scale = 0.5 / total.unsqueeze(1)
    offset = m.centres - found.unsqueeze(1)
    # A fine term at o px from its interval's centre weighs the two planes 1/2 -+ o/4.
    even = torch.addcmul(m.first, offset, m.mass).mul_(scale)
    second = 2.25 * m.mass - 2 * m.inner
    odd = second.addcmul_(offset, m.first).mul_(scale / 2)
    ends = 2 * scale[:, 0]
    torch.sub(even, odd, out=derivative[:, :-1])
    derivative[:, -1] = ends * (SCALE * scores.shape[1] - 1.5 - found) * m.above
    derivative[:, 1:] += even.add_(odd)
    derivative[:, 0] += ends * (0.5 - found) * m.below
