"""DeepPruner by properties of its own: nothing that the authors' code gave is here."""

import hashlib
import json
from dataclasses import replace

import pytest
import torch

from extras import SHARED, needs_shared
from mobilestereonet.errors import InputError
from mobilestereonet.nets import build_model
from mobilestereonet.nets.deeppruner import pruned_range
from mobilestereonet.nets.deeppruner_blocks import expectation
from mobilestereonet.nets.operations import concatenate, cost_volume
from mobilestereonet.nets.patch_match import candidate_volume, patch_match
from mobilestereonet.weights.released_names import released_name
from mobilestereonet.weights.shapes import registered_shapes
from small_views import for_small_views, with_statistics

NAMES = ("deeppruner-best", "deeppruner-fast")
DIGESTS = {"deeppruner-best": "5b816cbb9f4cb920", "deeppruner-fast": "9027c42df6601d3d"}
"""SHA-256 of the released checkpoints' names and shapes."""


def released_shapes(name):
    shapes = registered_shapes(name)
    return {released_name(name, key): list(shape) for key, shape in shapes.items()}


@pytest.mark.parametrize("name", NAMES)
def test_names_and_shapes_are_those_of_the_released_checkpoints(name):
    text = json.dumps(released_shapes(name), sort_keys=True)
    assert hashlib.sha256(text.encode()).hexdigest()[:16] == DIGESTS[name]


@needs_shared
@pytest.mark.parametrize("name", NAMES)
def test_the_digests_are_those_of_the_shared_lists(name):
    file = SHARED / "parity/deeppruner" / f"{name.replace('-', '_')}.json"
    listed = json.loads(file.read_text())
    assert released_shapes(name) == {
        key: shape for key, shape in listed.items() if not key.endswith("num_batches_tracked")
    }


def shifted_features(shift, size=(2, 32, 24, 64)):
    """Features of which only equal ones have a large product, and the same moved to the right."""
    torch.manual_seed(0)
    right = 2 * torch.randn(size).sign()
    return right.roll(shift, -1), right


def constant_range(low, high, size=(2, 1, 24, 64)):
    return torch.full(size, float(low)), torch.full(size, float(high))


@pytest.mark.parametrize(("shift", "part"), [(1, 0), (7, 1), (23, 5)])
def test_patch_match_finds_a_shift(shift, part):
    offsets = torch.rand(1, 12, 24, 64)
    found = patch_match(*shifted_features(shift), *constant_range(0, 48), offsets)
    assert found.shape == (2, 12, 24, 64)
    found = found[:, part, 2:-2, shift + 2 : -2]
    matches = (found > shift - 1) & (found <= shift)  # columns are cut to whole ones
    assert matches.float().mean() > 0.99
    before = (4 * (offsets[:, part] + part) - (shift - 0.5)).abs() < 0.5
    assert before.float().mean() < 0.3


def test_patch_match_stays_in_each_pixels_own_range():
    low = torch.rand(2, 1, 24, 64) * 20
    high = low + 3 + torch.rand(2, 1, 24, 64) * 20
    found = patch_match(*shifted_features(5), low, high, torch.rand(2, 7, 24, 64))
    assert found.isfinite().all()
    part = (high.ceil() - low.floor()) / 7
    starts = low.floor() + torch.arange(7)[:, None, None] * part
    assert ((found >= starts - 1e-4) & (found <= starts + part + 1e-4)).all()


def test_patch_match_spreads_to_all_four_sides_and_takes_nothing_from_beyond():
    """Of a single good particle; in an iteration it gets one pixel further each way."""
    left = torch.ones(1, 4, 9, 11)
    low, high = constant_range(0, 2, (1, 1, 9, 11))
    right = torch.zeros(1, 4, 9, 11)
    offsets = torch.zeros(1, 1, 9, 11)
    same = patch_match(left, right, low, high, offsets + 0.5)
    inner = same[..., 2:-2, 2:-2]
    assert inner.eq(1).all()
    assert same[0, 0, 4, 0] < 1 and same[0, 0, 0, 5] < 1  # zeros from beyond the border
    offsets[..., 4, 5] = 1
    reached = patch_match(left, right, low, high, offsets)[0, 0] > 0
    rows, columns = reached.nonzero().unbind(1)
    assert set(rows.tolist()) == {2, 3, 4, 5, 6} and set(columns.tolist()) == {3, 4, 5, 6, 7}


def test_candidate_volume():
    left, right = torch.rand(2, 2, 3, 4, 9)
    candidates = torch.arange(5.0)[None, :, None, None].expand(2, -1, 4, 9)
    volume = candidate_volume(left, right, candidates)
    assert volume.shape == (2, 7, 5, 4, 9)
    expected = cost_volume(concatenate, left, right, 5)
    assert volume[:, :3].equal(left.unsqueeze(2).expand(-1, -1, 5, -1, -1))  # no column is masked
    assert volume[:, 3:6].equal(expected[:, 3:])
    assert volume[:, 6].equal(candidates)
    scattered = candidates[:, torch.randperm(5)].clone()
    scattered[..., 3] = 2
    at = candidate_volume(left, right, scattered)
    assert at[:, 3:6, :, :, 3].equal(right[:, :, None, :, 1].expand(-1, -1, 5, -1))


