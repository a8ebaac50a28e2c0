"""Cost volumes one disparity plane at a time, so that a plane stays in a processor's cache.

The first convolution of the interlacing volume is linear: each view's share is computed once and
shifted. See ``docs/how-it-works.md``, "Exact accelerations", with the drawing of the volume.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import cast

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from mobilestereonet.nets.cost_volumes import REDUCED_CHANNELS, LearnedVolume


class PlanewiseLearnedVolume(nn.Module):
    """`LearnedVolume` without batch norms, in 2D convolutions, each plane on its own columns.

    Kernels are as deep as their strides, so that a 3D convolution is a 2D convolution in groups,
    one per step along the depth. As in the authors' loop a plane is cropped to the columns that
    have a partner: nothing is computed that would be masked.
    """

    def __init__(self, volume: LearnedVolume) -> None:
        super().__init__()
        first, second, third = (cast(nn.Conv3d, conv) for conv in volume.conv)
        depth = 2 * REDUCED_CHANNELS // first.kernel_size[0]
        # The groups of the first convolution mix both views: a block-diagonal kernel instead.
        kernel = torch.block_diag(*[first.weight.flatten(1)] * depth)
        kernel = kernel.unflatten(1, (2 * REDUCED_CHANNELS, 3, 3))
        left, right = per_view(kernel, volume.interlaced)
        assert first.bias is not None
        bias = first.bias.repeat(depth)
        self.left = _conv2d(left, bias, padding=(1, 1))
        self.right = _conv2d(right, padding=(1, 1))
        # Beyond a crop lie zeros: its outer columns see kernels without their outer columns.
        self.left_first = _conv2d(left[..., 1:], bias, padding=(1, 0))
        self.right_last = _conv2d(right[..., :-1], padding=(1, 0))
        self.second = _steps(second, depth // second.kernel_size[0])
        self.third = _steps(third, 1)
        self.squeeze = volume.squeeze

    def forward(self, left: Tensor, right: Tensor, planes: int) -> Iterator[Tensor]:
        """(B, 32, H, W) twice -> so many planes (B, 1, H, W)."""
        width = left.shape[-1]
        count = min(planes, width)
        left_share, right_share = self.left(left), self.right(right)
        first = self.left_first(F.pad(left, (0, 1))[..., : count + 1])
        last = self.right_last(F.pad(right, (1, 0))[..., -count - 1 :])
        for i in range(count):
            first_i, last_i = first[..., i : i + 1], last[..., count - 1 - i : count - i]
            if i == width - 1:
                x = first_i + last_i
            else:
                inner = left_share[..., i + 1 : -1] + right_share[..., 1 : width - 1 - i]
                columns = (first_i + right_share[..., :1], inner, left_share[..., -1:] + last_i)
                x = torch.cat(columns, dim=-1)
            x = self.squeeze(self.third(self.second(F.relu(x, inplace=True))))
            yield F.pad(x, (i, 0))
        for _ in range(count, planes):
            yield left.new_zeros(len(left), 1, *left.shape[-2:])


def per_view(kernel: Tensor, interlaced: bool) -> tuple[Tensor, Tensor]:
    """The left view's and the right view's half of a kernel (outputs, 64, 3, 3)."""
    if interlaced:
        return kernel[:, 0::2], kernel[:, 1::2]
    left, right = kernel.split(REDUCED_CHANNELS, dim=1)
    return left, right


def _conv2d(
    weight: Tensor, bias: Tensor | None = None, *, padding: tuple[int, int], groups: int = 1
) -> nn.Conv2d:
    outputs, inputs, *size = weight.shape
    conv = nn.Conv2d(
        inputs * groups,
        outputs,
        cast(tuple[int, int], tuple(size)),
        padding=padding,
        groups=groups,
        bias=bias is not None,
        device=weight.device,
        dtype=weight.dtype,
    )
    conv.load_state_dict({"weight": weight} | ({} if bias is None else {"bias": bias}))
    return conv


def _steps(conv: nn.Conv3d, steps: int) -> nn.Sequential:
    """A 3D convolution whose stride is its depth, and ReLU, on channels ordered by depth."""
    weight = conv.weight.transpose(1, 2).flatten(1, 2).repeat(steps, 1, 1, 1)
    assert conv.bias is not None
    bias = conv.bias.repeat(steps)
    return nn.Sequential(_conv2d(weight, bias, padding=(1, 1), groups=steps), nn.ReLU(inplace=True))


class StackedPlanes(nn.Module):
    """The volume of a planewise cost volume, in the memory order of the encoder.

    With ``columns_first`` that is by columns, disparities and rows, else by disparities, rows and
    columns.
    """

    def __init__(self, volume: PlanewiseLearnedVolume, *, columns_first: bool) -> None:
        super().__init__()
        self.volume = volume
        self.columns_first = columns_first

    def forward(self, left: Tensor, right: Tensor, planes: int) -> Tensor:
        """(B, 32, H, W) twice -> (B, 1, D, H, W), D being ``planes``."""
        batch, _, height, width = left.shape
        if self.columns_first:
            result = left.new_empty(batch, 1, width, planes, height).permute(0, 1, 3, 4, 2)
        else:
            result = left.new_empty(batch, 1, planes, height, width)
        for index, plane in enumerate(self.volume(left, right, planes)):
            result[:, :, index] = plane
        return result
