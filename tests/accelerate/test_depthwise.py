from copy import deepcopy

import pytest
import torch
from torch import nn

from mobilestereonet.accelerate.depthwise import (
    DepthwiseConv3d,
    DilatedDepthwiseConv2d,
    fast_depthwise,
)
from mobilestereonet.nets import build_model


def _gradients(conv: nn.Module, x: torch.Tensor, grad: torch.Tensor) -> list[torch.Tensor]:
    x = x.clone().requires_grad_()
    y = conv(x)
    y.backward(grad.to(y.dtype))
    return [y.detach(), x.grad, conv.weight.grad]


def _check(plain: nn.Module, kind: type, size: tuple[int, ...], channels_last: bool) -> None:
    fast = nn.Sequential(deepcopy(plain))
    fast_depthwise(fast)
    assert type(fast[0]) is kind
    plain, x = plain.double(), torch.randn(size, dtype=torch.float64)
    grad = torch.randn_like(plain(x))
    expected = _gradients(plain, x, grad)
    x = x.float()
    if channels_last:
        layout = torch.channels_last if x.dim() == 4 else torch.channels_last_3d
        x, fast = x.contiguous(memory_format=layout), fast.to(memory_format=layout)
    for value, exact in zip(_gradients(fast[0], x, grad), expected, strict=True):
        assert value.shape == exact.shape and torch.allclose(value.double(), exact, atol=1e-4)
    # bfloat16 holds 8 bits: compare with the size of the gradient.
    fast[0].weight.grad = None
    with torch.autocast("cpu", torch.bfloat16):
        values = _gradients(fast[0], x, grad)
    for value, exact in zip(values, expected, strict=True):
        error = torch.linalg.vector_norm(value.double() - exact)
        assert error < 0.02 * torch.linalg.vector_norm(exact)
    assert values[1].dtype == values[2].dtype == torch.float32


@pytest.mark.parametrize("stride", [1, 2])
@pytest.mark.parametrize("size", [(1, 12, 8, 6, 10), (2, 5, 7, 9, 3), (3, 32, 1, 2, 2)])
@pytest.mark.parametrize("channels_last", [True, False])
def test_gradients_in_3d(stride, size, channels_last):
    torch.manual_seed(0)
    options = {"stride": stride, "padding": 1, "groups": size[1], "bias": False}
    conv = nn.Conv3d(size[1], size[1], 3, **options)
    _check(conv, DepthwiseConv3d, size, channels_last)


@pytest.mark.parametrize("size", [(1, 128, 16, 24), (3, 5, 8, 4), (2, 16, 2, 2)])
@pytest.mark.parametrize("channels_last", [True, False])
def test_gradients_of_dilated_convolutions(size, channels_last):
    torch.manual_seed(0)
    options = {"padding": 2, "dilation": 2, "groups": size[1], "bias": False}
    conv = nn.Conv2d(size[1], size[1], 3, **options)
    _check(conv, DilatedDepthwiseConv2d, size, channels_last)


def test_a_whole_network():
    plain = build_model("msnet3d", max_disparity=32).double()
    fast = deepcopy(plain)
    fast_depthwise(fast)
    assert sum(isinstance(module, DepthwiseConv3d) for module in fast.modules()) == 22
    assert fast.state_dict().keys() == plain.state_dict().keys()
    assert sum(isinstance(module, DilatedDepthwiseConv2d) for module in fast.modules()) == 6
    left, right = torch.randn(2, 1, 3, 32, 64, dtype=torch.float64)
    for net in (plain, fast):
        sum(score.square().mean() for score in net.outputs(left, right).scores).backward()
    for (name, found), exact in zip(fast.named_parameters(), plain.parameters(), strict=True):
        error = torch.linalg.vector_norm(found.grad - exact.grad)
        assert error <= 1e-9 * torch.linalg.vector_norm(exact.grad) + 1e-12, name
