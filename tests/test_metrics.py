import itertools
import json
import math
import multiprocessing as mp
from dataclasses import replace

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch._subclasses.fake_tensor import FakeTensorMode

from mobilestereonet.data.sample import StereoSample, collate
from mobilestereonet.errors import InputError
from mobilestereonet.metrics import StereoMetrics, StereoScores


def _sample(truth, occluded=None, foreground=None, valid=None) -> StereoSample:
    disparity = torch.tensor(truth, dtype=torch.float32)
    maps = {
        name: None if values is None else torch.tensor(values, dtype=torch.bool)
        for name, values in (("occluded", occluded), ("foreground", foreground))
    }
    views = torch.zeros(3, *disparity.shape)
    known = disparity > 0 if valid is None else torch.tensor(valid, dtype=torch.bool)
    return StereoSample(views, views, disparity, known, name="sample", **maps)


def _scores(metrics: StereoMetrics, pairs) -> StereoScores:
    for prediction, sample in pairs:
        metrics.update(torch.tensor(prediction, dtype=torch.float32)[None], collate([sample]))
    return metrics.compute()


def test_figures_by_hand():
    # Errors 0, 1.5, 4, 4; 4 px of 100 px are 4 %, so that the last one is no outlier of D1.
    sample = _sample([[10, 10, 10, 100]])
    scores = _scores(StereoMetrics(), [([[10, 11.5, 6, 104]], sample)]).masks["all"]
    assert scores.per_image == pytest.approx(
        {"epe": 9.5 / 4, "d1": 25.0, "bad1": 75.0, "bad2": 50.0, "bad3": 50.0}
    )
    assert scores.per_pixel == pytest.approx(scores.per_image)
    assert (scores.images, scores.empty, scores.skipped, scores.pixels) == (1, 0, 0, 4)


def test_an_error_on_the_threshold_is_within_it():
    sample = _sample([[10, 80]])
    scores = _scores(StereoMetrics(), [([[13, 84]], sample)]).masks["all"]  # 3 px; 4 px = 5 %
    assert scores.per_image["bad3"] == 50.0
    assert scores.per_image["d1"] == 0.0


def test_per_image_and_per_pixel_means_differ():
    # One pixel off by 8, and four pixels off by 0: 4 px over the images, 1.6 px over the pixels.
    pairs = [([[18, 0, 0, 0]], _sample([[10, 0, 0, 0]])), ([[9] * 4], _sample([[9] * 4]))]
    scores = _scores(StereoMetrics(), pairs).masks["all"]
    assert scores.per_image["epe"] == 4.0
    assert scores.per_pixel["epe"] == pytest.approx(8 / 5)
    assert scores.per_image["d1"] == 50.0
    assert scores.per_pixel["d1"] == pytest.approx(20.0)


def test_only_valid_pixels_in_range_count():
    sample = _sample([[0, 191, 192, 50]], valid=[[True, True, True, False]])
    pairs = [([[9, 190, 0, 0]], sample)]
    assert _scores(StereoMetrics(), pairs).masks["all"].pixels == 1
    assert _scores(StereoMetrics(), pairs).masks["all"].per_pixel["epe"] == 1.0
    assert _scores(StereoMetrics(max_disparity=math.inf), pairs).masks["all"].pixels == 2


def test_masks_by_hand():
    sample = _sample(
        [[10, 10, 10, 10]],
        occluded=[[False, False, True, True]],
        foreground=[[True, False, True, False]],
    )
    masks = _scores(StereoMetrics(), [([[11, 12, 14, 18]], sample)]).masks
    means = {name: scores.per_image["epe"] for name, scores in masks.items()}
    assert means == {"all": 3.75, "noc": 1.5, "occ": 6.0, "fg": 2.5, "bg": 5.0}


