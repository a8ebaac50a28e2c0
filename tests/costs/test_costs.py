"""Counts against the paper's figures, counts by hand, PyTorch's FLOP counter and ptflops."""

import json
import math

import pytest
import torch
from ptflops import get_model_complexity_info
from torch import nn
from torch.utils.flop_counter import FlopCounterMode

from extras import SHARED, needs_shared
from mobilestereonet.costs import Cost, count_costs
from mobilestereonet.costs.count import layer_macs
from mobilestereonet.errors import InputError
from mobilestereonet.nets import build_model

SIZES = {
    "msnet2d": (32, 64),
    "msnet3d": (32, 64),
    "table3b-v1-v1": (32, 64),
    "table2-correlation": (32, 64),
    "table3a-conv-v2": (32, 64),
    "psmnet": (256, 256),
}


@pytest.fixture(params=SIZES)
def net_and_view(request):
    """A network and a view without values."""
    with torch.device("meta"):
        return build_model(request.param).eval(), torch.empty(1, 3, *SIZES[request.param])


@pytest.mark.parametrize(
    ("model", "macs", "paper_macs", "params", "paper_params"),
    [
        ("msnet2d", 29.798, 32.204, 2.352706, 2.23),
        ("msnet3d", 64.673, 153.141, 1.855608, 1.77),
        ("msnet3d-authors", 64.673, 153.141, 1.855608, 1.77),
        ("psmnet", 184.695, 256.659, 5.224768, 5.22),
        ("baseline2d", None, 74.418, None, 4.072),
        ("baseline3d", None, 155.196, None, 4.208),
    ],
)
def test_totals_at_256_x_512(model, macs, paper_macs, params, paper_params):
    total = count_costs(model)["total"]
    assert total.paper_macs / 1e9 == pytest.approx(paper_macs, abs=0.0006)
    assert total.paper_params / 1e6 == pytest.approx(paper_params, abs=0.005)
    if macs:
        assert total.macs / 1e9 == pytest.approx(macs, abs=0.0006)
        assert total.params == params * 1e6


def test_full_width_planes_would_cost_more():
    costs = count_costs("msnet2d")
    cropped = sum(128 - i for i in range(48))
    more = 48 * 128 / cropped - 1
    total, volume = costs["total"], costs["volume"]
    assert total.macs + more * volume.macs == pytest.approx(33.791e9, abs=0.6e6)
    assert total.paper_macs + more * volume.paper_macs == pytest.approx(36.258e9, abs=0.6e6)


@needs_shared
@pytest.mark.parametrize("model", ["msnet2d", "msnet3d"])
def test_parameters_are_those_of_the_released_weights(model):
    shapes = json.loads((SHARED / "parity" / f"{model}.json").read_text())
    weights = {k: shape for k, shape in shapes.items() if k.endswith(("weight", "bias"))}
    total = count_costs(model)["total"]
    assert total.params == sum(math.prod(shape) for shape in weights.values())
    called = {k: shape for k, shape in weights.items() if not k.startswith("classif")}
    last = {k: shape for k, shape in weights.items() if k.startswith("classif3")}
    assert total.paper_params == sum(math.prod(s) for s in [*called.values(), *last.values()])


def test_exact_macs_are_those_of_pytorchs_counter(net_and_view):
    net, view = net_and_view
    with torch.no_grad(), FlopCounterMode(display=False) as counter:
        net(view, view)
    assert 2 * count_costs(net, *view.shape[2:])["total"].macs == counter.get_total_flops()


def test_the_papers_count_is_that_of_ptflops(net_and_view):
    net, view = net_and_view
    with torch.no_grad():
        macs, _ = get_model_complexity_info(
            net,
            tuple(view.shape[1:]),
            as_strings=False,
            print_per_layer_stat=False,
            backend="pytorch",
            input_constructor=lambda _: {"left": view, "right": view},
            backend_specific_config={"count_functional": False},
        )
    assert count_costs(net, *view.shape[2:])["total"].paper_macs == macs


def test_layers_by_hand():
    x = torch.empty(1, 4, 6, 10)
    convolution = nn.Conv2d(4, 8, 3, stride=2, padding=1, groups=2)
    y = torch.empty(1, 8, 3, 5)
    assert layer_macs(convolution, x, y) == (8 * 15 * 9 * 2, 8 * 15 * 9 * 2 + 8 * 15)
    norm, relu = nn.BatchNorm2d(8), nn.ReLU6()
    assert layer_macs(norm, y, y) == (0, 240)
    assert layer_macs(relu, y, y) == (0, 120)
    assert layer_macs(nn.LeakyReLU(), y, y) == (0, 120)
    assert layer_macs(nn.GroupNorm(2, 8, affine=False), y, y) == (0, 120)
    assert layer_macs(nn.AvgPool2d(2), torch.empty(1, 2, 4, 4), torch.empty(1, 2, 2, 2)) == (0, 32)
    assert layer_macs(nn.Linear(5, 3), torch.empty(2, 5), torch.empty(2, 3)) == (30, 36)
    up = nn.ConvTranspose3d(6, 2, 3, stride=2, padding=1, output_padding=1, bias=False)
    x, y = torch.empty(1, 6, 1, 2, 3), torch.empty(1, 2, 2, 4, 6)
    exact = 6 * 6 * 27 * 2  # values of 6 channels, each times 27 weights for each of 2 channels
    assert layer_macs(up, x, y) == (exact, 8 * exact)


