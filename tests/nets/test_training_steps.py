"""Networks train: gradients reach every parameter, a step lowers the loss."""

import pytest
import torch

from mobilestereonet.accelerate import accelerate
from mobilestereonet.nets import build_model
from small_views import for_small_views

SIZES = {  # max_disparity, height, width
    "gwcnet-gc": (32, 32, 64),
    "gwcnet-gc-base": (32, 32, 64),
    "gcnet": (32, 32, 64),
    "ganet-11": (12, 48, 96),
    "ganet-deep": (12, 48, 96),
    "fast-ds-cs": (32, 64, 64),
    "deeppruner-best": (32, 64, 64),
    "deeppruner-fast": (32, 64, 64),
}


@pytest.mark.parametrize("name", SIZES)
def test_a_step_lowers_the_loss_on_its_batch(name):
    torch.manual_seed(0)
    max_disparity, *size = SIZES[name]
    net = build_model(name, max_disparity=max_disparity)
    if name.startswith("deeppruner"):
        for_small_views(net)
    fast = accelerate(net, "training")
    left = torch.rand(2, 3, *size)
    pair = [net.preprocessing(view) for view in (left, left.roll(-5, -1))]
    disparity = torch.full((2, *size), 5.0)
    valid = torch.ones_like(disparity, dtype=torch.bool)
    disparity[:, :8], valid[:, :8] = torch.nan, False

    def loss():
        return net.training_loss(fast(*pair), disparity, valid)

    before = loss()
    before.backward()
    for key, parameter in net.named_parameters():
        assert parameter.grad is not None and parameter.grad.isfinite().all(), key
    assert sum(bool(p.grad.any()) for p in net.parameters()) > 0.9 * len([*net.parameters()])
    with torch.no_grad():
        for parameter in net.parameters():  # a small step, as long for every network
            norm = parameter.grad.norm()
            parameter -= 2e-3 * parameter.norm() * parameter.grad / norm.clamp_min(1e-12)
    assert loss() < before
