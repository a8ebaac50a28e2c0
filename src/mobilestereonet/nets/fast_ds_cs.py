"""Fast DS-CS (Yee and Chakrabarti, WACV 2020): 2D convolutions of cost signatures.

The costs of all disparities at half resolution, of a census transform and of colour, are the input
channels of a small 2D network.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from mobilestereonet.errors import check_multiple
from mobilestereonet.nets.blocks import initialise
from mobilestereonet.nets.model import RGB, Prediction, StereoModel
from mobilestereonet.nets.registry import register_model

WINDOW = 5
"""Side of the census transform's window, in pixels of half the resolution."""

YUV = (
    (0.299, 0.587, 0.114),
    (-0.14714119, -0.28886916, 0.43601035),
    (0.61497538, -0.51496512, -0.10001026),
)
"""Luma and chroma of RGB in 0..1."""

MEANS = (11.08282948, 0.02175535, 0.02679042)
SCALES = (0.1949711, 35.91432953, 26.79782867)
"""What normalises the three costs: of the census transforms (bits) and of the chromas."""

EPSILON = 1e-8
"""What the batch norms add to the variance."""

LEVELS = (32, 48, 64, 80, 96)
"""Channels of the U-Net, from half of the resolution down."""


@dataclass(frozen=True, kw_only=True)
class FastDSCSConfig:
    """Fast DS-CS as data.

    Attributes:
        max_disparity: Disparities 0 .. max_disparity - 1 are searched, every second one; even.
    """

    max_disparity: int = 256

    def __post_init__(self) -> None:
        check_multiple("max_disparity", self.max_disparity, 2)


