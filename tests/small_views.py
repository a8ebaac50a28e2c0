"""Networks with a pooling pyramid on views smaller than its windows."""

import torch
from torch import nn


def for_small_views(net):
    """A network whose pyramid has windows of at most 4 px from now on: views of 64 px suffice."""
    net.min_side = 64
    for pool in net.features.pools:
        pool.kernel_size = pool.stride = min(pool.kernel_size, 4)
    return net


def with_statistics(net, left, right):
    """A fresh network in eval mode whose norms have the statistics of a batch of pairs."""
    for module in net.modules():
        if isinstance(module, nn.BatchNorm2d | nn.BatchNorm3d):
            module.momentum = 1.0
    with torch.no_grad():
        net.train()(left, right)
    return net.eval()