def test_an_image_counts_only_in_the_masks_that_it_has():
    pairs = [
        ([[11, 12]], _sample([[10, 10]], occluded=[[False, False]])),
        ([[10, 10]], _sample([[10, 10]])),
    ]
    masks = _scores(StereoMetrics(), pairs).masks
    assert list(masks) == ["all", "noc", "occ"]
    assert (masks["all"].images, masks["noc"].images) == (2, 1)
    assert (masks["occ"].images, masks["occ"].empty) == (0, 1)
    assert masks["occ"].per_image["epe"] is None


def test_an_image_without_valid_pixels_is_counted_and_never_nan():
    pairs = [([[5, 5]], _sample([[0, 0]])), ([[5, 5]], _sample([[4, 4]]))]
    scores = _scores(StereoMetrics(), pairs)
    assert (scores.masks["all"].images, scores.masks["all"].empty) == (1, 1)
    assert scores.masks["all"].per_image["epe"] == 1.0
    nothing = _scores(StereoMetrics(), pairs[:1])
    assert set(nothing.masks["all"].per_image.values()) == {None}
    assert "NaN" not in json.dumps(nothing.to_dict())
    assert nothing.figures() == {}


def test_the_authors_rule_skips_and_counts():
    # 1 of 11 pixels with ground truth is in range (9.1 %), then 2 of 12 (16.7 %).
    few, enough = _sample([[10] + [200] * 10]), _sample([[10, 10] + [200] * 10])
    pairs = [([[14] * 11], few), ([[12] * 12], enough)]
    scores = _scores(StereoMetrics(min_share=0.1), pairs).masks["all"]
    assert (scores.images, scores.empty, scores.skipped, scores.pixels) == (1, 0, 1, 2)
    assert scores.per_image["epe"] == 2.0
    assert _scores(StereoMetrics(), pairs).masks["all"].per_image["epe"] == 3.0


def test_a_prediction_of_nan_is_an_outlier():
    scores = _scores(StereoMetrics(), [([[math.nan, 10]], _sample([[10, 10]]))]).masks["all"]
    assert scores.per_image["d1"] == scores.per_image["bad3"] == 50.0
    assert math.isnan(scores.per_image["epe"])


def _random_pairs(count: int):
    generator = torch.Generator().manual_seed(4)
    pairs = []
    for index in range(count):
        truth = torch.rand(6, 8, generator=generator) * 230 - 20
        valid = truth > 0 if index != 2 else torch.zeros(6, 8, dtype=torch.bool)
        occluded = torch.rand(6, 8, generator=generator) > 0.7
        foreground = torch.rand(6, 8, generator=generator) > 0.7
        prediction = truth + 4 * torch.randn(6, 8, generator=generator)
        views = torch.zeros(3, 6, 8)
        truth = torch.where(valid, truth, 0)
        sample = StereoSample(views, views, truth, valid, occluded, foreground, name=str(index))
        pairs.append((prediction, sample))
    return pairs


def _flat(scores: StereoScores) -> list[float]:
    return [
        value
        for mask in scores.masks.values()
        for value in (*mask.per_image.values(), *mask.per_pixel.values(), mask.images, mask.pixels)
    ]


def _add(metrics: StereoMetrics, pairs, batch_size: int) -> StereoMetrics:
    for start in range(0, len(pairs), batch_size):
        _add_batch(metrics, pairs[start : start + batch_size])
    return metrics


def _add_batch(metrics: StereoMetrics, pairs) -> None:
    predictions, samples = zip(*pairs, strict=True)
    metrics.update(torch.stack(predictions), collate(samples))


@settings(max_examples=30, deadline=None)
@given(order=st.permutations(range(7)), cuts=st.sets(st.integers(1, 6)))
def test_any_split_into_batches_and_any_order_give_the_same(order, cuts):
    pairs = _random_pairs(7)
    expected = _flat(_add(StereoMetrics(), pairs, 1).compute())
    metrics = StereoMetrics()
    for start, end in itertools.pairwise([0, *sorted(cuts), 7]):
        _add_batch(metrics, [pairs[index] for index in order[start:end]])
    assert _flat(metrics.compute()) == pytest.approx(expected, rel=1e-13)


