"""The Triton kernels against PyTorch, run by Triton's interpreter on the CPU.

Not a test file: `test_triton_kernels` runs it as a process, for TRITON_INTERPRET=1 must be set
before Triton is imported.
"""

import math
from copy import deepcopy
from functools import partial

import torch
import torch.nn.functional as F
from torch import nn

from mobilestereonet.accelerate.depthwise_triton import convolve, convolve_backward
from mobilestereonet.accelerate.norm_activation import batch_norm_activation, fuse_activations
from mobilestereonet.nets.blocks import V2Block, conv_norm

ACTIVATIONS = {
    (-math.inf, math.inf): nn.Identity(),
    (0.0, math.inf): nn.ReLU(),
    (0.0, 6.0): nn.ReLU6(),
}


def depthwise(size, stride, dtype):
    # Numbers that the type holds exactly; the weight is float32, as under autocast.
    x = torch.randn(size).to(dtype).requires_grad_()
    weight = torch.randn(size[1], 1, 3, 3, 3, requires_grad=True)
    exact = x.float()
    y = F.conv3d(exact, weight, stride=stride, padding=1, groups=size[1])
    grad = torch.randn_like(y).to(dtype)
    expected = [y, *torch.autograd.grad(y, (exact, weight), grad.float())]
    with torch.no_grad():
        found = [convolve(x, weight, stride), *convolve_backward(grad, x, weight, stride)]
    assert [value.dtype for value in found] == [dtype, dtype, torch.float32]
    for value, true in zip(found, expected, strict=True):
        rtol = 1e-4 if value.dtype == torch.float32 else 2**-7  # its last digits
        torch.testing.assert_close(value.float(), true, rtol=rtol, atol=1e-4)


def norm_activation(size, limits):
    kind = nn.BatchNorm2d if len(size) == 4 else nn.BatchNorm3d
    norm = kind(size[1]).double()
    nn.init.uniform_(norm.weight, 0.5, 4)
    nn.init.uniform_(norm.bias, -1, 2)
    # Values far from zero: squares must not lose the variance.
    x = (3 * torch.randn(size, dtype=torch.float64) + 20).requires_grad_()
    y = ACTIVATIONS[limits](norm(x))
    grad = torch.randn_like(y)
    mean = x.detach().transpose(0, 1).flatten(1).mean(1)
    expected = [y, *torch.autograd.grad(y, (x, norm.weight, norm.bias), grad), mean]
    inputs = [t.detach().float().requires_grad_() for t in (x, norm.weight, norm.bias)]
    result, mean, _ = batch_norm_activation(*inputs, norm.eps, *limits)
    found = [result, *torch.autograd.grad(result, inputs, grad.float()), mean]
    found = [value.double() for value in found]
    torch.testing.assert_close(found, expected, rtol=1e-4, atol=1e-3)


def block_and_its_activations():
    plain = nn.Sequential(
        V2Block(3, 8, 8, expansion=2), nn.ReLU(), *conv_norm(3, 8, 5), *conv_norm(3, 5, 8)
    )
    fused = deepcopy(plain)
    fuse_activations(fused)
    assert fused.state_dict().keys() == plain.state_dict().keys()
    # The one of 5 channels is left alone, with its activation.
    kinds = [nn.ReLU, nn.ReLU, nn.Identity]
    assert [type(module) for module in fused[1::3]] == kinds
    volume = torch.randn(2, 8, 3, 4, 6)
    for net in (plain, fused):
        net(volume).square().mean().backward()
    close = partial(torch.testing.assert_close, rtol=1e-3, atol=1e-4)
    close(dict(fused.state_dict()), dict(plain.state_dict()))
    for found, expected in zip(fused.parameters(), plain.parameters(), strict=True):
        close(found.grad, expected.grad)
    with torch.no_grad():
        close(fused.eval()(volume), plain.eval()(volume))


torch.manual_seed(0)
for size in ((2, 8, 5, 6, 3), (1, 40, 2, 3, 34)):
    depthwise(size, 1, torch.float32)
    depthwise(size, 2, torch.bfloat16)
for size in ((3, 40, 5, 7, 3), (2, 16, 9, 11), (1, 8, 1, 2100, 1)):
    for limits in ACTIVATIONS:
        norm_activation(size, limits)
block_and_its_activations()
