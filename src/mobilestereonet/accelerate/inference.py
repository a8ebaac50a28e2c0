"""The form of a network for inference: rewritings in eval mode that keep its result.

What is left has no training mode. See ``docs/how-it-works.md``, "Exact accelerations".
"""

from __future__ import annotations

from functools import partial
from typing import cast

import torch
from torch import Tensor, nn
from torch.nn.utils import (
    convert_conv2d_weight_memory_format,
    convert_conv3d_weight_memory_format,
)

from mobilestereonet.accelerate.correlation import (
    correlate_by_products,
    count_bits_by_products,
)
from mobilestereonet.accelerate.fused import fuse_convolutions
from mobilestereonet.accelerate.group_correlation import StackedCorrelation
from mobilestereonet.accelerate.guided import aggregate_in_lines
from mobilestereonet.accelerate.modules import device_of, inference_copy, replace_modules
from mobilestereonet.accelerate.norms import fold_norms
from mobilestereonet.accelerate.onednn import FusedConv
from mobilestereonet.accelerate.planewise import (
    PlanewiseLearnedVolume,
    StackedPlanes,
)
from mobilestereonet.accelerate.rows import process_by_rows
from mobilestereonet.accelerate.semi_global import match_in_blocks
from mobilestereonet.accelerate.soft_argmax import use_closed_form
from mobilestereonet.nets.coarse_pass import Guide
from mobilestereonet.nets.cost_volumes import Correlation, LearnedVolume
from mobilestereonet.nets.model import StereoModel
from mobilestereonet.nets.msnet import SMALL_VIEW_PIXELS, MobileStereoNet


def inference_form(net: StereoModel) -> StereoModel:
    """A copy in eval mode, rewritten for the device on which the network is.

    Weights may be of any floating-point type, and be converted to another one afterwards. On a
    CPU, on inputs in channels last, oneDNN runs float32 and, where the processor has it, bfloat16;
    PyTorch's own layers run the rest. On a GPU the batch norms are folded and the soft-argmax is
    in closed form; PyTorch's own layers run it.
    """
    on_cpu = device_of(net).type == "cpu"
    net = inference_copy(net)
    fold_norms(net)
    use_closed_form(net)
    aggregate_in_lines(net)
    correlate_by_products(net)
    count_bits_by_products(net)
    match_in_blocks(net)
    if on_cpu:
        if type(net) is MobileStereoNet:
            few_images_at_a_time(net)
            drop_training_heads(net)
            volume_by_planes(net)
            columns_first(net)
            process_by_rows(net)
        replace_modules(net, Correlation, partial(StackedCorrelation, columns_first=False))
        fuse_convolutions(net)
        convert_conv3d_weight_memory_format(net, torch.channels_last_3d)
    # With 3D convolutions in channels last a GPU was slower than with the plain formulation.
    convert_conv2d_weight_memory_format(net, torch.channels_last)
    return net.eval().requires_grad_(False)


class FewImagesSequential(nn.Sequential):
    """A chain of layers that takes some small images of a batch at a time, large ones singly."""

    def forward(self, images: Tensor) -> Tensor:
        """(B, 3, H, W) -> (B, C, H / 4, W / 4)."""
        forward = super().forward
        together = max(1, 2 * SMALL_VIEW_PIXELS // images.shape[-2:].numel())
        return torch.cat([cast(Tensor, forward(few)) for few in images.split(together)])  # type: ignore[no-untyped-call]


def few_images_at_a_time(net: MobileStereoNet) -> None:
    """Extract features from large images of a batch singly: less memory, in the same time."""
    net.add_module("features", FewImagesSequential(net.features, net.reduction))
    net.reduction = nn.Identity()


def drop_training_heads(net: MobileStereoNet) -> None:
    """Replace the heads that only training calls by identities."""
    for part in {net, net.coarse_part}:
        for index in range(len(part.hourglasses)):
            part.heads[index] = nn.Identity()


def volume_by_planes(net: MobileStereoNet) -> None:
    """Compute the cost volume in parts that stay in a cache. After `fold_norms`."""
    in_columns = net.config.dims == 3
    replace_modules(
        net,
        LearnedVolume,
        lambda volume: StackedPlanes(PlanewiseLearnedVolume(volume), columns_first=in_columns),
    )
    replace_modules(
        net,
        Correlation,
        partial(StackedCorrelation, columns_first=in_columns),
    )


def columns_first(net: MobileStereoNet) -> None:
    """Run a 3D encoder on the transposed volume: columns, disparities, rows.

    That is its order in memory. Of views wider than high the plane of a column is the smallest, so
    that some fit into a cache. After `volume_by_planes` and `drop_training_heads`.
    """
    if net.config.dims == 2:
        return
    for module in net.modules():
        if isinstance(module, nn.Conv3d | nn.ConvTranspose3d):
            module.weight = nn.Parameter(module.weight.movedim(-1, 2), requires_grad=False)
    for part in {net, net.coarse_part}:
        part.pre_hourglass = nn.Sequential(MoveAxis(-1, 2), part.pre_hourglass)
        part.heads[-1] = nn.Sequential(part.heads[-1], MoveAxis(1, -1))
    replace_modules(net, Guide, ColumnGuide)


class MoveAxis(nn.Module):
    """`torch.movedim` as a layer."""

    def __init__(self, source: int, destination: int) -> None:
        super().__init__()
        self.source, self.destination = source, destination

    def forward(self, x: Tensor) -> Tensor:
        """A view of ``x``."""
        return x.movedim(self.source, self.destination)


class ColumnGuide(nn.Module):
    """`Guide` on columns first: convolution and sum in one pass."""

    def __init__(self, guide: nn.Conv3d) -> None:
        super().__init__()
        self.conv = FusedConv(guide_convolution(guide))

    def forward(self, x: Tensor, guidance: Tensor) -> Tensor:
        """(B, width, W, D, H) and guidance (B, D, H, W) -> (B, width, W, D, H)."""
        return cast(Tensor, self.conv(guidance.unsqueeze(1).movedim(-1, 2), x))


def guide_convolution(guide: nn.Conv3d) -> nn.Conv3d:
    """The convolution of a `Guide`, without its sum."""
    conv = nn.Conv3d(1, guide.out_channels, 3, padding=1, bias=False, device="meta")
    conv.weight = guide.weight
    return conv
