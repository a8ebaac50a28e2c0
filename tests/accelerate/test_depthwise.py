from copy import deepcopy

import pytest
import torch
from torch import nn

from mobilestereonet.accelerate.depthwise import (
    DepthwiseConv3d,
    DilatedDepthwiseConv2d,
    speed_up_depthwise,
)
from mobilestereonet.accelerate.optimise import fold_norms
from mobilestereonet.nets import create_model


def _gradients(conv: nn.Module, x: torch.Tensor, grad: torch.Tensor) -> list[torch.Tensor]:
    x = x.clone().requires_grad_()
    y = conv(x)
    y.backward(grad.to(y.dtype))
    return [y.detach(), x.grad, conv.weight.grad]


def _check(theirs: nn.Module, kind: type, size: tuple[int, ...], channels_last: bool) -> None:
    ours = nn.Sequential(deepcopy(theirs))
    speed_up_depthwise(ours)
    assert type(ours[0]) is kind
    theirs, x = theirs.double(), torch.randn(size, dtype=torch.float64)
    grad = torch.randn_like(theirs(x))
    expected = _gradients(theirs, x, grad)
    x = x.float()
    if channels_last:
        layout = torch.channels_last if x.dim() == 4 else torch.channels_last_3d
        x, ours = x.contiguous(memory_format=layout), ours.to(memory_format=layout)
    for value, exact in zip(_gradients(ours[0], x, grad), expected, strict=True):
        assert value.shape == exact.shape and torch.allclose(value.double(), exact, atol=1e-4)
    # bfloat16 holds 8 bits: compare with the size of the gradient.
    ours[0].weight.grad = None
    with torch.autocast("cpu", torch.bfloat16):
        values = _gradients(ours[0], x, grad)
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
    plain = create_model("msnet3d", max_disparity=32).double()
    fast = deepcopy(plain)
    speed_up_depthwise(fast)
    assert sum(isinstance(module, DepthwiseConv3d) for module in fast.modules()) == 22
    assert fast.state_dict().keys() == plain.state_dict().keys()
    assert sum(isinstance(module, DilatedDepthwiseConv2d) for module in fast.modules()) == 6
    left, right = torch.randn(2, 1, 3, 32, 64, dtype=torch.float64)
    for net in (plain, fast):
        sum(score.square().mean() for score in net.scores(left, right)).backward()
    for (name, ours), theirs in zip(fast.named_parameters(), plain.parameters(), strict=True):
        error = torch.linalg.vector_norm(ours.grad - theirs.grad)
        assert error <= 1e-9 * torch.linalg.vector_norm(theirs.grad) + 1e-12, name


@pytest.mark.parametrize("name", ["msnet2d", "msnet3d"])
def test_batch_norms_can_be_folded_in(name):
    torch.manual_seed(0)
    plain = create_model(name, max_disparity=32).eval()
    for module in plain.modules():
        if isinstance(module, nn.BatchNorm2d | nn.BatchNorm3d):
            nn.init.uniform_(module.bias, -0.5, 0.5)
    fast = deepcopy(plain)
    speed_up_depthwise(fast)
    fold_norms(fast)
    left, right = torch.randn(2, 1, 3, 32, 64)
    with torch.no_grad():
        assert (fast(left, right) - plain(left, right)).abs().max() < 0.05
