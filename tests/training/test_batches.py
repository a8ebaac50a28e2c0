from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
import torch
from torch.utils.data import Dataset

from mobilestereonet.data.augment import AugmentConfig
from mobilestereonet.data.sample import StereoSample
from mobilestereonet.errors import InputError
from mobilestereonet.scenes import ProceduralScenes, SceneConfig
from mobilestereonet.training.batches import StepRequests, TrainingPairs, Uses
from mobilestereonet.training.pool import PairPool, pack

AUGMENT = AugmentConfig(
    height=32, width=48, scale=(-0.2, 0.3), rotation=0.5, brightness=0.3, noise=0.02, blur=1.0,
    blur_probability=0.5, patch_probability=0.5, patch=(4, 8),
)  # fmt: skip


class Numbers(Dataset[StereoSample]):
    """Samples whose images and disparity hold their index; the sizes differ."""

    def __len__(self) -> int:
        return 5

    def __getitem__(self, index: int) -> StereoSample:
        image = torch.full((3, 40 + index, 60), index / 10)
        disparity = torch.full(image.shape[1:], float(index + 1))
        return StereoSample(image, image, disparity, disparity > 0, name=str(index))


def _batches(source, steps, size=1, *, first=0, seed=3, uses=Uses(), config=AUGMENT, ranks=(0, 1)):
    """Augmented batches of some steps of a run that starts, or goes on, at ``first``."""
    pairs, pool = TrainingPairs(source, seed), PairPool(config, seed)
    for request in StepRequests(lambda: first, steps, size, uses, *ranks):
        yield pool.batch(pairs[request]).augmented


@pytest.fixture(scope="module")
def scenes() -> ProceduralScenes:
    return ProceduralScenes(
        SceneConfig(height=48, width=64, max_disparity=20, min_disparity=4, noise_textures=16,
                    texture_size=32)
    )  # fmt: skip


def _assert_same(batch: StereoSample, index: int, other: StereoSample, place: int) -> None:
    for name in ("left", "right", "disparity"):
        ours, theirs = getattr(batch, name)[index], getattr(other, name)[place]
        assert torch.allclose(ours, theirs, atol=2e-5), (name, index)
    assert torch.equal(batch.valid[index], other.valid[place])


@pytest.mark.parametrize("kind", ["procedural", "files"])
@pytest.mark.parametrize("uses", [Uses(), Uses(2, 4)])
def test_a_position_is_one_pair_in_any_batch(kind, uses, scenes):
    source = scenes if kind == "procedural" else Numbers()
    (batch,) = _batches(source, 1, 6, uses=uses)
    assert batch.left.shape == (6, 3, 32, 48)
    for position, alone in enumerate(_batches(source, 6, 1, uses=uses)):
        _assert_same(batch, position, alone, 0)
    for rank in range(2):
        for step, half in enumerate(_batches(source, 3, 1, uses=uses, ranks=(rank, 2))):
            _assert_same(batch, 2 * step + rank, half, 0)
    (other,) = _batches(source, 1, 6, uses=uses, seed=4)
    assert not torch.allclose(other.left[0], batch.left[0], atol=1e-3)


def test_every_epoch_has_an_order_of_its_own():
    names = [batch.name for batch in _batches(Numbers(), 15)]
    epochs = [names[:5], names[5:10], names[10:]]
    assert all(sorted(epoch) == list("01234") for epoch in epochs)
    assert len({tuple(epoch) for epoch in epochs}) == 3
    (batch,) = _batches(Numbers(), 1, 3)
    assert batch.name == ",".join(names[:3])
    assert batch.disparity.amax((1, 2)).round().tolist() != [1, 1, 1]


def test_one_permutation_per_pass_over_the_data_set(monkeypatch):
    """In the order that runs have always had."""
    made = []

    class Counted(np.random.Generator):
        def permutation(self, length):
            made.append(length)
            return super().permutation(length)

    monkeypatch.setattr(np.random, "Generator", Counted)
    pairs = TrainingPairs(Numbers(), seed=41)
    found = [pairs._index(position) for position in (0, 1, 2, 3, 4, 5, 4, 6, 3, 7, 8, 9)]
    assert made == [5, 5]
    expected = [
        int(np.random.Generator(np.random.Philox(key=[41 | 1 << 33, epoch])).permutation(5)[place])
        for epoch, place in (divmod(p, 5) for p in (0, 1, 2, 3, 4, 5, 4, 6, 3, 7, 8, 9))
    ]
    assert found == expected


