"""The refinement inside of exported files: what `StereoMatcher` does with a prediction."""

import pytest
import torch

from mobilestereonet import InputError
from mobilestereonet.data.motorcycle import motorcycle_views
from mobilestereonet.export import export_model
from mobilestereonet.export.pt2 import PT2
from mobilestereonet.export.refinement import Refinement
from mobilestereonet.inference.refine import refine_disparity
from mobilestereonet.inference.subpixel import fit_subpixel
from mobilestereonet.nets import build_model
from mobilestereonet.nets.model import Prediction


@pytest.mark.parametrize("size", [(4, 4), (4, 12), (12, 4)])
def test_views_smaller_than_the_distance_of_neighbours(size):
    torch.manual_seed(0)
    left, right = torch.rand(2, 1, 3, *size, dtype=torch.float64)
    disparity, confidence = 12 * torch.rand(1, *size).double(), torch.rand(1, *size).double()
    expected = fit_subpixel(refine_disparity(disparity, confidence, left, right), left, right)
    found = Refinement().double()(Prediction(disparity, confidence), left, right)
    torch.testing.assert_close(found.disparity, expected, rtol=0, atol=1e-9)


@pytest.mark.parametrize("sure", [0.7, 0.0, 1.0])
def test_refinement_in_a_graph(sure):
    torch.manual_seed(0)
    left, right = (view.double() for view in motorcycle_views((32, 64)))
    steps = 12 * torch.rand(1, 4, 8, dtype=torch.float64)
    disparity = steps.repeat_interleave(8, 1).repeat_interleave(8, 2) + torch.rand(1, 32, 64)
    confidence = torch.rand(1, 32, 64, dtype=torch.float64) * 0.3 + sure
    confidence[0, 3] = 0
    confidence[0, 4, :20] = confidence[0, 5, 50:] = 0
    expected = refine_disparity(disparity, confidence, left, right)
    assert (expected != disparity).float().mean() > 0.1
    expected = fit_subpixel(expected, left, right)
    found = Refinement().double()(Prediction(disparity, confidence), left, right)
    torch.testing.assert_close(found.disparity, expected, rtol=0, atol=1e-9)
    assert found.confidence is confidence


def test_a_refined_file(tmp_path):
    torch.manual_seed(0)
    net = build_model("msnet2d", max_disparity=32, hourglasses=1, width=8, estimator="mode").eval()
    net.zero_residuals()
    plain, refined = (
        export_model("pt2", net, tmp_path / f"{name}.pt2", model="small", size=(32, 64), refine=on)
        for name, on in (("plain", False), ("refined", True))
    )
    assert refined.mean < 1e-3  # to the network with `refine_disparity` and `fit_subpixel`
    views = motorcycle_views((32, 64))
    disparities = [PT2().open(done.path)(*views).disparity for done in (plain, refined)]
    assert (disparities[0] - disparities[1]).abs().mean() > 0.01
    assert PT2().read_metadata(refined.path)["refinement"] == "inside the graph"
    assert PT2().read_metadata(plain.path)["refinement"] == "none"


def test_without_a_confidence_nothing_is_refined(tmp_path):
    net = build_model("dispnet-c")
    with pytest.raises(InputError, match="regresses the disparity without a confidence, which"):
        export_model("pt2", net, tmp_path / "net.pt2", model="dispnet-c", refine=True)
    assert not list(tmp_path.iterdir())
