"""GA-Net's guided layers: the fixtures of the authors' kernels, and the fast form, exact."""

from pathlib import Path

import numpy as np
import pytest
import torch

from mobilestereonet.accelerate import accelerate
from mobilestereonet.accelerate.guided import (
    LinewiseSemiGlobalAggregation,
    RowwiseLocalAggregation,
    local_aggregation,
    scan,
)
from mobilestereonet.errors import InputError
from mobilestereonet.nets import build_model
from mobilestereonet.nets.guided_aggregation import (
    DIRECTIONS,
    LocalAggregation,
    SemiGlobalAggregation,
    aggregate,
    aggregate_locally,
)

FIXTURE = {
    key: torch.from_numpy(value)
    for key, value in np.load(Path(__file__).parents[1] / "data/ganet_ops.npz").items()
}


def assert_same(found, expected):
    torch.testing.assert_close(found, expected, rtol=0, atol=1e-12)


@pytest.mark.parametrize("direction", DIRECTIONS)
def test_each_direction_equals_the_authors_kernel(direction):
    found = aggregate(FIXTURE["sga_x"], FIXTURE[f"sga_g_{direction}"], direction)
    assert_same(found, FIXTURE[f"sga_{direction}"])


@pytest.mark.parametrize("layer", [SemiGlobalAggregation(), LinewiseSemiGlobalAggregation()])
def test_semi_global_aggregation_equals_the_authors_kernels(layer):
    guidance = torch.cat([FIXTURE[f"sga_g_{name}"].flatten(1, 2) for name in DIRECTIONS], dim=1)
    assert_same(layer(FIXTURE["sga_x"], guidance), FIXTURE["sga_out"])


@pytest.mark.parametrize("layer", [LocalAggregation(), RowwiseLocalAggregation()])
def test_local_aggregation_equals_the_authors_kernels(layer):
    weights = torch.nn.functional.normalize(FIXTURE["lga_g"], p=1, dim=1)
    assert_same(layer.aggregate(FIXTURE["lga_x"], weights), FIXTURE["lga_once"])
    assert_same(layer(FIXTURE["lga_x"], FIXTURE["lga_g"]), FIXTURE["lga_twice"])


@pytest.mark.parametrize("depth", [2, 7])
@pytest.mark.parametrize(
    ("plain", "fast", "channels", "guides"),
    [
        (SemiGlobalAggregation(), LinewiseSemiGlobalAggregation(), (3,), 60),
        (LocalAggregation(), RowwiseLocalAggregation(), (), 75),
    ],
)
def test_gradients_of_the_fast_form(plain, fast, channels, guides, depth):
    torch.manual_seed(0)
    x = torch.randn(2, *channels, depth, 5, 6, dtype=torch.float64, requires_grad=True)
    guidance = torch.randn(2, guides, 5, 6, dtype=torch.float64, requires_grad=True)
    target = torch.randn_like(x)
    expected, found = (
        torch.autograd.grad((layer(x, guidance) * target).sum(), (x, guidance))
        for layer in (plain, fast)
    )
    for one, other in zip(found, expected, strict=True):
        assert_same(one, other)


def test_custom_operators_are_well_formed():
    def tensor(*shape):
        return torch.randn(shape, requires_grad=True)

    check = torch.library.opcheck
    check(scan, (tensor(4, 1, 2, 5, 3), tensor(4, 1, 2, 5, 3), True))
    check(local_aggregation, (tensor(2, 4, 5, 6), tensor(2, 75, 5, 6)))


def test_forms_of_the_network():
    torch.manual_seed(0)
    net = build_model("ganet-11", max_disparity=12).double().eval()
    left, right = torch.randn(2, 1, 3, 48, 48, dtype=torch.float64)
    with torch.no_grad():
        expected = net(left, right).disparity
        for purpose in ("inference", "training"):
            found = accelerate(net, purpose)
            assert any(type(m) is LinewiseSemiGlobalAggregation for m in found.modules())
            assert_same(found(left, right).disparity, expected)


def test_export_is_refused():
    net = build_model("ganet-11", max_disparity=12)
    with pytest.raises(InputError, match="GANet cannot be exported"):
        accelerate(net, "export")


def test_one_batch_in_blocks_is_the_whole(monkeypatch):
    monkeypatch.setattr("mobilestereonet.accelerate.guided._CACHED_ELEMENTS", 1)
    weights = torch.randn(2, 75, 5, 6, dtype=torch.float64)
    found = local_aggregation(FIXTURE["lga_x"], weights)
    assert_same(found, aggregate_locally(FIXTURE["lga_x"], weights))
