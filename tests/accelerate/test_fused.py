"""Fused convolutions by oneDNN and, where PyTorch's private operators are missing, without."""

import pytest
import torch
from torch import nn

from mobilestereonet.accelerate import onednn
from mobilestereonet.accelerate.onednn import FusedConv, has_onednn_operators


@pytest.fixture
def fresh_detection():
    has_onednn_operators.cache_clear()
    yield
    has_onednn_operators.cache_clear()


@pytest.mark.parametrize("size", [(5, 6), (1, 1)])
@pytest.mark.parametrize("activation", ["none", "relu", "relu6"])
@pytest.mark.parametrize("by_onednn", [True, False])
def test_equals_the_layers(size, activation, by_onednn, monkeypatch):
    if not by_onednn:
        monkeypatch.setattr(onednn, "has_onednn_operators", lambda dtype: False)
    torch.manual_seed(0)
    conv = nn.Conv2d(4, 8, 3, padding=1, groups=2)
    layer = FusedConv(conv, activation)
    x, other = torch.randn(2, 4, *size), 4 * torch.randn(2, 8, *size)
    activate = {"none": nn.Identity(), "relu": nn.ReLU(), "relu6": nn.ReLU6()}[activation]
    with torch.inference_mode():
        torch.testing.assert_close(layer(x), activate(conv(x)))
        torch.testing.assert_close(layer(x, other.clone()), activate(conv(x) + other))


@pytest.mark.usefixtures("fresh_detection")
def test_missing_operators_are_detected(monkeypatch):
    def missing(*arguments, **options):
        raise AttributeError("'_OpNamespace' 'mkldnn' object has no attribute")

    monkeypatch.setattr(onednn, "_onednn", missing)
    assert not has_onednn_operators(torch.float32)


@pytest.mark.usefixtures("fresh_detection")
def test_operators_with_another_meaning_are_detected(monkeypatch):
    monkeypatch.setattr(onednn, "_onednn_sum", lambda x, other, *rest: onednn._onednn(x, *rest))
    assert not has_onednn_operators(torch.float32)
