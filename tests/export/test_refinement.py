"""The refinement inside of exported files: what `StereoMatcher` does with a prediction."""

import pytest
import torch

from mobilestereonet.data.motorcycle import motorcycle_views
from mobilestereonet.export.refinement import Refinement
from mobilestereonet.inference.refine import refine_disparity
from mobilestereonet.inference.subpixel import fit_subpixel
from mobilestereonet.nets.model import Prediction


@pytest.mark.parametrize("sure", [0.7, 0.0, 1.0])
def test_refinement_in_a_graph(sure):
    torch.manual_seed(0)
    left, right = (view.double() for view in motorcycle_views((32, 64)))
    steps = 12 * torch.rand(1, 4, 8, dtype=torch.float64)
    disparity = steps.repeat_interleave(8, 1).repeat_interleave(8, 2) + torch.rand(1, 32, 64)
    confidence = torch.rand(1, 32, 64, dtype=torch.float64) * 0.3 + sure
    confidence[0, 3] = 0
    confidence[0, 4, :20] = confidence[0, 5, 50:] = 0
    expected = refine_disparity(disparity, confidence, left)
    assert (expected != disparity).float().mean() > 0.1
    expected = fit_subpixel(expected, left, right)
    found = Refinement().double()(Prediction(disparity, confidence), left, right)
    torch.testing.assert_close(found.disparity, expected, rtol=0, atol=1e-9)
    assert found.confidence is confidence
