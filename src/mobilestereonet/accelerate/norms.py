"""Batch norms folded into the convolutions before them.

In eval mode a batch norm is an affine map per channel, y = (x - mean) * weight / sqrt(var + eps)
+ bias: it scales the kernels of the convolution before it and becomes its bias. Worked example:
``docs/how-it-works.md``, "Exact accelerations", folded norms.
"""

from __future__ import annotations

from typing import Any

from torch import nn
from torch.nn.utils import fuse_conv_bn_eval

from mobilestereonet.accelerate.modules import is_plain
from mobilestereonet.errors import InputError
from mobilestereonet.nets.cost_volumes import LearnedVolume

_CONVOLUTIONS = (nn.Conv2d, nn.Conv3d, nn.ConvTranspose2d, nn.ConvTranspose3d)
_NORMS = (nn.BatchNorm2d, nn.BatchNorm3d)


def fold_norms(net: nn.Module) -> None:
    """Fold each batch norm that follows a convolution in a sequence; an identity takes its place.

    Raises:
        InputError: If the network is in training mode, in which norms take statistics.
    """
    if net.training:
        raise InputError("batch norms can only be folded in eval mode: call net.eval() first")
    module: Any
    for module in list(net.modules()):
        if is_plain(module, nn.Sequential):
            for index in reversed(range(1, len(module))):
                before, norm = module[index - 1], module[index]
                if _foldable(before, norm):
                    module[index - 1] = _folded(before, norm)
                    module[index] = nn.Identity()
        elif is_plain(module, LearnedVolume):
            for index, (conv, norm) in enumerate(zip(module.conv, module.norm, strict=True)):
                module.conv[index] = _folded(conv, norm)
                module.norm[index] = nn.Identity()


def _foldable(conv: Any, norm: Any) -> bool:
    transposed = isinstance(conv, nn.ConvTranspose2d | nn.ConvTranspose3d)
    return (
        is_plain(norm, _NORMS)
        and norm.running_mean is not None
        and is_plain(conv, _CONVOLUTIONS)
        and not (transposed and conv.groups > 1)  # PyTorch's folding mixes the groups up
    )


def _folded(conv: Any, norm: Any) -> nn.Module:
    transposed = isinstance(conv, nn.ConvTranspose2d | nn.ConvTranspose3d)
    folded: nn.Module = fuse_conv_bn_eval(conv, norm, transpose=transposed)
    return folded