def test_parts_of_a_small_network_by_hand():
    """msnet2d's parts at 32 x 64: 8 x 16 at a quarter, 2 x 4 at a sixteenth."""
    costs = count_costs("msnet2d", height=32, width=64)

    positions = 2 * 8 * 16
    products = 320 * 256 + 256 * 128 + 128 * 64 + 64 * 32
    extra = 3 * (256 + 128 + 64) + 32  # norm and ReLU, then one bias
    params = products + 2 * (256 + 128 + 64) + 32
    assert costs["reduction"] == Cost(
        positions * products, positions * (products + extra), params, params
    )

    columns = 8 * sum(range(1, 17))  # planes 0 .. 15 have 16 .. 1 columns, the others none
    products = 16 * 8 * (8 * 9) + 32 * 2 * (4 * 9 * 16) + 16 * (2 * 9 * 32) + 16
    elements = 16 * 8 + 32 * 2 + 16  # each with a bias, a norm and a ReLU
    params = 16 * 72 + 32 * 576 + 16 * 576 + 16 + 3 * (16 + 32 + 16) + 2
    assert costs["volume"] == Cost(
        columns * products, columns * (products + 4 * elements + 3), params, params
    )

    products = 48 * 48 * 9 * 2
    params = products + 2 * 48
    assert costs["heads"] == Cost(128 * products, 128 * (products + 3 * 48), 4 * params, params)


def test_cost_grows_with_the_image_alone_in_3d():
    small, large = (count_costs("msnet3d", 64, w)["total"] for w in (128, 256))
    assert (2 * small.macs, 2 * small.paper_macs) == (large.macs, large.paper_macs)
    assert small.params == large.params


def test_a_coarse_pass_is_a_pass_at_half_of_the_size():
    whole = count_costs("msnet3d", 64, 128, {"coarse_pass": True})["total"]
    fine = count_costs("msnet3d", 64, 128)["total"]
    half = count_costs("msnet3d", 32, 64, {"max_disparity": 96})["total"]
    guide = 27 * 32 * 48 * 16 * 32  # one channel to 32 over (48, 16, 32)
    assert whole.macs == fine.macs + half.macs + guide
    assert whole.params == fine.params + 27 * 32


def test_a_cascade_is_a_coarse_pass_and_a_band_of_planes():
    settings = {"hourglasses": 1, "coarse_hourglasses": 1, "band": 16}
    cascade = count_costs("msnet3d-cascade", 64, 128, settings)["total"]
    passes = {"hourglasses": 1, "coarse_pass": True, "coarse_levels": 2}
    whole = count_costs("msnet3d", 64, 128, passes)["total"]
    planes = {"hourglasses": 1, "max_disparity": 128}
    all_planes = count_costs("msnet3d", 64, 128, planes)["total"]
    half_of_them = count_costs("msnet3d", 64, 128, {**planes, "max_disparity": 64})["total"]
    per_16_planes = all_planes.macs - half_of_them.macs + 27 * 32 * 16 * 16 * 32
    assert whole.macs - cascade.macs == pytest.approx(2 * per_16_planes, rel=0.03)
    parts = ("pre_hourglass", "hourglasses", "heads")
    twice = count_costs("msnet3d", 64, 128, {"hourglasses": 1})
    guide = 27 * 32
    assert cascade.params == whole.params + guide + sum(twice[part].params for part in parts)


def test_a_network_stays_as_it_is():
    net = build_model("table2-correlation")
    before = count_costs(net, 64, 128)
    assert before == count_costs("table2-correlation", 64, 128)
    assert net.training and not any(parameter.is_meta for parameter in net.parameters())
    assert count_costs(net, 64, 128) == before
    with pytest.raises(InputError, match="groups: a network has its config"):
        count_costs(net, 64, 128, {"groups": 16})


@pytest.mark.parametrize("size", [(100, 128), (64, 0), (64, -16)])
def test_refuses_a_size(size):
    with pytest.raises(InputError, match=r"multiple of 16, got (100|0|-16)"):
        count_costs("msnet2d", *size)


def test_a_networks_own_width_is_no_width_of_views():
    narrow = count_costs("msnet2d", 32, 64, {"width": 16})["total"]
    assert narrow.params < count_costs("msnet2d", 32, 64)["total"].params