def test_sums_do_not_lose_small_errors():
    # In float32 the sum of 3 million errors of 0.1 px is off in the fourth digit.
    truth = torch.full((1, 1000, 1000), 10.0)
    views = torch.zeros(1, 3, 1, 1)
    batch = StereoSample(views, views, truth, truth > 0)
    metrics = StereoMetrics()
    for _ in range(3):
        metrics.update(truth + 0.125, batch)
    assert metrics.compute().masks["all"].per_pixel["epe"] == pytest.approx(0.125, rel=1e-12)


def _rank(rank: int, meeting_point: str, queue) -> None:
    torch.set_num_threads(1)
    torch.distributed.init_process_group("gloo", meeting_point, rank=rank, world_size=2)
    pairs = _random_pairs(5)
    mine = pairs[:2] if rank == 0 else pairs[2:]
    queue.put(_flat(_add(StereoMetrics(), mine, 2).compute()))
    torch.distributed.destroy_process_group()


def test_two_ranks_give_what_one_gives(tmp_path):
    context = mp.get_context("spawn")
    queue = context.Queue()
    meeting_point = (tmp_path / "ranks").as_uri()
    ranks = [context.Process(target=_rank, args=(r, meeting_point, queue)) for r in range(2)]
    for process in ranks:
        process.start()
    results = [queue.get(timeout=60) for _ in ranks]
    for process in ranks:
        process.join(timeout=60)
    expected = _flat(_add(StereoMetrics(), _random_pairs(5), 1).compute())
    for result in results:
        assert result == pytest.approx(expected, rel=1e-13)


def test_medians_are_those_of_the_images():
    pairs = [([[10 + error]], _sample([[10]])) for error in (5, 1, 2, 1.5)]
    scores = _scores(StereoMetrics(), pairs).masks["all"]
    assert scores.median == {"epe": 1.75, "d1": 0.0, "bad1": 100.0, "bad2": 0.0, "bad3": 0.0}
    assert scores.per_image["epe"] == 9.5 / 4


def test_the_density_is_that_of_the_scored_ground_truth():
    # 2 of 4 px, then 1 of 8; the skipped frame's pixels do not count.
    pairs = [
        ([[10] * 4], _sample([[10, 10, 0, 200]])),
        ([[10] * 8], _sample([[10, 0, 0, 0, 0, 0, 0, 0]])),
    ]
    assert _scores(StereoMetrics(), pairs).masks["all"].gt_density == pytest.approx(300 / 12)
    pairs.append(([[10] * 12], _sample([[10] + [200] * 11])))
    scores = _scores(StereoMetrics(min_share=0.1), pairs)
    assert scores.masks["all"].gt_density == pytest.approx(300 / 12)
    assert [row["gt_density_all"] for row in scores.pairs] == [50.0, 12.5, None]


def test_columns_of_pairs_know_the_unknown_from_zero():
    pairs = [
        ([[11, 13]], _sample([[10, 10]], occluded=[[False, True]])),
        ([[10, 10]], _sample([[10, 10]])),  # perfect, but who knows where it is occluded
        ([[10, 10]], _sample([[10, 10]], occluded=[[True, True]])),
    ]
    rows = _scores(StereoMetrics(thresholds=(1, 2.5)), pairs).pairs
    assert [row["epe_all"] for row in rows] == [2.0, 0.0, 0.0]
    assert [row["epe_noc"] for row in rows] == [1.0, None, None]
    assert [row["bad1_noc"] for row in rows] == [0.0, None, None]
    assert [row["bad2.5_occ"] for row in rows] == [100.0, None, 0.0]
    assert [row["pixels_noc"] for row in rows] == [1, None, 0]
    assert [row["gt_density_noc"] for row in rows] == [50.0, None, 0.0]
    assert not any("_fg" in name for row in rows for name in row)


