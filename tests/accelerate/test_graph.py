import pytest
import torch

from mobilestereonet.accelerate.graph import soft_argmax_by_powers
from mobilestereonet.nets.disparity import regress_disparity


@pytest.mark.parametrize("estimator", ["mean", "mode"])
@pytest.mark.parametrize("scale", [0.1, 3, 30])
def test_soft_argmax_by_powers_is_the_soft_argmax(scale, estimator):
    torch.manual_seed(0)
    scores = scale * torch.randn(1, 12, 5, 9, dtype=torch.float64)
    found, expected = soft_argmax_by_powers(scores, estimator), regress_disparity(scores, estimator)
    torch.testing.assert_close(found, expected, rtol=0, atol=1e-9)
