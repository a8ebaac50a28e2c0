"""Plain functions that several networks share: cost volumes, correlation, modes."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

import torch
import torch.nn.functional as F
from torch import Tensor, nn


def cost_volume(
    compare: Callable[[Tensor, Tensor], Tensor], left: Tensor, right: Tensor, planes: int
) -> Tensor:
    """Cost volume by a loop over disparities (MobileStereoNet's Eq. 1).

    Plane i compares left column x with right column x - i. The columns x < i, which have no
    partner, are zero; so are whole planes from the width on.

    Args:
        compare: Eq. 1's G: maps the left and right features (B, C, H, W - i) of the columns with
            a partner to costs (B, K, H, W - i).
        left: Features of the left views, (B, C, H, W).
        right: Features of the right views, likewise.
        planes: Number of disparities D, one per pixel of the features.

    Returns:
        (B, K, D, H, W).
    """
    width = left.shape[-1]
    volume = []
    for i in range(min(planes, width)):
        costs = compare(left[..., i:], right[..., : -i or None])
        volume.append(F.pad(costs, (i, 0)))
    volume += [torch.zeros_like(volume[0])] * (planes - len(volume))
    return torch.stack(volume, dim=2)


def band_volume(
    compare: Callable[[Tensor, Tensor], Tensor],
    left: Tensor,
    right: Tensor,
    start: Tensor,
    planes: int,
) -> Tensor:
    """Cost volume of a band of disparities that starts elsewhere at each pixel.

    Plane i compares left column x with right column x - start - i. (Gu et al., "Cascade Cost
    Volume for High-Resolution Multi-View Stereo and Stereo Matching", CVPR 2020, Sec. 3.2.)

    Args:
        compare: See `cost_volume`; it must compare each column for itself.
        left: Features of the left views, (B, C, H, W).
        right: Features of the right views, likewise.
        start: First disparity of each pixel's band, (B, H, W) int64, in pixels of the features.
        planes: Number of disparities D of the band.

    Returns:
        (B, K, D, H, W), zero where a pixel has no partner.
    """
    columns = torch.arange(left.shape[-1], device=left.device) - start
    volume = []
    for i in range(planes):
        partner = (columns - i).unsqueeze(1)  # (B, 1, H, W)
        costs = compare(left, right.gather(3, partner.clamp_min(0).expand_as(right)))
        volume.append(costs * (partner >= 0))
    return torch.stack(volume, dim=2)


def correlation_1d(left: Tensor, right: Tensor, reach: int) -> Tensor:
    """Correlation along the rows (DispNetC of Mayer et al., CVPR 2016, Sec. 4.1).

    Args:
        left: Features of the left views, (B, C, H, W).
        right: Features of the right views, likewise.
        reach: Largest displacement to either side, in pixels of the features.

    Returns:
        (B, 2 reach + 1, H, W): channel k is the mean over the channels of left column x times
        right column x + k - reach; zero where that is outside.
    """
    width = left.shape[-1]
    right = F.pad(right, (reach, reach))
    products = [(left * right[..., k : k + width]).mean(dim=1) for k in range(2 * reach + 1)]
    return torch.stack(products, dim=1)


class Correlation1D(nn.Module):
    """`correlation_1d` as a layer.

    Args:
        reach: Largest displacement to either side, in pixels of the features.
    """

    def __init__(self, reach: int) -> None:
        super().__init__()
        self.reach = reach

    def forward(self, left: Tensor, right: Tensor) -> Tensor:
        """Features (B, C, H, W) of both views -> (B, 2 reach + 1, H, W)."""
        return correlation_1d(left, right, self.reach)


def concatenate(left: Tensor, right: Tensor) -> Tensor:
    """Features (B, C, H, W) of both views, one after the other: (B, 2 C, H, W)."""
    return torch.cat((left, right), dim=1)


@contextmanager
def eval_mode(network: nn.Module) -> Iterator[None]:
    """Eval mode for a while; afterwards each module has the mode that it had, frozen ones too."""
    modes = [(module, module.training) for module in network.modules()]
    network.eval()
    try:
        yield
    finally:
        for module, training in modes:
            module.training = training
