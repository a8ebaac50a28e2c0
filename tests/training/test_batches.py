import numpy as np
import pytest
import torch
from torch.utils.data import DataLoader, Dataset

from mobilestereonet.data.augment import AugmentConfig
from mobilestereonet.data.sample import StereoSample
from mobilestereonet.errors import InputError
from mobilestereonet.scenes import ProceduralScenes, SceneConfig
from mobilestereonet.training.batches import PositionBatches, TrainingPairs

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


def _pairs(source: Dataset[StereoSample], seed: int = 3) -> TrainingPairs:
    return TrainingPairs(source, AUGMENT, seed)


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
def test_a_position_is_one_pair_in_any_batch(kind, scenes):
    pairs = _pairs(scenes if kind == "procedural" else Numbers())
    batch = pairs.__getitems__(list(range(6))).augmented
    assert batch.left.shape == (6, 3, 32, 48)
    for position in range(6):
        _assert_same(batch, position, pairs.__getitems__([position]).augmented, 0)
    mixed = pairs.__getitems__([5, 2]).augmented
    _assert_same(batch, 5, mixed, 0)
    _assert_same(batch, 2, mixed, 1)
    other = TrainingPairs(pairs.source, AUGMENT, 4).__getitems__([0]).augmented
    assert not torch.allclose(other.left[0], batch.left[0], atol=1e-3)


def test_every_epoch_has_an_order_of_its_own():
    pairs = _pairs(Numbers())
    names = [pairs.__getitems__([position]).augmented.name for position in range(15)]
    epochs = [names[:5], names[5:10], names[10:]]
    assert all(sorted(epoch) == list("01234") for epoch in epochs)
    assert len({tuple(epoch) for epoch in epochs}) == 3
    batch = pairs.__getitems__([0, 1, 2]).augmented
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
    pairs = _pairs(Numbers(), seed=41)
    found = [pairs._index(position) for position in (0, 1, 2, 3, 4, 5, 4, 6, 3, 7, 8, 9)]
    assert made == [5, 5]
    expected = [
        int(np.random.Generator(np.random.Philox(key=[41 | 1 << 33, epoch])).permutation(5)[place])
        for epoch, place in (divmod(p, 5) for p in (0, 1, 2, 3, 4, 5, 4, 6, 3, 7, 8, 9))
    ]
    assert found == expected


def test_two_epochs_see_a_pair_differently():
    pairs = _pairs(Numbers())
    names = [pairs.__getitems__([position]).augmented.name for position in range(10)]
    again = 5 + names[5:].index(names[0])
    both = pairs.__getitems__([0, again]).augmented
    assert not torch.allclose(both.left[0], both.left[1], atol=1e-3)


def test_sizes_that_differ_need_a_crop():
    pairs = TrainingPairs(Numbers(), AugmentConfig(), 0)
    with pytest.raises(InputError, match="images of one size"):
        pairs.__getitems__([0, 1])


def test_ranks_share_the_positions_of_one_process():
    one = list(PositionBatches(lambda: 0, steps=4, batch_size=6))
    assert one[0] == [0, 1, 2, 3, 4, 5] and one[3][-1] == 23
    ranks = [list(PositionBatches(lambda: 0, 4, 2, rank, 3)) for rank in range(3)]
    for step in range(4):
        assert [position for rank in ranks for position in rank[step]] == one[step]


def test_a_resumed_run_goes_on_where_it_stopped():
    done = 0
    batches = PositionBatches(lambda: done, steps=5, batch_size=2)
    whole = list(batches)
    done = 3
    assert list(batches) == whole[3:] == [[6, 7], [8, 9]]
    assert len(batches) == 5


def test_data_loader_asks_for_whole_batches(scenes):
    pairs = _pairs(scenes)
    sampler = PositionBatches(lambda: 0, steps=2, batch_size=2)
    loader = DataLoader(pairs, batch_sampler=sampler, collate_fn=lambda batch: batch)
    batches = list(loader)
    assert len(batches) == 2
    _assert_same(batches[1].augmented, 1, pairs.__getitems__([3]).augmented, 0)
    assert np.isfinite(batches[0].augmented.left.numpy()).all()
