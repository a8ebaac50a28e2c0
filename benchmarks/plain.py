"""The yardstick: a network computed plainly, in the authors' formulation.

Views one after the other, a loop over the disparities of the cost volume on the cropped pair,
batch norms on their own, scores upsampled to (max_disparity, H, W) before the softmax.
"""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from mobilestereonet.nets import StereoNet
from mobilestereonet.nets.cost_volumes import LearnedVolume


class PlainNet(nn.Module):
    """`StereoNet` without any acceleration: the same weights, in eval mode the same result."""

    def __init__(self, net: StereoNet) -> None:
        super().__init__()
        self.net = net

    def forward(self, left: Tensor, right: Tensor) -> Tensor | list[Tensor]:
        net = self.net
        views = [net.reduction(net.features(view)) for view in (left, right)]
        volume = self._volume(*views)
        x = net.pre_hourglass(volume.flatten(1, 2) if net.config.dims == 2 else volume)
        stages = [x]
        for hourglass in net.hourglasses:
            stages.append(hourglass(stages[-1]))
        if self.training:
            heads = zip(net.heads, stages, strict=True)
            return [_expected_disparity(head(stage)) for head, stage in heads]
        return _expected_disparity(net.heads[-1](stages[-1]))

    def _volume(self, left: Tensor, right: Tensor) -> Tensor:
        batch, _, height, width = left.shape
        config = self.net.config
        volume = left.new_zeros(batch, config.volume_channels, config.planes, height, width)
        for i in range(min(config.planes, width)):
            volume[:, :, i, :, i:] = self._plane(left[..., i:], right[..., : width - i])
        return volume

    def _plane(self, left: Tensor, right: Tensor) -> Tensor:
        volume = self.net.volume
        if not isinstance(volume, LearnedVolume):
            return (left * right).unflatten(1, (volume.groups, -1)).mean(dim=2)
        if volume.interlaced:
            pair = torch.stack((left, right), dim=2).flatten(1, 2)
        else:
            pair = torch.cat((left, right), dim=1)
        x = pair[:, None]
        for conv, norm in zip(volume.conv, volume.norm, strict=True):
            x = F.relu(norm(conv(x)))
        return volume.squeeze(x.squeeze(2))


def _expected_disparity(scores: Tensor) -> Tensor:
    scores = F.interpolate(scores[:, None], scale_factor=4, mode="trilinear", align_corners=False)
    disparities = torch.arange(scores.shape[2], dtype=scores.dtype, device=scores.device)
    return (F.softmax(scores[:, 0], dim=1) * disparities[:, None, None]).sum(dim=1)