class Bias(nn.Module):
    """Adds a learned value to each channel: what a norm without scale leaves to do."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.bias = nn.Parameter(torch.zeros(channels))

    def forward(self, x: Tensor) -> Tensor:
        """(B, C, H, W) -> the same shape."""
        return x + self.bias[:, None, None]


class CostSignatures(nn.Module):
    """`cost_signatures` as a layer.

    Args:
        planes: Number of disparities D, in pixels of the views.
    """

    def __init__(self, planes: int) -> None:
        super().__init__()
        self.planes = planes

    def forward(self, left: Tensor, right: Tensor) -> Tensor:
        """Views (B, 3, H, W), RGB in 0..1 -> (B, 3 D, H, W)."""
        return cost_signatures(left, right, self.planes)


class UNet(nn.Module):
    """U-Net (Sec. 3.2) that learns its upsampling: a 1x1 convolution, depth to space."""

    def __init__(self, inputs: int) -> None:
        super().__init__()
        self.down = nn.ModuleList(
            nn.Sequential(_conv(before, here, 3), _conv(here, here, 3))
            for before, here in pairwise((inputs, *LEVELS))
        )
        steps = list(pairwise(LEVELS[::-1]))
        self.grow = nn.ModuleList(_conv(below, 4 * here, 1) for below, here in steps)
        self.up = nn.ModuleList(
            nn.Sequential(_conv(2 * here, here, 3), _conv(here, here, 3)) for _, here in steps
        )

    def forward(self, x: Tensor) -> Tensor:
        """(B, inputs, H, W) -> (B, 32, H, W), H and W multiples of 16."""
        maps: list[Tensor] = []
        for level, convolutions in enumerate(self.down):
            x = convolutions(F.max_pool2d(x, 2) if level else x)
            maps.append(x)
        maps.pop()
        for grow, convolutions in zip(self.grow, self.up, strict=True):
            x = convolutions(torch.cat((maps.pop(), F.pixel_shuffle(grow(x), 2)), dim=1))
        return x


@register_model(
    "fast-ds-cs",
    paper="Yee and Chakrabarti, Fast Deep Stereo with 2D Convolutional Processing of Cost "
    "Signatures, WACV 2020",
    licence="no licence given (code and weights)",
    checkpoints="ayanc/fdscs on GitHub: bn600k.npz (its other files lack statistics of the norms)",
    trained_on="SceneFlow finalpass, then KITTI 2012 and 2015",
    recipes=("fast-ds-cs-sceneflow", "fast-ds-cs-kitti2015"),
)
class FastDSCS(StereoModel):
    """Hand-made costs as channels, and a U-Net on them. Takes views of any size."""

    config: FastDSCSConfig
    preprocessing = RGB
    size_multiple = 1
    min_side = 32

    def __init__(self, config: FastDSCSConfig) -> None:
        super().__init__(config)
        self.signatures = CostSignatures(config.max_disparity // 2)
        channels = (3 * config.max_disparity // 2, 192, 96, 48, 32)
        self.encode = nn.Sequential(*(_conv_norm(i, o, 1) for i, o in pairwise(channels)))
        self.combine = nn.Sequential(*(_conv_norm(i, 32, 3) for i in (3 + 32, 32, 32)))
        self.unet = UNet(3 + 32)
        self.out = nn.Conv2d(32, 1, 1)
        initialise(self)

    def forward(self, left: Tensor, right: Tensor) -> Prediction:
        """A `Prediction` in both modes; see `StereoModel`."""
        self.check_views(left, right)
        odd_rows, odd_columns = (side % 2 for side in left.shape[-2:])
        left, right = (
            F.avg_pool2d(F.pad(view, (odd_columns, 0, odd_rows, 0), mode="replicate"), 2)
            for view in (left, right)
        )
        colour = 2 * left - 1
        x = self.encode(self.signatures(left, right))
        x = self.combine(torch.cat((colour, x), dim=1))
        disparity = self._regress(torch.cat((colour, x), dim=1))
        return Prediction(enlarge(disparity)[:, odd_rows:, odd_columns:])

    def _regress(self, x: Tensor) -> Tensor:
        """(B, 35, H, W) of any size -> disparity (B, H, W) in pixels of the full resolution."""
        height, width = x.shape[-2:]
        rows, columns = -height % 16, -width % 16
        top, left = rows // 2, columns // 2
        x = F.pad(x, (left, columns - left, top, rows - top), mode="reflect")
        x = self.unet(x)[..., top : top + height, left : left + width]
        return F.relu(self.out(x).squeeze(1) + self.max_disparity / 2)

    def training_loss(self, outputs: Prediction, disparity: Tensor, valid: Tensor) -> Tensor:
        """Eighth root of the error in px, which weighs as 1 px below that; see `StereoModel`."""
        truth = torch.where(valid, disparity, outputs.disparity)
        losses = (outputs.disparity - truth).abs().clamp_min(1) ** (1 / 8)
        return (losses * valid).sum() / valid.sum().clamp_min(1)


def cost_signatures(left: Tensor, right: Tensor, planes: int) -> Tensor:
    """Normalised costs of all disparities (Sec. 3.1).

    Left columns without a partner repeat the costs of the first that has one; so do disparities
    beyond the width those of the last within it.

    Args:
        left: Left views (B, 3, H, W), RGB in 0..1.
        right: Right views, likewise.
        planes: Number of disparities D, in pixels of these views.

    Returns:
        (B, 3 D, H, W): for each disparity the bits in which the census transforms differ, and the
        absolute differences of both chromas.
    """
    matrix = left.new_tensor(YUV)[:, :, None, None]
    views = [F.conv2d(view, matrix) for view in (left, right)]
    codes = [census(view[:, :1]) for view in views]
    chromas = [view[:, 1:] for view in views]
    mean, scale = (left.new_tensor(values)[:, None, None] for values in (MEANS, SCALES))
    width = left.shape[-1]
    signatures = []
    for plane in range(planes):
        i = min(plane, width - 1)
        (code, other), (chroma, its) = (
            (a[..., i:], b[..., : width - i]) for a, b in (codes, chromas)
        )
        bits = (code != other).sum(dim=1, keepdim=True).to(chroma.dtype)
        costs = torch.cat((bits, (chroma - its).abs()), dim=1)
        signatures.append(F.pad((costs - mean) * scale, (i, 0, 0, 0), mode="replicate"))
    return torch.cat(signatures, dim=1)


def census(luma: Tensor) -> Tensor:
    """Census transform: which of the 24 neighbours in 5 x 5 pixels are at most the centre.

    Args:
        luma: (B, 1, H, W).

    Returns:
        (B, 24, H, W) bool; False where a neighbour is outside the view.
    """
    height, width = luma.shape[-2:]
    padded = F.pad(luma, (WINDOW // 2,) * 4, value=torch.inf)
    bits = [
        luma >= padded[..., i : i + height, j : j + width]
        for i in range(WINDOW)
        for j in range(WINDOW)
        if (i, j) != (WINDOW // 2, WINDOW // 2)
    ]
    return torch.cat(bits, dim=1)


def enlarge(disparity: Tensor) -> Tensor:
    """Twice the size: bilinear where that is within 1 px of the nearest value, else that value.

    Args:
        disparity: (B, H, W); its pixels are the even ones of the result.

    Returns:
        (B, 2 H, 2 W).
    """
    height, width = disparity.shape[-2:]
    nearest = disparity.repeat_interleave(2, dim=1).repeat_interleave(2, dim=2)
    padded = F.pad(disparity.unsqueeze(1), (0, 1, 0, 1), mode="replicate")
    size = (2 * height + 1, 2 * width + 1)
    smooth = F.interpolate(padded, size=size, mode="bilinear", align_corners=True)
    smooth = smooth[:, 0, :-1, :-1]
    return torch.where((nearest - smooth).abs() < 1, smooth, nearest)


def _conv(inputs: int, outputs: int, kernel: int) -> nn.Sequential:
    """Convolution and ReLU."""
    return nn.Sequential(
        nn.Conv2d(inputs, outputs, kernel, padding=kernel // 2), nn.ReLU(inplace=True)
    )


def _conv_norm(inputs: int, outputs: int, kernel: int) -> nn.Sequential:
    """Convolution, batch norm without scale, bias and ReLU."""
    return nn.Sequential(
        nn.Conv2d(inputs, outputs, kernel, padding=kernel // 2, bias=False),
        nn.BatchNorm2d(outputs, eps=EPSILON, affine=False),
        Bias(outputs),
        nn.ReLU(inplace=True),
    )
