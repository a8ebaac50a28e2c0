"""Fast forms of networks that are not MobileStereoNets: exact, or left as they are."""

import copy
from dataclasses import dataclass
from types import SimpleNamespace

import pytest
import torch
import torch.nn.functional as F
from torch import nn
from torch.nn.utils.parametrizations import weight_norm

from mobilestereonet.accelerate import accelerate, semi_global
from mobilestereonet.accelerate.batched import _shifted_sums
from mobilestereonet.accelerate.correlation import BandedCorrelation1D, BandedCostSignatures
from mobilestereonet.accelerate.depthwise import depthwise_conv3d
from mobilestereonet.accelerate.group_correlation import group_means
from mobilestereonet.accelerate.soft_argmax import ClosedFormSoftArgmax, _soft_argmax
from mobilestereonet.errors import InputError
from mobilestereonet.nets import Prediction, StereoModel, build_model
from mobilestereonet.nets.cross_based import Penalties, SemiGlobalMatching
from mobilestereonet.nets.fast_ds_cs import CostSignatures
from mobilestereonet.nets.msnet import MobileStereoNet
from mobilestereonet.nets.msnet_config import NetConfig
from mobilestereonet.nets.operations import Correlation1D
from mobilestereonet.nets.soft_argmax import SoftArgmax
from small_views import for_small_views, with_statistics


@dataclass(frozen=True)
class Config:
    max_disparity: int = 32


class Wrapped(StereoModel):
    """Regresses from one view with whatever layers it is given."""

    def __init__(self, layers, run=None):
        super().__init__(Config())
        self.layers = layers
        self.run = run or (lambda net, x: net.layers(x))

    def forward(self, left, right):
        y = self.run(self, left)
        disparity = y.flatten(1, y.ndim - 3).mean(dim=1)
        return Prediction(disparity) if not self.training else SimpleNamespace(disparity=disparity)


class Standardised(nn.Conv2d):
    def forward(self, x):
        weight = self.weight - self.weight.mean(dim=(1, 2, 3), keepdim=True)
        return F.conv2d(x, weight, self.bias, padding=self.padding)


class Residual(nn.Sequential):
    def forward(self, x):
        return self[1](self[0](x) + x)


class Warm(SoftArgmax):
    def forward(self, scores):
        return super().forward(scores / 3)


def conv(*arguments, **options):
    return nn.Conv2d(*arguments, padding=options.pop("padding", 1), bias=False, **options)


def taps(net, x):
    """Slices of one sequence, as feature pyramids take them."""
    return net.layers[3:](net.layers[:3](x))


def volume(net, x):
    return net.layers(x.unsqueeze(2).expand(-1, -1, 5, -1, -1))


def depthwise(step, **options):
    return nn.Conv2d(3, 3, 3, padding=step, dilation=step, groups=3, bias=False, **options)


NETWORKS = {
    "plain": Wrapped(nn.Sequential(conv(3, 8, 3), nn.BatchNorm2d(8), nn.ReLU(), conv(8, 4, 3))),
    "subclass": Wrapped(nn.Sequential(Standardised(3, 8, 3, padding=1), nn.BatchNorm2d(8))),
    "reflected": Wrapped(nn.Sequential(conv(3, 8, 3, padding_mode="reflect"), nn.ReLU())),
    "same": Wrapped(nn.Sequential(conv(3, 8, 3, padding="same"), nn.ReLU())),
    "slices": Wrapped(
        nn.Sequential(conv(3, 8, 3), nn.BatchNorm2d(8), nn.ReLU(), conv(8, 4, 3), nn.ReLU()), taps
    ),
    "residual": Wrapped(Residual(conv(3, 3, 3), nn.BatchNorm2d(3))),
    "transposed in groups": Wrapped(
        nn.Sequential(nn.ConvTranspose2d(3, 6, 3, padding=1, groups=3), nn.BatchNorm2d(6))
    ),
    "no statistics": Wrapped(
        nn.Sequential(conv(3, 4, 3), nn.BatchNorm2d(4, track_running_stats=False))
    ),
    "dilated": Wrapped(nn.Sequential(depthwise(2), nn.ReLU())),
    "dilation that does not divide": Wrapped(nn.Sequential(depthwise(5))),
    "dilated circular": Wrapped(nn.Sequential(depthwise(2, padding_mode="circular"))),
    "parametrised": Wrapped(nn.Sequential(weight_norm(depthwise(2)), nn.ReLU())),
    "3D": Wrapped(nn.Sequential(nn.Conv3d(3, 3, 3, padding=1, groups=3, bias=False)), volume),
    "3D strided, circular": Wrapped(
        nn.Sequential(nn.Conv3d(3, 3, 3, padding=1, groups=3, bias=False, padding_mode="circular")),
        volume,
    ),
    "without parameters": Wrapped(nn.Sequential(nn.ReLU())),
    "scores of its own": Wrapped(nn.Sequential(Warm(4)), lambda net, x: net.layers(4 * x)[:, None]),
}