def test_columns_of_all_pairs():
    pairs = [
        ([[11, 13]], _sample([[10, 10]], occluded=[[False, True]])),
        ([[10]], _sample([[10]])),
    ]
    row = _scores(StereoMetrics(thresholds=(1,)), pairs).columns()
    assert (row["epe_all_mean"], row["epe_all_median"]) == (1.0, 1.0)
    assert row["epe_all_per_pixel"] == pytest.approx(4 / 3)
    assert (row["bad1_all_mean"], row["bad1_noc_mean"]) == (25.0, 0.0)
    assert (row["images_noc"], row["pixels_noc"], row["pixels_occ"]) == (1, 1, 1)
    unknown = _scores(StereoMetrics(), pairs[1:]).columns()
    assert {unknown[f"{figure}_noc_mean"] for figure in ("epe", "d1", "bad1", "bad2")} == {None}
    assert unknown["pixels_noc"] is unknown["images_noc"] is None
    assert unknown["d1_all_median"] == 0.0


def test_reset():
    pairs = _random_pairs(2)
    metrics = StereoMetrics()
    for prediction, sample in pairs:
        metrics.update(prediction[None], collate([sample]))
    assert metrics.compute().masks["all"].images == 2
    metrics.reset()
    assert metrics.compute().masks["all"].images == 0


def test_on_each_device(device):
    pairs = _random_pairs(3)
    metrics = StereoMetrics()
    for prediction, sample in pairs:
        metrics.update(prediction[None].to(device), collate([sample]))
    expected = _flat(_add(StereoMetrics(), pairs, 3).compute())
    assert _flat(metrics.compute()) == pytest.approx(expected, rel=1e-5)


def test_any_n():
    scores = _scores(StereoMetrics(thresholds=(0.5,)), [([[10.4, 10.6]], _sample([[10, 10]]))])
    assert scores.figures("val/") == pytest.approx(
        {"val/epe": 0.5, "val/d1": 0.0, "val/bad0.5": 50.0}
    )


def test_json_of_an_endless_range():
    scores = _scores(StereoMetrics(max_disparity=math.inf), [([[12]], _sample([[10]]))])
    assert json.loads(json.dumps(scores.to_dict(), allow_nan=False))["max_disparity"] is None


@pytest.mark.parametrize(
    ("options", "word"),
    [
        ({"max_disparity": 0}, "max_disparity"),
        ({"max_disparity": math.nan}, "max_disparity"),
        ({"min_share": 1.5}, "min_share"),
        ({"thresholds": (-1,)}, "thresholds"),
    ],
)
def test_bad_options(options, word):
    with pytest.raises(InputError, match=word):
        StereoMetrics(**options)


def test_bad_input():
    batch = collate([_sample([[10, 10]])])
    with pytest.raises(InputError, match="shape"):
        StereoMetrics().update(torch.zeros(1, 1, 1), batch)
    with pytest.raises(InputError, match="no ground truth"):
        StereoMetrics().update(torch.zeros(1, 1, 2), replace(batch, disparity=None))


@pytest.mark.parametrize("truth_on", ["cpu", "lazy"])
@pytest.mark.parametrize("predictions_on", [("cpu", "lazy"), ("lazy", "cpu")])
def test_predictions_and_truth_may_lie_on_different_devices(predictions_on, truth_on):
    """Fake tensors of another device ("lazy" stands for a GPU) need no such device."""
    maps = {"occluded": [[True, False]], "foreground": [[True, False]]}
    with FakeTensorMode(allow_non_fake_inputs=True):
        metrics = StereoMetrics()
        batch = collate([_sample([[10, 10]], **maps)]).to(truth_on)
        for device in predictions_on:
            metrics.update(torch.zeros(1, 1, 2, device=device), batch)
