"""Group-wise correlation by products of matrices."""

import pytest
import torch

from mobilestereonet.accelerate import group_correlation
from mobilestereonet.accelerate.group_correlation import BatchedCorrelation, StackedCorrelation
from mobilestereonet.nets.cost_volumes import Correlation

FORMS = {
    "batched": BatchedCorrelation,
    "stacked": lambda volume: StackedCorrelation(volume, columns_first=False),
    "columns first": lambda volume: StackedCorrelation(volume, columns_first=True),
}


def inputs(band, width=17):
    torch.manual_seed(0)
    views = torch.randn(2, 2, 32, 6, width, dtype=torch.float64, requires_grad=True)
    start = torch.randint(0, 4, (2, 6, width)) * 4 if band else None
    return views, start


@pytest.mark.parametrize("width", [17, 5])
@pytest.mark.parametrize("rows", [1, 4, 100])
@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("band", [False, True])
def test_it_equals_the_loop(band, form, rows, width, monkeypatch):
    monkeypatch.setattr(group_correlation, "_CACHED_BYTES", rows * 32 * width * 8)
    plain = Correlation(8)
    views, start = inputs(band, width)
    with torch.no_grad():
        expected = plain(*views, 12, start)
        found = FORMS[form](plain)(*views, 12, start)
    torch.testing.assert_close(found, expected, rtol=0, atol=1e-12)


@pytest.mark.parametrize("band", [False, True])
def test_gradients_equal_those_of_the_loop(band):
    plain = Correlation(8)
    views, start = inputs(band)
    probe = torch.randn(2, 8, 12, 6, 17, dtype=torch.float64)
    grads = [
        torch.autograd.grad((volume(*views, 12, start) * probe).sum(), views)[0]
        for volume in (BatchedCorrelation(plain), plain)
    ]
    torch.testing.assert_close(*grads, rtol=0, atol=1e-12)