def random_statistics(net):
    torch.manual_seed(0)
    for module in net.modules():
        if isinstance(module, nn.BatchNorm2d) and module.running_mean is not None:
            module.running_mean.normal_()
            module.running_var.uniform_(0.5, 2)
            nn.init.normal_(module.bias)
    return net


@pytest.mark.parametrize("name", NETWORKS)
def test_every_form_is_exact(name):
    net = random_statistics(copy.deepcopy(NETWORKS[name])).double().eval()
    left, right = torch.randn(2, 1, 3, 32, 48, dtype=torch.float64)
    with torch.no_grad():
        expected = net(left, right).disparity
        found = [accelerate(net, purpose)(left, right) for purpose in ("inference", "training")]
        graph = accelerate(net, "export")(left, right)
    for disparity in (found[0].disparity, found[1].disparity, graph):
        torch.testing.assert_close(disparity, expected, rtol=0, atol=1e-9)


@pytest.mark.parametrize("name", ["deeppruner-best", "deeppruner-fast"])
def test_forms_of_deeppruner(name):
    torch.manual_seed(0)
    views = torch.randn(2, 1, 3, 64, 64, dtype=torch.float64)
    net = with_statistics(for_small_views(build_model(name)).double(), *views)
    with torch.no_grad():
        expected = net(*views).disparity
        for purpose in ("inference", "training"):
            found = accelerate(net, purpose)(*views).disparity
            torch.testing.assert_close(found, expected, rtol=0, atol=1e-9)


@pytest.mark.parametrize("name", NETWORKS)
def test_gradients_of_the_form_for_training(name):
    net = random_statistics(copy.deepcopy(NETWORKS[name])).double().train()
    fast = accelerate(net, "training")
    assert fast.state_dict().keys() == net.state_dict().keys()
    left = torch.randn(2, 3, 32, 48, dtype=torch.float64, requires_grad=True)
    inputs = (left, *net.parameters())
    for _ in range(2):  # graphs are made anew in each step
        grads = [
            torch.autograd.grad(form(left, left).disparity.square().sum(), inputs)
            for form in (net, fast)
        ]
        for expected, found in zip(*grads, strict=True):
            torch.testing.assert_close(found, expected, rtol=1e-9, atol=1e-9)


def test_hooked_layers_stay():
    net = Wrapped(nn.Sequential(conv(3, 8, 3), nn.BatchNorm2d(8), nn.ReLU())).eval()
    net.layers[0].register_forward_hook(lambda module, inputs, output: output + 1)
    random_statistics(net)
    left = torch.randn(1, 3, 16, 16)
    with torch.no_grad():
        expected = net(left, left).disparity
        for purpose in ("inference", "training"):
            found = accelerate(net, purpose)(left, left).disparity
            torch.testing.assert_close(found, expected, rtol=0, atol=1e-5)


def test_subclasses_of_the_papers_network_keep_what_they_change():
    class Biased(MobileStereoNet):
        def aggregate(self, volume, guidance=None):
            return [scores + self.bias for scores in super().aggregate(volume, guidance)]

    torch.manual_seed(0)
    net = Biased(NetConfig(dims=2, max_disparity=32, hourglasses=1)).eval()
    net.bias = nn.Parameter(torch.linspace(-5, 5, 8)[:, None, None])
    left, right = torch.randn(2, 1, 3, 32, 64)
    with torch.no_grad():
        net.heads[-1].score.weight /= 1000
        expected = net(left, right).disparity
        assert expected.mean() > 20
        for purpose in ("inference", "training"):
            found = accelerate(net, purpose)(left, right).disparity
            torch.testing.assert_close(found, expected, rtol=0, atol=1e-3)
        graph, _ = accelerate(net, "export")(left, right)
        torch.testing.assert_close(graph, expected, rtol=0, atol=1e-3)


@pytest.mark.parametrize(
    ("own", "wide"), [("float16", "float32"), ("float32", "float32"), ("float64", "float64")]
)
def test_the_form_for_export_is_wide(own, wide):
    net = build_model("msnet2d", max_disparity=32).to(getattr(torch, own))
    form = accelerate(net, "export")
    assert {weight.dtype for weight in form.parameters()} == {getattr(torch, wide)}
    assert {weight.dtype for weight in net.parameters()} == {getattr(torch, own)}
    assert net.training