def test_two_uses_see_a_pair_differently():
    batches = list(_batches(Numbers(), 8, uses=Uses(2, 4), config=AugmentConfig(noise=0.1)))
    again = next(i for i in range(1, 8) if batches[i].name == batches[0].name)
    assert not torch.allclose(batches[0].left, batches[again].left, atol=1e-3)


def test_sizes_that_differ_need_a_crop():
    with pytest.raises(InputError, match="images of one size"):
        list(_batches(Numbers(), 1, 2, config=AugmentConfig()))


def test_ranks_share_the_positions_of_one_process():
    one = [request.positions for request in StepRequests(lambda: 0, 4, 6, Uses())]
    assert one[0] == [0, 1, 2, 3, 4, 5] and one[3][-1] == 23
    ranks = [list(StepRequests(lambda: 0, 4, 2, Uses(), rank, 3)) for rank in range(3)]
    for step in range(4):
        assert [p for rank in ranks for p in rank[step].positions] == one[step]


@pytest.mark.parametrize(("times", "pool"), [(1, 1), (1, 256), (3, 12), (4, 64), (4, 1), (5, 7)])
def test_every_pair_is_used_so_often(times, pool):
    uses, pairs = Uses(times, pool), 6 * pool + 20
    taken = [uses.pair(position) for position in range(times * pairs)]
    count = Counter(taken)
    # The first pairs fill up the pool, the last ones have uses still to come.
    assert {count[pair] for pair in range(pool, pairs - pool)} == {times}
    assert count.keys() == set(range(pairs))
    for position in range(len(taken)):
        assert min(taken[position:]) == uses.oldest(position)
        if position >= times * pool:
            window = taken[position - position % times :][:times]
            assert len(set(window)) == min(times, pool)


@pytest.mark.parametrize(("ranks", "size"), [(1, 8), (2, 8), (1, 3)])
def test_a_pair_is_rendered_once_and_forgotten_after_its_last_use(ranks, size):
    uses = Uses(4, 64)
    rendered, most = Counter(), 0
    for rank in range(ranks):
        held = set()
        for request in StepRequests(lambda: 0, 100, size, uses, rank, ranks):
            rendered.update(request.missing)
            assert not held & set(request.missing)
            held |= set(request.missing)
            assert set(request.pairs) <= held
            held -= {pair for pair in held if pair < request.oldest}
            most = max(most, len(held))
    assert max(rendered[pair] for pair in range(64, 300)) == 1
    assert most <= 1.25 * 64 // ranks  # while it fills, a pair may be in two ranks' pools
    # One new pair for every four positions; while the pool fills it is no more than that.
    assert len(rendered) == pytest.approx(100 * ranks * size / 4, abs=1)


def test_the_pool_holds_what_is_still_to_be_used():
    pairs, pool = TrainingPairs(Numbers(), 3), PairPool(AUGMENT, 3)
    uses = Uses(2, 4)
    for request in StepRequests(lambda: 0, 12, 2, uses):
        delivery = pairs[request]
        assert delivery.loaded.keys() == set(request.missing)
        assert all(pair.left.dtype == torch.uint8 for pair in delivery.loaded.values())
        pool.batch(delivery)
        assert len(pool.held) <= 4 and min(pool.held) == request.oldest


def test_a_resumed_run_goes_on_where_it_stopped(scenes):
    uses = Uses(2, 6)
    whole = list(_batches(scenes, 7, 3, uses=uses))
    resumed = list(_batches(scenes, 7, 3, uses=uses, first=4))
    for ours, theirs in zip(whole[4:], resumed, strict=True):
        for name in ("left", "right", "disparity", "valid"):
            assert torch.equal(getattr(ours, name), getattr(theirs, name)), name


def test_length_of_the_requests():
    assert len(StepRequests(lambda: 3, 5, 2, Uses())) == 5
    endless = StepRequests(lambda: 3, None, 2, Uses())
    assert [request.positions for request, _ in zip(endless, "ab", strict=False)] == [
        [6, 7],
        [8, 9],
    ]
    with pytest.raises(TypeError):
        len(endless)


def test_views_in_the_pool_are_bytes():
    pair = Numbers()[3]
    held = pack(replace(pair, left=torch.full((3, 4, 5), 0.4), occluded=pair.valid))
    assert held.left.unique().tolist() == [102] and held.occluded is None
    assert torch.equal(held.disparity, pair.disparity) and held.name == "3"
