"""Cost volumes of the paper: interlacing, concatenation, correlation, group-wise correlation."""

from __future__ import annotations

from typing import Literal, cast

import torch
from torch import Tensor, nn

from mobilestereonet.nets.blocks import conv_norm
from mobilestereonet.nets.operations import band_volume, cost_volume

CostVolume = Literal[
    "interlaced-1",
    "interlaced-2",
    "interlaced-4",
    "interlaced-8",
    "interlaced-16",
    "correlation",
    "concatenation",
    "groupwise",
]

REDUCED_CHANNELS = 32
"""Channels per view after the channel reduction of the 2D networks (Sec. 3.2)."""

_KERNEL_DEPTHS: dict[CostVolume, tuple[int, int, int]] = {
    "interlaced-1": (2, 8, 4),
    "interlaced-2": (4, 4, 4),
    "interlaced-4": (8, 4, 2),
    "interlaced-8": (16, 2, 2),
    "interlaced-16": (32, 2, 1),
    "concatenation": (8, 4, 2),
}
"""Depths of the three kernels, each also its stride.

Those of interlaced-4 are the released weights'. Of the others the paper gives the first depth; the
rest, and that concatenation is as deep as interlaced-4, is our choice.
"""


class Correlation(nn.Module):
    """Correlation of left and shifted right features: over all channels, or per group.

    The mean of the products; the paper writes a dot product. Groups: Gwc of GwcNet (Guo et al.,
    CVPR 2019).
    """

    def __init__(self, groups: int = 1) -> None:
        super().__init__()
        self.groups = groups

    def forward(
        self, left: Tensor, right: Tensor, planes: int, start: Tensor | None = None
    ) -> Tensor:
        """(B, C, H, W) twice -> (B, groups, D, H, W), D being ``planes``.

        With ``start``, (B, H, W), each pixel's disparities begin there, see `band_volume`.
        """
        if start is None:
            return cost_volume(self.compare, left, right, planes)
        return band_volume(self.compare, left, right, start, planes)

    def compare(self, left: Tensor, right: Tensor) -> Tensor:
        """(B, C, H, W) twice -> (B, groups, H, W)."""
        product: Tensor = (left * right).unflatten(1, (self.groups, -1))
        return product.mean(dim=2)


class LearnedVolume(nn.Module):
    """Interlacing cost volume (the paper's Sec. 3.2, Eq. 2, Fig. 5), and concatenation likewise.

    The channels of both views, interlaced (L0 R0 L1 R1 ...) or one view after the other, form
    the depth of a one-channel volume. Three 3D convolutions m x 3 x 3 of stride m x 1 x 1, whose
    kernels so do not overlap in depth, and a 1x1 convolution, each with batch norm and ReLU, turn
    it into one plane per disparity. The 3D ones have a bias, as in the released weights.
    """

    def __init__(self, kind: CostVolume) -> None:
        super().__init__()
        self.interlaced = kind != "concatenation"
        channels = (1, 16, 32, 16)
        self.conv = nn.ModuleList(
            nn.Conv3d(inputs, outputs, (depth, 3, 3), stride=(depth, 1, 1), padding=(0, 1, 1))
            for inputs, outputs, depth in zip(
                channels[:-1], channels[1:], _KERNEL_DEPTHS[kind], strict=True
            )
        )
        self.norm = nn.ModuleList(nn.BatchNorm3d(outputs) for outputs in channels[1:])
        self.activation = nn.ReLU(inplace=True)
        self.squeeze = conv_norm(2, 16, 1, kernel=1)

    def forward(self, left: Tensor, right: Tensor, planes: int) -> Tensor:
        """(B, 32, H, W) twice -> (B, 1, D, H, W), D being ``planes``."""
        return cost_volume(self.compare, left, right, planes)

    def compare(self, left: Tensor, right: Tensor) -> Tensor:
        """(B, 32, H, W) twice -> (B, 1, H, W)."""
        if self.interlaced:
            pair = torch.stack((left, right), dim=2).flatten(1, 2)
        else:
            pair = torch.cat((left, right), dim=1)
        x = pair.unsqueeze(1)  # (B, 1, 64, H, W)
        for conv, norm in zip(self.conv, self.norm, strict=True):
            x = self.activation(norm(conv(x)))
        return cast(Tensor, self.squeeze(x.squeeze(2)))
