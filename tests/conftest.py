"""What holds for all tests."""

import pytest


@pytest.fixture(autouse=True)
def user_cache(monkeypatch, tmp_path_factory):
    """Nothing is kept in the user's own cache."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.getbasetemp()))