def test_forms_of_forms_are_refused():
    fast = accelerate(build_model("msnet2d", max_disparity=32), "training")
    with pytest.raises(InputError, match="is its form for training: give the plain one"):
        accelerate(fast, "inference")
    with pytest.raises(InputError, match="not for 4 and aligned corners"):
        ClosedFormSoftArgmax(SoftArgmax(4, align_corners=True))


def test_closed_form_has_no_second_derivative():
    scores = torch.randn(1, 4, 2, 2, requires_grad=True)
    disparity = ClosedFormSoftArgmax(SoftArgmax(4))(scores).sum()
    with pytest.raises(RuntimeError, match="no second derivative"):
        torch.autograd.grad(disparity, scores, create_graph=True)


@pytest.mark.parametrize("channels_last", [False, True])
def test_custom_operators_are_well_formed(channels_last):
    def tensor(*shape):
        x = torch.randn(shape)
        if channels_last and x.ndim > 3:
            layout = torch.channels_last if x.ndim == 4 else torch.channels_last_3d
            x = x.contiguous(memory_format=layout)
        return x.requires_grad_()

    check = torch.library.opcheck
    check(depthwise_conv3d, (tensor(2, 8, 4, 5, 6), tensor(8, 1, 3, 3, 3), 2))
    for start in (None, torch.randint(0, 3, (2, 4, 9))):
        check(group_means, (tensor(2, 8, 4, 9), tensor(2, 8, 4, 9), start, 5, 4))
    check(_shifted_sums, (*(tensor(2, 6, 4, 9) for _ in range(4)), 5))
    check(_soft_argmax, (tensor(2, 6, 4, 9), True))


def assert_same(found, expected):
    torch.testing.assert_close(found, expected, rtol=0, atol=1e-12)


@pytest.mark.parametrize("width", [3, 17])
@pytest.mark.parametrize("lines", [1, 1 << 17])
def test_correlation_by_products(width, lines, monkeypatch):
    monkeypatch.setattr("mobilestereonet.accelerate.correlation._CACHED_ELEMENTS", lines)
    torch.manual_seed(0)
    views = torch.randn(2, 2, 5, 4, width, dtype=torch.float64, requires_grad=True)
    expected, found = (layer(*views) for layer in (Correlation1D(6), BandedCorrelation1D(6)))
    assert_same(found, expected)
    target = torch.randn_like(expected)
    grads = [torch.autograd.grad((x * target).sum(), views)[0] for x in (found, expected)]
    assert_same(*grads)


@pytest.mark.parametrize("width", [6, 20])
def test_cost_signatures_by_products(width):
    torch.manual_seed(0)
    left, right = torch.rand(2, 2, 3, 7, width, dtype=torch.float64)
    expected = CostSignatures(9)(left, right)
    assert_same(BandedCostSignatures(9)(left, right), expected)
    left.requires_grad_()
    assert_same(BandedCostSignatures(9)(left, right), expected)


@pytest.mark.parametrize("size", [(9, 20), (130, 7)])  # 2 x 130 is no uint8
@pytest.mark.parametrize("side", [-1, 1])
def test_semi_global_matching_in_blocks(size, side, monkeypatch):
    monkeypatch.setattr(semi_global, "_CACHED_ELEMENTS", 40)
    torch.manual_seed(0)
    volume = 5 * torch.rand(12, *size, dtype=torch.float64)
    for d in range(12):
        plane = volume[d].flip(1) if side > 0 else volume[d]
        plane = plane.index_fill(1, torch.arange(min(d, size[1])), torch.inf)
        volume[d] = plane.flip(1) if side > 0 else plane
    views = torch.randn(2, *size, dtype=torch.float64) / 10
    penalties = Penalties(2.3, 18.4, 3, 2, 1.25, 0.08)
    expected = SemiGlobalMatching(penalties)(volume, *views, side)
    assert_same(semi_global.BlockwiseMatching(penalties)(volume, *views, side), expected)


@pytest.mark.parametrize(
    ("name", "fields", "layer"),
    [
        ("dispnet-corr1d", {"width": 8}, BandedCorrelation1D),
        ("iresnet", {"width": 8}, BandedCorrelation1D),
        ("fast-ds-cs", {}, BandedCostSignatures),
        ("mccnn-fast", {"max_disparity": 16}, semi_global.BlockwiseMatching),
    ],
)
def test_networks_with_operations_of_their_own(name, fields, layer):
    torch.manual_seed(0)
    net = build_model(name, **fields).double().eval()
    left, right = torch.rand(2, 1, 3, 64, 128, dtype=torch.float64)
    fast = accelerate(net, "inference")
    assert any(type(module) is layer for module in fast.modules())
    with torch.no_grad():
        expected = net(left, right).disparity
        found = fast(left, right).disparity
    torch.testing.assert_close(found, expected, rtol=0, atol=1e-6)
