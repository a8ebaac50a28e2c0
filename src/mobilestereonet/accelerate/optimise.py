"""Exact acceleration: rewritings of a network in eval mode that keep its result.

Each takes a `StereoNet` with any weights and changes it in place; `optimise` does all of them to
a copy. What is left is for inference on a CPU: it has no training mode.
"""

from __future__ import annotations

import copy
from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn.utils import (
    convert_conv2d_weight_memory_format,
    convert_conv3d_weight_memory_format,
    fuse_conv_bn_eval,
)

from mobilestereonet.accelerate.fused import (
    FusedConv,
    FusedHourglass,
    FusedPreHourglass,
    FusedResidualBlock,
    SlicedHead,
    SlicedV2Block,
    activation_name,
)
from mobilestereonet.accelerate.planewise import (
    Collected,
    PlanewiseCorrelation,
    PlanewiseLearnedVolume,
)
from mobilestereonet.errors import InputError
from mobilestereonet.nets import StereoNet
from mobilestereonet.nets.blocks import V2Block
from mobilestereonet.nets.cost_volumes import LearnedVolume
from mobilestereonet.nets.features import ResidualBlock
from mobilestereonet.nets.hourglass import Head, Hourglass, PreHourglass


def fold_norms(net: nn.Module) -> None:
    """Batch norms become part of the weights and biases of the convolutions before them.

    Raises:
        InputError: If the network is in training mode, in which norms take statistics.
    """
    if net.training:
        raise InputError("batch norms can only be folded in eval mode: call net.eval() first")
    for module in list(net.modules()):
        if isinstance(module, nn.Sequential):
            for index in reversed(range(1, len(module))):
                if isinstance(module[index], nn.BatchNorm2d | nn.BatchNorm3d):
                    module[index - 1] = _folded(module[index - 1], module[index])
                    del module[index]
        elif isinstance(module, LearnedVolume):
            for index, (conv, norm) in enumerate(zip(module.conv, module.norm, strict=True)):
                module.conv[index] = _folded(conv, norm)
                module.norm[index] = nn.Identity()


def _folded(conv: Any, norm: Any) -> nn.Module:
    transposed = isinstance(conv, nn.ConvTranspose2d | nn.ConvTranspose3d)
    folded: nn.Module = fuse_conv_bn_eval(conv, norm, transpose=transposed)
    return folded


class OneByOne(nn.Sequential):
    """A chain of layers that takes the images of a batch one after the other."""

    def forward(self, images: Tensor) -> Tensor:
        """(B, 3, H, W) -> (B, C, H / 4, W / 4)."""
        results = []
        for image in images.split(1):
            for layer in self:
                image = layer(image)
            results.append(image)
        return torch.cat(results)


def images_one_by_one(net: StereoNet) -> None:
    """Features of one image at a time: half of the memory, in the same time."""
    net.add_module("features", OneByOne(net.features, net.reduction))
    net.reduction = nn.Identity()


def drop_training_heads(net: StereoNet) -> None:
    """The heads that only training calls."""
    net.heads = nn.ModuleList([*(nn.Identity() for _ in net.hourglasses), net.heads[-1]])


def volume_by_planes(net: StereoNet) -> None:
    """The cost volume plane by plane, in 2D convolutions. After `fold_norms`."""
    volume = net.volume
    planewise = (
        PlanewiseLearnedVolume(volume)
        if isinstance(volume, LearnedVolume)
        else PlanewiseCorrelation(volume)
    )
    net.add_module("volume", Collected(planewise, columns_first=net.config.dims == 3))


def columns_first(net: StereoNet) -> None:
    """A 3D encoder takes the volume as columns, disparities and rows, as which it lies in memory.

    Of views wider than high the plane of a column is the smallest, so that some fit into a cache.
    After `volume_by_planes` and `drop_training_heads`.
    """
    if net.config.dims == 2:
        return
    for module in net.modules():
        if isinstance(module, nn.Conv3d | nn.ConvTranspose3d):
            module.weight = nn.Parameter(module.weight.movedim(-1, 2), requires_grad=False)
    net.add_module("pre_hourglass", nn.Sequential(MoveAxis(-1, 2), net.pre_hourglass))
    net.heads[-1] = nn.Sequential(net.heads[-1], MoveAxis(1, -1))
    if net.config.coarse_pass:
        net.add_module("guide", nn.Sequential(MoveAxis(-1, 2), net.guide))


class MoveAxis(nn.Module):
    """`torch.movedim` as a layer."""

    def __init__(self, source: int, destination: int) -> None:
        super().__init__()
        self.source, self.destination = source, destination

    def forward(self, x: Tensor) -> Tensor:
        """A view of ``x``."""
        return x.movedim(self.source, self.destination)


def slice_blocks(net: StereoNet) -> None:
    """v2 blocks and 3D heads by rows. After `fold_norms`, before `fuse_convolutions`."""
    _replace(net, V2Block, SlicedV2Block)
    _replace(net, Head, lambda head: SlicedHead(head) if head.dims == 3 else head)


def fuse_convolutions(net: StereoNet) -> None:
    """Convolutions and v2 blocks do the activation after them in the same pass.

    Residual blocks, pre-hourglass and hourglasses take their sums without another tensor. After
    `fold_norms` and `slice_blocks`.
    """
    for layers in [module for module in net.modules() if isinstance(module, nn.Sequential)]:
        for index in reversed(range(len(layers))):
            layer = layers[index]
            if isinstance(layer, nn.Conv2d | nn.Conv3d):
                layers[index] = layer = FusedConv(layer)
            last = layer.project if isinstance(layer, SlicedV2Block) else layer
            name = activation_name(layers[index + 1]) if index + 1 < len(layers) else "none"
            if isinstance(last, FusedConv) and name != "none":
                last.activation = name
                del layers[index + 1]
    _replace(net, ResidualBlock, FusedResidualBlock)
    _replace(net, PreHourglass, FusedPreHourglass)
    _replace(net, Hourglass, FusedHourglass)


def _replace(net: nn.Module, kind: type, replacement: Callable[[Any], nn.Module]) -> None:
    for module in list(net.modules()):
        for name, child in list(module.named_children()):
            if isinstance(child, kind):
                setattr(module, name, replacement(child))


def weights_channels_last(net: nn.Module) -> None:
    """Weights of convolutions in the memory format in which most layers run fastest."""
    convert_conv2d_weight_memory_format(net, torch.channels_last)
    convert_conv3d_weight_memory_format(net, torch.channels_last_3d)


def optimise(net: StereoNet) -> StereoNet:
    """A copy of a network, in eval mode, with all of the above.

    Weights and inputs may be of any floating-point type. On inputs in channels last, oneDNN runs
    float32 and, where the processor has it, bfloat16; PyTorch's own layers run the rest.
    """
    net = copy.deepcopy(net).eval().requires_grad_(False)
    fold_norms(net)
    images_one_by_one(net)
    drop_training_heads(net)
    volume_by_planes(net)
    columns_first(net)
    slice_blocks(net)
    fuse_convolutions(net)
    weights_channels_last(net)
    return net
