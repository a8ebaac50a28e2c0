"""What holds for all tests."""

import sys

import pytest

from mobilestereonet.cli.main import main


@pytest.fixture(autouse=True, scope="session")
def user_cache(tmp_path_factory):
    """Nothing is kept in the user's own cache, nor read from it."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.mktemp("cache")))
        yield


@pytest.fixture
def msnet(monkeypatch, capsys):
    """Runs the command line; gives exit code, stdout and stderr."""

    def run(*arguments):
        monkeypatch.setattr(sys, "argv", ["msnet", *map(str, arguments)])
        with pytest.raises(SystemExit) as ended:
            main()
        return ended.value.code or 0, *capsys.readouterr()

    return run
