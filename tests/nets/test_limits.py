"""A network that is larger than any is refused before it fills the memory."""

import pytest

from mobilestereonet.errors import InputError
from mobilestereonet.nets import build_model, limits


def test_networks_beyond_the_limits(monkeypatch):
    with pytest.raises(InputError, match="msnet2d with these values has more than 500,000,000 pa"):
        build_model("msnet2d", width=10**6)
    monkeypatch.setattr(limits, "MAX_MODULES", 300)
    with pytest.raises(InputError, match="msnet2d with these values has more than 300 layers"):
        build_model("msnet2d", hourglasses=100_000)
    build_model("msnet2d", max_disparity=32)  # nothing grows: it is built at once
