"""A network as a graph of plain operators on tensors of at most four dimensions.

Every engine and exporter takes it. Disparities lie along the batch axis, so it takes one pair.
"""

from __future__ import annotations

import copy
from collections.abc import Iterator

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from mobilestereonet.accelerate.optimise import fold_norms
from mobilestereonet.accelerate.planewise import PlanewiseLearnedVolume
from mobilestereonet.accelerate.slices import slice_layers
from mobilestereonet.nets import NetConfig, StereoNet
from mobilestereonet.nets.coarse_pass import guidance, halve
from mobilestereonet.nets.cost_volumes import Correlation, LearnedVolume
from mobilestereonet.nets.disparity import Estimator, mode_mask
from mobilestereonet.nets.normalise import normalise


def narrowest(config: NetConfig) -> int:
    """Smallest width in px that `Graph` takes: the disparity range and a little more."""
    return config.max_disparity + config.size_multiple


def example_pair(net: StereoNet) -> tuple[Tensor, Tensor]:
    """A small pair with which to trace `Graph`; what it is traced with does not matter."""
    left, right = torch.zeros(2, 1, 3, 64, narrowest(net.config))
    return left, right


class Graph(nn.Module):
    """`StereoNet` in eval mode, with the same result up to rounding.

    No operator has a height or width written into it: traced at one size, it serves any.
    """

    def __init__(
        self, net: StereoNet, *, rgb: bool = False, head: bool = True, sliced: bool = True
    ) -> None:
        """Rewrite a copy of a network.

        Args:
            net: The network, with any weights.
            rgb: Take RGB in 0..1 and normalise it inside.
            head: Give the disparity; otherwise the scores at a quarter of the resolution, for
                `regress_disparity`.
            sliced: Write 3D layers as 2D layers on slices.
        """
        super().__init__()
        net = copy.deepcopy(net).eval().requires_grad_(False)
        fold_norms(net)
        self.rgb, self.head, self.sliced = rgb, head, sliced
        self.config = net.config
        self.features, self.reduction = net.features, net.reduction
        self.volume = (
            BlockwiseLearnedVolume(net.volume)
            if isinstance(net.volume, LearnedVolume)
            else BlockwiseCorrelation(net.volume, net.config.volume_input)
        )
        self.pre_hourglass = net.pre_hourglass
        self.aggregation = nn.Sequential(*net.hourglasses, net.heads[-1])
        if self.config.coarse_pass:
            self.guide = net.guide
        if self.config.dims == 3 and sliced:
            slice_layers(self)
        self.requires_grad_(False).to(next(net.parameters()).dtype)

    def forward(self, left: Tensor, right: Tensor) -> Tensor:
        """Disparity of the left view.

        Args:
            left: Left view (1, 3, H, W), normalised, or RGB in 0..1 with ``rgb``; H and W are
                multiples of the config's ``size_multiple``, W at least `narrowest`.
            right: Right view, likewise.

        Returns:
            Disparity (1, H, W) in pixels, or scores (1, D, H / 4, W / 4) without ``head``.
        """
        views = torch.cat((left, right))
        if self.rgb:
            views = normalise(views)
        planes, told = self.config.planes, None
        if self.config.coarse_pass:
            told = guidance(self._scores(halve(views), planes // 2))
        scores = self._scores(views, planes, told)
        return soft_argmax_by_powers(scores, self.config.estimator) if self.head else scores

    def _scores(self, views: Tensor, planes: int, told: Tensor | None = None) -> Tensor:
        left, right = self.reduction(self.features(views)).split(1)
        blocks = list(self.volume(left, right, planes))
        if self.config.dims == 3 and self.sliced:
            volume = torch.cat(blocks)
            told = None if told is None else told.transpose(0, 1)
        else:
            volume = torch.cat([block.transpose(0, 1) for block in blocks], dim=1)  # (C, D, H, W)
            if self.config.dims == 3:
                volume = volume.unsqueeze(0)
                told = None if told is None else told.unsqueeze(1)
            elif len(volume) > 1:
                volume = torch.cat(volume.split(1), dim=1)
        x = self.pre_hourglass(volume)
        if told is not None:
            x = x + self.guide(told)
        scores: Tensor = self.aggregation(x)
        return scores.unsqueeze(0) if scores.ndim == 3 else scores


_BLOCK = 4
"""Disparities that go through the cost volume together; divides the number of every network."""


class BlockwiseLearnedVolume(PlanewiseLearnedVolume):
    """`LearnedVolume` without batch norms, in 2D convolutions, a few planes at a time.

    A block has the columns from its first plane's first on, so that only a small corner, where
    its planes begin one after the other, needs a mask.
    """

    def __init__(self, volume: LearnedVolume) -> None:
        super().__init__(volume)
        self.starts: Tensor
        self.corner: Tensor
        self.register_buffer("starts", torch.eye(_BLOCK)[:, None, None])
        self.register_buffer("corner", torch.triu(torch.ones(_BLOCK, _BLOCK))[:, None, None])

    def forward(self, left: Tensor, right: Tensor, planes: int) -> Iterator[Tensor]:
        """(1, 32, H, W) twice -> blocks of so many planes together, (4, 1, H, W)."""
        count = planes
        ours, theirs = self.left(left), self.right(right)
        first = self.left_first(F.pad(left, (0, 1))[..., : count + 1])
        last = self.right_last(F.pad(right, (1, 0))[..., -count - 1 :])
        theirs_corner = F.pad(theirs[..., :_BLOCK], (_BLOCK - 1, 0))
        theirs_corner = torch.cat(
            [theirs_corner[..., _BLOCK - 1 - i : 2 * _BLOCK - 1 - i] for i in range(_BLOCK)]
        )
        for a in range(0, count, _BLOCK):
            b = a + _BLOCK
            starts = torch.where(self.starts > 0, first[..., a:b], ours[..., a:b])
            inner = torch.cat([theirs[..., b - i : -1 - i] for i in range(a, b)])
            end = torch.cat([last[..., count - 1 - i : count - i] for i in range(a, b)])
            corner = (starts + theirs_corner) * self.corner
            columns = (corner, ours[..., b:-1] + inner, ours[..., -1:] + end)
            x = F.relu(torch.cat(columns, dim=-1))
            for layer in (self.second, self.third, self.squeeze):
                x = self._masked(layer(x))
            yield F.pad(x, (a, 0))

    def _masked(self, x: Tensor) -> Tensor:
        return torch.cat((x[..., :_BLOCK] * self.corner, x[..., _BLOCK:]), dim=-1)


class BlockwiseCorrelation(nn.Module):
    """`Correlation` in tensors of four dimensions."""

    def __init__(self, volume: Correlation, channels: int) -> None:
        super().__init__()
        # A convolution and no mean over a reshaped tensor, which would need to know its size.
        self.mean = nn.Conv2d(channels, volume.groups, 1, groups=volume.groups, bias=False)
        nn.init.constant_(self.mean.weight, volume.groups / channels)

    def forward(self, left: Tensor, right: Tensor, planes: int) -> Iterator[Tensor]:
        """(1, C, H, W) twice -> so many planes (1, groups, H, W)."""
        yield self.mean(left * right)
        for i in range(1, planes):
            yield F.pad(self.mean(left[..., i:] * right[..., :-i]), (i, 0))


def soft_argmax_by_powers(scores: Tensor, estimator: Estimator) -> Tensor:
    """`regress_disparity` with one exponential per score, in operators that engines fuse.

    With a and b the exponentials of an eighth of two neighbouring scores, the four fine terms
    between them are a^7 b, a^5 b^3, a^3 b^5 and a b^7.

    Args:
        scores: (B, D, H / 4, W / 4).
        estimator: See `soft_argmax`.

    Returns:
        Disparity (B, H, W) in pixels.
    """
    planes = scores.shape[1]
    fine = F.interpolate(scores, scale_factor=4, mode="bilinear", align_corners=False)
    # Scores far below the best one count for nothing, but must not turn all powers to zero.
    a = torch.exp((fine - fine.amax(dim=1, keepdim=True)).clamp(min=-400) / 8)
    squares = a * a
    low, high = squares[:, :-1], squares[:, 1:]
    both, product = low + high, low * high
    base = a[:, :-1] * a[:, 1:]
    mass = base * both * (both * both - 2 * product)
    first = base * (high - low) * (1.5 * both * both - product)
    left, right = (
        (2 * (square[:, None] ** 4)).squeeze(1) for square in (squares[:, 0], squares[:, -1])
    )
    if estimator == "mode":
        keep = mode_mask(mass, left, right)
        mass, first = mass * keep[:, 1:-1], first * keep[:, 1:-1]
        left, right = left * keep[:, 0], right * keep[:, -1]
    centres = 4 * torch.arange(planes - 1, dtype=scores.dtype, device=scores.device) + 3.5
    moment = (centres[:, None, None] * mass + first).sum(dim=1)
    total = mass.sum(dim=1) + left + right
    return (moment + 0.5 * left + (4 * planes - 1.5) * right) / total
