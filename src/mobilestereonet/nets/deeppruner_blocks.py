"""Building blocks of DeepPruner: scores of candidates, ends of the range, refinements."""

from __future__ import annotations

from functools import partial
from itertools import pairwise
from typing import cast

import torch
from torch import Tensor, nn

from mobilestereonet.nets.blocks import conv_norm, transposed_norm
from mobilestereonet.nets.regression import SLOPE, enlarged

PARTICLES = 12
"""Number of candidates that PatchMatch finds in the whole range, without its two ends."""

_ACROSS = (1, 2, 2)
"""Stride of the 3D layers: rows and columns, not the candidates."""

_conv = partial(conv_norm, activation=partial(nn.LeakyReLU, SLOPE))
"""Convolution, batch norm and leaky ReLU."""


class Hourglass(nn.Module):
    """Scores of candidates: to an eighth of the height and width and up again, with skips.

    Args:
        add_input: The input is added to the last level, too.
    """

    def __init__(self, *, add_input: bool = False) -> None:
        super().__init__()
        self.add_input = add_input
        steps = list(pairwise((16, 32, 64, 128)))
        self.down = nn.ModuleList(_conv(3, fine, coarse, stride=_ACROSS) for fine, coarse in steps)
        self.same = nn.ModuleList(_conv(3, coarse, coarse) for _, coarse in steps)
        self.up = nn.ModuleList(
            transposed_norm(3, coarse, fine, stride=_ACROSS) for fine, coarse in reversed(steps)
        )
        self.score = nn.Sequential(
            _conv(3, 16, 32), nn.Conv3d(32, 1, kernel_size=3, padding=1, bias=False)
        )

    def forward(self, x: Tensor) -> Tensor:
        """(B, 16, n, H, W), H and W multiples of 8 -> scores (B, n, H, W)."""
        levels = [x]
        for down, same in zip(self.down, self.same, strict=True):
            coarse = down(levels[-1])
            levels.append(coarse + same(coarse))
        y = levels.pop()
        for up in self.up:
            y, skip = up(y), levels.pop()
            if levels or self.add_input:
                y = y + skip
        return cast(Tensor, self.score(y).squeeze(1))


class Smoothing(nn.Module):
    """A 5x5 convolution of a disparity map and one of the scores of n candidates."""

    def __init__(self, candidates: int) -> None:
        super().__init__()
        self.disparity = nn.Sequential(nn.Conv2d(1, 1, 5, padding=2), nn.ReLU(inplace=True))
        self.scores = _conv(2, candidates, candidates, kernel=5, bias=True)

    def start_as_identity(self) -> None:
        """Fresh weights that leave the disparity as it is.

        Weights drawn around zero would as often as not give the ReLU nothing but zeros, for good.
        """
        conv = cast(nn.Conv2d, self.disparity[0])
        nn.init.dirac_(conv.weight)
        nn.init.zeros_(cast(Tensor, conv.bias))

    def forward(self, disparity: Tensor, scores: Tensor) -> tuple[Tensor, Tensor]:
        """(B, 1, H, W) and (B, n, H, W) -> a disparity and features of the same shapes."""
        return self.disparity(disparity), self.scores(scores)


class RangeEnd(nn.Module):
    """Predicts one end of each pixel's range."""

    def __init__(self) -> None:
        super().__init__()
        self.hourglass = Hourglass()
        self.smoothing = Smoothing(PARTICLES + 2)

    def forward(self, volume: Tensor, candidates: Tensor) -> tuple[Tensor, Tensor]:
        """(B, 16, n, H, W) and (B, n, H, W) -> disparity (B, 1, H, W), features (B, n, H, W)."""
        scores = self.hourglass(volume)
        smoothed: tuple[Tensor, Tensor] = self.smoothing(expectation(scores, candidates), scores)
        return smoothed


class Refinement(nn.Module):
    """Corrects a disparity by features of the left view, and doubles its size."""

    def __init__(self, inputs: int) -> None:
        super().__init__()
        self.convs = nn.Sequential(
            _conv(2, inputs, 32),
            _conv(2, 32, 32),
            _conv(2, 32, 32),
            _conv(2, 32, 16, dilation=2),
            _conv(2, 16, 16, dilation=4),
            _conv(2, 16, 16),
        )
        self.residual = nn.Conv2d(16, 1, 3, padding=1, bias=False)
        self.activation = nn.ReLU(inplace=True)

    def forward(self, *maps: Tensor) -> Tensor:
        """Features (B, C, H, W) and, last, the disparity (B, 1, H, W) -> (B, 1, 2 H, 2 W)."""
        residual = self.residual(self.convs(torch.cat(maps, dim=1)))
        return doubled(self.activation(residual + maps[-1]))


def expectation(scores: Tensor, candidates: Tensor) -> Tensor:
    """Mean of the candidates under the softmax of their scores: (B, n, H, W) -> (B, 1, H, W)."""
    probability = scores.to(candidates.dtype).softmax(dim=1)
    return (probability * candidates).sum(dim=1, keepdim=True).to(scores.dtype)


def doubled(disparity: Tensor) -> Tensor:
    """A disparity (B, 1, H, W) at twice the resolution, in pixels of that: (B, 1, 2 H, 2 W)."""
    return 2 * enlarged(disparity, 2)


def reduction(inputs: int) -> nn.Sequential:
    """3D convolutions from a volume to the 16 channels of an hourglass."""
    return nn.Sequential(*(_conv(3, i, o) for i, o in pairwise((inputs, 64, 32, 32, 16))))
