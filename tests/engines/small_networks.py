"""Small networks: one with scores, one without, and the paper's."""

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import nn

from mobilestereonet.nets import build_model
from mobilestereonet.nets.model import Prediction, StereoModel
from mobilestereonet.nets.operations import cost_volume
from mobilestereonet.nets.soft_argmax import SoftArgmax
from mobilestereonet.nets.volume_model import VolumeModel


@dataclass(frozen=True)
class Config:
    max_disparity: int = 32


class Scoring(VolumeModel):
    """Correlation of features at a quarter of the resolution."""

    def __init__(self):
        super().__init__(Config())
        self.regression = SoftArgmax(scale=4)
        self.features = nn.Conv2d(3, 8, 4, stride=4)

    def scores(self, left, right):
        self.check_views(left, right)
        planes = self.max_disparity // 4
        left, right = self.features(left), self.features(right)
        compare = lambda a, b: (a * b).mean(dim=1, keepdim=True)  # noqa: E731
        return cost_volume(compare, left, right, planes)[:, 0]


class Direct(StereoModel):
    """A disparity straight from a convolution, with sizes of its input in its graph."""

    size_multiple = 8

    def __init__(self):
        super().__init__(Config())
        self.conv = nn.Conv2d(6, 4, 3, stride=2, padding=1)
        self.last = nn.Conv2d(4, 1, 3, padding=1)

    def forward(self, left, right):
        self.check_views(left, right)
        x = F.relu(self.conv(torch.cat((left, right), dim=1)))
        pooled = F.adaptive_avg_pool2d(x, 2)
        x = x + F.interpolate(pooled, size=x.shape[-2:], mode="bilinear")
        x = F.interpolate(self.last(x), size=left.shape[-2:], mode="bilinear")
        return Prediction(10 + x.squeeze(1))


def make(kind):
    torch.manual_seed(0)
    return kind().eval()


def make_msnet(name="msnet2d", **options):
    """A small network of the paper whose batch norms do something."""
    torch.manual_seed(0)
    small = {"max_disparity": 32, "hourglasses": 1, "width": 8}
    net = build_model(name, **{**small, **options}).eval()
    net.zero_residuals()  # fresh weights would amplify rounding
    with torch.no_grad():
        for module in net.modules():
            if isinstance(module, nn.BatchNorm2d | nn.BatchNorm3d):
                module.bias.normal_(0, 0.1)
                module.running_mean.normal_(0, 0.1)
                module.running_var.uniform_(0.5, 1.5)
        if net.config.coarse_pass:
            net.guide.weight.normal_()
    return net