@pytest.mark.parametrize(
    ("ends", "expected"),
    [
        ((10.0, 20.0), (10.0, 20.0)),
        ((20.0, 10.0), (10.0, 20.0)),
        ((10.0, 13.0), (8.0, 15.0)),
        ((1.0, 2.0), (0.0, 7.0)),
        ((30.0, 50.0), (30.0, 48.0)),
        ((47.0, 48.0), (44.0, 48.0)),
    ],
)
def test_the_range_is_ordered_within_reach_and_not_too_narrow(ends, expected):
    low, high = pruned_range(*(torch.tensor(end) for end in ends), 48)
    assert (low.item(), high.item()) == expected


def test_expectation():
    scores, candidates = torch.zeros(1, 3, 1, 1), torch.tensor([0.0, 3, 9])[None, :, None, None]
    assert expectation(scores, candidates).item() == pytest.approx(4)


@pytest.fixture(scope="module")
def views():
    return torch.randn(2, 2, 3, 64, 64, generator=torch.Generator().manual_seed(0))


@pytest.fixture(scope="module", params=NAMES)
def net(request, views):
    torch.manual_seed(0)
    net = build_model(request.param)
    assert net.min_side == 256
    return with_statistics(for_small_views(net), *views)


def changed(net, **fields):
    """The same weights in a network of another config."""
    with torch.device("meta"):
        other = for_small_views(type(net)(replace(net.config, **fields)))
    other.load_state_dict(net.state_dict(), assign=True)
    return other.eval()


@torch.inference_mode()
def test_a_pair_has_one_result_in_eval_mode_and_others_with_other_seeds(net, views):
    disparity = net(*views).disparity
    assert disparity.shape == (2, 64, 64) and disparity.isfinite().all() and disparity.min() >= 0
    torch.manual_seed(5)
    state = torch.get_rng_state()
    net.set_step(3)
    assert net(*views).disparity.equal(disparity)
    assert torch.get_rng_state().equal(state)
    alone = net(*views[:, 1:]).disparity
    torch.testing.assert_close(alone, disparity[1:], rtol=0, atol=0.05)
    for fields in ({"seed": 1}, {"sampler": "uniform"}):
        assert not changed(net, **fields)(*views).disparity.equal(disparity)


def test_heads_and_loss(net, views):
    net.train()
    with torch.no_grad():
        first, again = net(*views), net(*views)
        net.set_step(7)
        other = net(*views)
    net.eval()
    assert len(first.predictions) == len(net.head_weights) == (4 if net.config.scale == 4 else 5)
    assert all(prediction.shape == (2, 64, 64) for prediction in first.predictions)
    assert first.disparity is first.predictions[0]
    upper, lower = first.predictions[-2:]
    assert not upper.equal(lower)
    assert not other.disparity.equal(first.disparity)  # other particles in each step
    assert again.disparity.equal(first.disparity)

    heads = [torch.full((1, 2, 4), 8.0) for _ in net.head_weights]
    disparity = torch.full((1, 2, 4), 8.0)
    valid = torch.ones(1, 2, 4, dtype=torch.bool)
    disparity[..., 0], valid[..., 0] = torch.nan, False

    def loss(index=0, error=0.0):
        moved = [head + error * (i == index) for i, head in enumerate(heads)]
        return net.training_loss(first._replace(predictions=moved), disparity, valid).item()

    assert loss() == 0
    count = len(heads)
    assert loss(0, 3.0) == pytest.approx(net.head_weights[0] * 2.5)
    assert loss(count - 2, 3.0) == pytest.approx(0.7 * 2.5 + 3 * 0.05)  # above the truth is right
    assert loss(count - 2, -3.0) == pytest.approx(0.7 * 2.5 + 3 * 0.95)
    assert loss(count - 1, 3.0) == pytest.approx(0.7 * 2.5 + 3 * 0.95)
    assert loss(count - 1, -3.0) == pytest.approx(0.7 * 2.5 + 3 * 0.05)
    valid[:] = False
    assert loss() == 0


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"max_disparity": 90}, "max_disparity must be a positive multiple of 4, got 90"),
        ({"max_disparity": 0}, "max_disparity must be a positive multiple of 4, got 0"),
        ({"sampler": "random"}, "sampler must be one of patch_match, uniform, got 'random'"),
        ({"seed": -1}, r"seed must be 0 \.\. 4294967295, got -1"),
    ],
)
def test_values_are_refused(fields, message):
    with pytest.raises(InputError, match=message):
        build_model("deeppruner-best", **fields)
