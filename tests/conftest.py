"""What holds for all tests."""

import pytest

from mobilestereonet.runtimes import choose


@pytest.fixture(autouse=True)
def engines(request, monkeypatch, tmp_path_factory):
    """Conversions are slow, and stay out of the user's cache: "auto" is PyTorch elsewhere."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.getbasetemp()))
    if request.path.parent.name != "runtimes":
        monkeypatch.setattr(choose, "_fastest", lambda device: "torch")
