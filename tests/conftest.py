"""What holds for all tests."""

import os
import sys

import pytest

from mobilestereonet.cli.main import main


def pytest_configure(config):
    """Share the cores out among the workers: threads that wait for each other take far longer.

    What the environment says holds: no test depends on how busy the machine is.
    """
    # The workers inherit what the process that starts them sets: their share, not all cores.
    started = os.environ.get("PYTEST_XDIST_WORKER_COUNT")
    workers = int(started or config.getoption("numprocesses", None) or 1)
    # Read when torch is imported, which is later.
    os.environ.setdefault("OMP_NUM_THREADS", str(max(1, (os.cpu_count() or 1) // workers)))


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


@pytest.fixture(params=["cpu", pytest.param("cuda", marks=pytest.mark.gpu)])
def device(request):
    """Device to run a test on: the CPU, and a GPU where there is one."""
    if request.param == "cuda":
        import torch

        if not torch.cuda.is_available():
            pytest.skip("no GPU")
    return request.param


@pytest.fixture(params=["float32", "float64"])
def dtype(request):
    """Data type to run a test in."""
    import torch

    return getattr(torch, request.param)
