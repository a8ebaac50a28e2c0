"""A network that is larger than any is refused before it fills the memory."""

from threading import Thread

import pytest
from torch import nn

from mobilestereonet.errors import InputError
from mobilestereonet.nets import build_model, limits


def test_networks_beyond_the_limits(monkeypatch):
    with pytest.raises(InputError, match="msnet2d with these values has more than 500,000,000 pa"):
        build_model("msnet2d", width=10**6)
    monkeypatch.setattr(limits, "MAX_MODULES", 300)
    with pytest.raises(InputError, match="msnet2d with these values has more than 300 layers"):
        build_model("msnet2d", hourglasses=100_000)
    build_model("msnet2d", max_disparity=32)  # nothing grows: it is built at once


def test_networks_of_other_threads_do_not_count(monkeypatch):
    monkeypatch.setattr(limits, "MAX_MODULES", 10)
    monkeypatch.setattr(limits, "MAX_PARAMETERS", 10)
    built = []

    def network(config):
        other = Thread(target=lambda: built.append(nn.Sequential(*[nn.Linear(9, 9)] * 30)))
        other.start()
        other.join()
        return nn.Sequential(nn.Identity())

    limits.check_size(network, None, "small")
    assert len(built) == 1
