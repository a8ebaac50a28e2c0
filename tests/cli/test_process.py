"""The last resort of the command line, names of files in any encoding, and what is sent nowhere."""

import io
import logging
import os
import re
import sys
from pathlib import Path

import numpy as np
import pytest

from mobilestereonet.cli import process, progress
from mobilestereonet.cli.engine import busy_threads, cpu_threads
from mobilestereonet.data.files import write_png
from mobilestereonet.timing import long_work

PAIR = ("left.png", "right.png")


@pytest.fixture
def pair(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in PAIR:
        write_png(name, np.random.default_rng(0).integers(0, 255, (24, 40), dtype=np.uint8))


@pytest.mark.parametrize(
    ("error", "code", "words"),
    [
        (KeyError("x\n\x1b[1my"), 70, "a fault of msnet itself, KeyError: "),
        (RecursionError("too deep"), 70, "please report it"),
        (MemoryError(), 2, "not enough memory"),
        (ModuleNotFoundError("No module named 'cv2'", name="cv2"), 2, "opencv-python-headless"),
        (ModuleNotFoundError("No module named 'h5py.x'", name="h5py.x"), 2, "--no-deps h5py"),
        (ModuleNotFoundError("No module named 'odd'", name="odd"), 2, "put the package back that"),
        (
            ModuleNotFoundError("No module named 'mobilestereonet.x'", name="mobilestereonet.x"),
            70,
            "",
        ),
        (RuntimeError("DefaultCPUAllocator: can't allocate memory: you tried"), 2, "--tile"),
    ],
)
@pytest.mark.parametrize("debug", [False, True])
def test_what_nobody_foresaw_is_one_line(msnet, pair, monkeypatch, error, code, words, debug):
    def fail(*_, **__):
        raise error

    monkeypatch.setattr("mobilestereonet.inference.load_pair", fail)
    needed = ["opencv-python-headless>=4.10", "h5py>=3; extra == 'data'"]
    monkeypatch.setattr("importlib.metadata.requires", lambda name: needed)
    ended, _, err = msnet("doctor", *PAIR, *["--debug"] * debug)
    assert ended == code
    assert words in err.splitlines()[-1] and err.splitlines()[-1].startswith("msnet: ")
    assert ("Traceback" in err) == debug
    assert debug or (err.count("\n") == 1 and "\x1b" not in err)


def test_debug_may_stand_anywhere(msnet):
    assert msnet("--debug", "models", "msnet4d")[2].startswith("Traceback")
    assert "--debug" in msnet("--help")[1]


@pytest.mark.parametrize("encoding", ["ascii", "latin-1", "cp437", "utf-8"])
def test_names_that_the_terminal_lacks(msnet, pair, monkeypatch, encoding):
    names = [os.fsdecode(b"\xff\xe9.png"), "\u6df1\u5ea6.png"]
    for old, new in zip(PAIR, names, strict=True):
        Path(old).rename(new)
    out = io.TextIOWrapper(io.BytesIO(), encoding)
    monkeypatch.setattr(sys, "stdout", out)
    command = ("predict", *names, "-o", os.fsdecode(b"o\xff"), "--model", "sgbm")
    for more in ((), ("--json",)):
        assert msnet(*command, *more)[0] == 0
    out.flush()
    assert b"disparity.png" in out.buffer.getvalue()


def test_options_without_effect_are_told(msnet, pair):
    command = ("predict", *PAIR, "-o", "out", "--model", "sgbm")
    code, _, err = msnet(*command, "--precision", "bf16", "--runtime", "openvino", "--threads", 3)
    assert code == 0
    assert "sgbm runs in OpenCV alone: --runtime, --precision, --threads has no effect" in err


def test_what_the_environment_says_stays(monkeypatch):
    monkeypatch.setenv("OMP_WAIT_POLICY", "ACTIVE")
    monkeypatch.delenv("RAY_USAGE_STATS_ENABLED", raising=False)
    process.prepare_process()
    assert os.environ["OMP_WAIT_POLICY"] == "ACTIVE"
    assert os.environ["RAY_USAGE_STATS_ENABLED"] == "0"


def test_the_engines_report_to_nobody():
    from mobilestereonet.engines import onnxruntime  # noqa: F401

    assert os.environ["ORT_DISABLE_TELEMETRY"] == "1"


@pytest.fixture
def unmeasured():
    busy_threads.cache_clear()
    yield
    busy_threads.cache_clear()


def test_a_busy_machine_is_told_once(monkeypatch, capsys, unmeasured):
    import torch

    monkeypatch.setattr("mobilestereonet.engines.threads.fitting_threads", lambda: 1)
    monkeypatch.setattr(torch, "get_num_threads", lambda: 2)
    assert cpu_threads(None, "cpu") == 1
    assert cpu_threads(None, "cpu") == 1  # of another matcher
    assert capsys.readouterr().err == (
        "msnet: machine busy, using 1 thread (--threads 2 uses all)\n"
    )
    assert cpu_threads(2, "cpu") == 2
    assert cpu_threads(None, "cuda:0") is None
    busy_threads.cache_clear()
    monkeypatch.setattr(torch, "get_num_threads", lambda: 1)
    assert cpu_threads(None, "cpu") is None
    assert capsys.readouterr().err == ""


class AtOnce:
    """A timer that does not wait."""

    def __init__(self, seconds, function):
        self.start = function

    def cancel(self):
        """Too late."""


def test_long_work_is_shown(monkeypatch, capsys):
    process.prepare_process()
    log = logging.getLogger("mobilestereonet.engines.test")
    with long_work(log, "converting quickly"):
        pass
    assert capsys.readouterr().err == ""
    monkeypatch.setattr(progress, "Timer", AtOnce)
    with pytest.raises(KeyError), long_work(log, "converting"):
        raise KeyError
    assert capsys.readouterr().err == "msnet: converting ...\nmsnet: converting: 0 s\n"


def test_long_work_on_a_terminal_has_a_clock(monkeypatch):
    monkeypatch.setattr(progress, "Timer", AtOnce)
    monkeypatch.setenv("TERM", "xterm")
    terminal = io.StringIO()
    monkeypatch.setattr(terminal, "isatty", lambda: True, raising=False)
    monkeypatch.setattr(sys, "stderr", terminal)
    work = progress.LongWork("converting")
    assert work.end()
    assert re.search(r"converting.*0:00:02", terminal.getvalue())


def test_python_hears_of_long_work_by_its_logger(caplog):
    log = logging.getLogger("mobilestereonet.engines.test")
    with caplog.at_level(logging.INFO), long_work(log, "converting"):
        pass
    assert [record.message for record in caplog.records] == ["converting", "converting: 0 s"]
