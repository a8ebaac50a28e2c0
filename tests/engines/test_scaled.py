"""An engine on resized views: shapes, units and the range of disparities."""

import pytest
import torch

from mobilestereonet import InputError
from mobilestereonet.engines.scaled import ScaledEngine
from mobilestereonet.nets.model import RGB, Prediction


class Columns:
    """An engine whose disparity is a hundredth of the column, and that keeps the views' size."""

    name, precision, device, threads = "columns", "fp32", torch.device("cpu"), None
    preprocessing, size_multiple, min_side, max_disparity = RGB, 32, 33, 96
    has_confidence = True

    def __call__(self, left, right, confidence=False):
        batch, _, self.height, self.width = left.shape
        disparity = torch.arange(self.width).expand(batch, self.height, -1) / 100
        return Prediction(disparity, left[:, 0] if confidence else None)


def test_disparities_are_in_the_pixels_of_the_views():
    inner = Columns()
    engine = ScaledEngine(inner, 0.75)
    assert (engine.size_multiple, engine.min_side, engine.max_disparity) == (1, 44, 128)
    left = torch.full((2, 3, 100, 203), 0.25)
    found = engine(left, left, confidence=True)
    assert (inner.height, inner.width) == (96, 160)  # 75 x 152, padded to multiples of 32
    assert found.disparity.shape == found.confidence.shape == (2, 100, 203)
    # The column of the small view, in pixels of the large one.
    expected = torch.arange(203) / 100
    torch.testing.assert_close(found.disparity[1, 50, 2:-2], expected[2:-2], atol=0.01, rtol=0)
    torch.testing.assert_close(found.confidence, torch.full_like(found.confidence, 0.25))
    assert engine(left, left).confidence is None


def test_the_confidence_is_of_errors_in_the_pixels_of_the_views():
    inner = Columns()
    assert ScaledEngine(inner, 0.5).confidence_fit is None
    inner.confidence_fit = torch.sqrt
    fit = ScaledEngine(inner, 0.5).confidence_fit
    # 15/16: below 3 px of the small views. Half of that, 3 px of the views: 3/4.
    torch.testing.assert_close(fit(torch.tensor([(15 / 16) ** 2])), torch.tensor([3 / 4]))


@pytest.mark.parametrize("scale", [0.0, 0.2, 1.5])
def test_scales_out_of_range(scale):
    with pytest.raises(InputError, match=f"scale must be in 0.25..1, got {scale}"):
        ScaledEngine(Columns(), scale)
