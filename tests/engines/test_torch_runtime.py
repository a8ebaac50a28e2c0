import pytest
import torch

from mobilestereonet import InputError, create_model
from mobilestereonet.engines.base import Runtime
from mobilestereonet.engines.torch import TorchRuntime

SMALL = {"max_disparity": 32, "hourglasses": 1, "width": 8}


@pytest.mark.parametrize("name", ["msnet2d", "msnet3d"])
def test_gives_what_the_network_gives_and_leaves_it_alone(name):
    net = create_model(name, **SMALL)
    before = {key: value.clone() for key, value in net.state_dict().items()}
    threads = torch.get_num_threads()
    runtime = TorchRuntime(net, threads=threads + 1)
    assert isinstance(runtime, Runtime)
    left, right = torch.randn(2, 2, 3, 32, 64)
    disparity = runtime(left, right)
    assert disparity.dtype == torch.float32
    assert not disparity.requires_grad
    assert torch.get_num_threads() == threads
    assert net.training
    assert all(value.is_contiguous() for value in net.parameters())
    assert all(net.state_dict()[key].equal(value) for key, value in before.items())
    with torch.no_grad():
        expected = net.eval()(left, right)
    torch.testing.assert_close(disparity, expected, rtol=0, atol=1e-3)


def test_takes_any_float_type():
    runtime = TorchRuntime(create_model("msnet2d", **SMALL))
    left, right = torch.randn(2, 1, 3, 16, 32, dtype=torch.float64)
    assert runtime(left, right).dtype == torch.float32


def test_refuses_no_threads():
    with pytest.raises(InputError, match="threads must be at least 1, got 0"):
        TorchRuntime(create_model("msnet2d", **SMALL), threads=0)
