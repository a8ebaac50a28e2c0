import numpy as np
import pytest
import torch
from skimage.data import stereo_motorcycle

from mobilestereonet.data.images import image_to_tensor
from mobilestereonet.data.sample import StereoSample
from mobilestereonet.engines.base import Engine
from mobilestereonet.engines.sgbm import StereoSGBM, _fill_rows
from mobilestereonet.errors import InputError
from mobilestereonet.metrics import StereoMetrics
from mobilestereonet.nets.model import RGB


def test_motorcycle():
    left, right, truth = stereo_motorcycle()
    valid = np.isfinite(truth)
    batch = StereoSample(
        image_to_tensor(left)[None],
        image_to_tensor(right)[None],
        torch.from_numpy(np.where(valid, truth, 0)).float()[None],
        torch.from_numpy(valid)[None],
    )
    disparity = StereoSGBM()(batch.left, batch.right).disparity
    assert disparity.dtype == torch.float32
    metrics = StereoMetrics()
    metrics.update(disparity, batch)
    scores = metrics.compute().masks["all"].per_image
    assert scores["epe"] == pytest.approx(1.32, abs=0.1)
    assert scores["d1"] == pytest.approx(7.0, abs=0.5)


def test_a_batch_of_shifted_noise():
    generator = torch.Generator().manual_seed(0)
    wide = torch.rand(2, 3, 40, 140, generator=generator)
    disparity = StereoSGBM(max_disparity=32)(wide[..., :120], wide[..., 10:130]).disparity
    assert disparity.shape == (2, 40, 120)
    # Left of column 10 the right view has no match.
    assert (disparity[..., 20:110] - 10).abs().max() < 0.1


def test_holes_take_the_smaller_neighbour():
    rows = np.array([[-1, 5, -1, -1, 3, -1], [-1, -1, 7, 0, -1, 9], [-1] * 6], np.float32)
    expected = [[5, 5, 3, 3, 3, 3], [7, 7, 7, 0, 0, 9], [0] * 6]
    np.testing.assert_array_equal(_fill_rows(rows), expected)


@pytest.mark.parametrize("size", [(1, 1), (3, 40), (40, 1)])
def test_any_size(size):
    view = torch.rand(1, 3, *size)
    disparity = StereoSGBM()(view, view).disparity
    assert disparity.shape == (1, *size)
    assert disparity.isfinite().all() and (disparity >= 0).all()


def test_it_is_an_engine_that_takes_raw_rgb_of_any_size():
    engine = StereoSGBM()
    assert isinstance(engine, Engine)
    assert (engine.name, engine.preprocessing, engine.size_multiple) == ("sgbm", RGB, 1)
    assert engine(*torch.rand(2, 1, 3, 9, 9), confidence=True).confidence is None


def test_bad_input():
    with pytest.raises(InputError, match="multiple of 16, got 100"):
        StereoSGBM(max_disparity=100)
    with pytest.raises(InputError, match=r"\(1, 3, 8, 8\) and \(1, 3, 8, 9\)"):
        StereoSGBM()(torch.rand(1, 3, 8, 8), torch.rand(1, 3, 8, 9))
