from copy import deepcopy

import pytest
import torch
from torch import nn

from mobilestereonet.nets import create_model
from mobilestereonet.training.depthwise import DepthwiseConv3d, speed_up_depthwise


def _gradients(conv: nn.Module, x: torch.Tensor, grad: torch.Tensor) -> list[torch.Tensor]:
    x = x.clone().requires_grad_()
    y = conv(x)
    y.backward(grad.to(y.dtype))
    return [y.detach(), x.grad, conv.weight.grad]


@pytest.mark.parametrize("stride", [1, 2])
@pytest.mark.parametrize("size", [(1, 12, 8, 6, 10), (2, 5, 7, 9, 3), (3, 32, 1, 2, 2)])
@pytest.mark.parametrize("channels_last", [True, False])
def test_the_gradients_are_those_of_torch(stride, size, channels_last):
    torch.manual_seed(0)
    channels = size[1]
    theirs = nn.Conv3d(
        channels, channels, 3, stride=stride, padding=1, groups=channels, bias=False
    ).double()
    ours = nn.Sequential(deepcopy(theirs).float())
    speed_up_depthwise(ours)
    assert isinstance(ours[0], DepthwiseConv3d)
    x = torch.randn(size, dtype=torch.float64)
    grad = torch.randn_like(theirs(x))
    expected = _gradients(theirs, x, grad)
    x = x.float()
    if channels_last:
        x = x.contiguous(memory_format=torch.channels_last_3d)
        ours = ours.to(memory_format=torch.channels_last_3d)
    for value, exact in zip(_gradients(ours[0], x, grad), expected, strict=True):
        assert torch.allclose(value.double(), exact, atol=1e-4)
    # bfloat16 holds 8 bits: compare with the size of the gradient.
    with torch.autocast("cpu", torch.bfloat16):
        ours[0].weight.grad = None
        values = _gradients(ours[0], x, grad)
    for value, exact in zip(values, expected, strict=True):
        error = torch.linalg.vector_norm(value.double() - exact)
        assert error < 0.02 * torch.linalg.vector_norm(exact)
    assert values[1].dtype == values[2].dtype == torch.float32


def test_a_whole_network():
    plain = create_model("msnet3d", max_disparity=32).double()
    fast = deepcopy(plain)
    speed_up_depthwise(fast)
    assert sum(isinstance(module, DepthwiseConv3d) for module in fast.modules()) == 22
    assert fast.state_dict().keys() == plain.state_dict().keys()
    left, right = torch.randn(2, 1, 3, 32, 64, dtype=torch.float64)
    for net in (plain, fast):
        sum(score.square().mean() for score in net.scores(left, right)).backward()
    for (name, ours), theirs in zip(fast.named_parameters(), plain.parameters(), strict=True):
        error = torch.linalg.vector_norm(ours.grad - theirs.grad)
        assert error <= 1e-9 * torch.linalg.vector_norm(theirs.grad) + 1e-12, name
