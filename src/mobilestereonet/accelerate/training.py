"""The form of a network for training: quicker steps on the same parameters."""

from __future__ import annotations

import torch
from torch import nn
from torch.nn.utils import (
    convert_conv2d_weight_memory_format,
    convert_conv3d_weight_memory_format,
)

from mobilestereonet.accelerate.batched import BatchedLearnedVolume, BatchedMobileStereoNet
from mobilestereonet.accelerate.correlation import correlate_by_products
from mobilestereonet.accelerate.depthwise import fast_depthwise, has_triton
from mobilestereonet.accelerate.group_correlation import BatchedCorrelation
from mobilestereonet.accelerate.guided import aggregate_in_lines
from mobilestereonet.accelerate.modules import replace_modules, sharing_copy
from mobilestereonet.accelerate.norm_activation import fuse_activations
from mobilestereonet.accelerate.soft_argmax import use_closed_form
from mobilestereonet.nets.cost_volumes import Correlation, LearnedVolume
from mobilestereonet.nets.model import StereoModel
from mobilestereonet.nets.msnet import MobileStereoNet


def training_form(net: StereoModel) -> StereoModel:
    """A network with the parameters and buffers of another, which takes quicker training steps.

    Make it where the network is to be trained, and in its dtype: moving or converting one of the
    two afterwards ends the sharing, as does ``load_state_dict(assign=True)``; modes (``train``,
    ``eval``) are each one's own. Gradients are exact. In training mode batch norms see both views
    and all disparities at once (`accelerate.batched`); in eval mode the results are the same.

    Args:
        net: The network; the layout of its weights in memory becomes channels last.
    """
    fast = sharing_copy(net)
    # Several times faster on a CPU.
    convert_conv2d_weight_memory_format(fast, torch.channels_last)
    convert_conv3d_weight_memory_format(fast, torch.channels_last_3d)
    use_closed_form(fast)
    aggregate_in_lines(fast)
    correlate_by_products(fast)
    replace_modules(fast, LearnedVolume, BatchedLearnedVolume)
    replace_modules(fast, Correlation, BatchedCorrelation)
    fast_depthwise(fast)
    if _runs_triton(fast):
        fuse_activations(fast)
    return BatchedMobileStereoNet(fast) if type(fast) is MobileStereoNet else fast


def _runs_triton(net: nn.Module) -> bool:
    parameter = next(net.parameters(), None)
    return (
        parameter is not None
        and parameter.is_cuda
        and parameter.dtype == torch.float32
        and has_triton()
    )
