"""The help: panels, examples, a width of 80 columns; completion in the shell."""

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
import typer

from mobilestereonet.cli.main import app
from mobilestereonet.cli.panels import PANELS
from mobilestereonet.versions import packaged_versions

GROUP = typer.main.get_command(app)
COMMANDS = dict(GROUP.commands)
COMMANDS |= {f"data {name}": command for name, command in COMMANDS.pop("data").commands.items()}


@pytest.fixture
def narrow(monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.setenv("TERM", "dumb")


def panels(text):
    return re.findall(r"^╭─ ([\w ]+) ─", text, flags=re.M)


def test_the_commands_are_grouped(msnet, narrow):
    code, text, _ = msnet("--help")
    assert code == 0
    assert panels(text) == ["Options", "Match", "Cameras", "Networks and engines", "Research"]
    assert max(map(len, text.splitlines())) <= 80
    for option in ("--version", "--debug", "--install-completion"):
        assert option in text


def test_every_help_fits_80_columns_and_ends_in_an_example(msnet, narrow):
    for name, command in COMMANDS.items():
        text = msnet(*name.split(), "-h")[1]
        assert max(map(len, text.splitlines())) <= 80, name
        assert command.epilog in text, name  # whole, on one line
        assert "…" not in text, name
        flags = [line for line in text.splitlines() if "<bool>" in line]
        assert all("--help" in line for line in flags), name  # which is Typer's own
        shown = [panel for panel in panels(text) if panel not in ("Arguments", "Options")]
        assert shown == [panel for panel in PANELS if panel in shown], name
        assert not re.search(r"│ +\S{1,7} │$", text, flags=re.M)  # no column of single words


@pytest.mark.parametrize("name", ["predict", "video", "live", "batch", "train"])
def test_options_of_large_commands_are_all_in_panels(name):
    options = [p for p in COMMANDS[name].params if p.param_type_name == "option"]
    assert not [option.name for option in options if option.rich_help_panel is None]


def test_panels_hold_options_that_exist():
    known = {parameter.name for command in COMMANDS.values() for parameter in command.params}
    names = [name for names in PANELS.values() for name in names]
    assert set(names) <= known
    assert len(names) == len(set(names))


def test_examples_are_commands(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for file in ("left.png", "right.png", "stereo.yml", "runs/first/last.ckpt"):
        Path(file).parent.mkdir(parents=True, exist_ok=True)
        Path(file).touch()
    Path("runs/second").mkdir()
    Path("runs/second/last.ckpt").touch()
    Path("kitti").mkdir()
    for name, command in COMMANDS.items():
        head, *words = shlex.split(command.epilog.removeprefix("Example: "))
        assert head == "msnet"
        assert words[: len(name.split())] == name.split()
        command.make_context(name, words[len(name.split()) :])


COMPLETE = """
import os, sys
from mobilestereonet.cli.main import main

class Refuser:
    def find_spec(self, name, *_):
        if name in ("torch", "numpy", "cv2"):
            os._exit(3)

sys.meta_path.insert(0, Refuser())
sys.argv = ["msnet"]
os.environ["_MSNET_COMPLETE"] = "complete_bash"
for line in sys.stdin.read().splitlines():
    os.environ |= {"COMP_WORDS": line, "COMP_CWORD": str(line.count(" "))}
    try:
        main()
    except SystemExit:
        print("--")
"""

COMPLETED = {
    "msnet pre": ["predict"],
    "msnet predict --model sg": ["sgbm"],
    "msnet predict --model msnet2": ["msnet2d", *packaged_versions("msnet2d")],
    "msnet predict absent.png --quality b": ["balanced", "best"],
    "msnet predict --runtime open": ["openvino"],
    "msnet train run --recipe paper-k": ["paper-kitti2015"],
    "msnet train run --model gwcnet-gc": ["gwcnet-gc", "gwcnet-gc-base"],
    "msnet evaluate --data kitti20": ["kitti2012", "kitti2015"],
    "msnet export ope": ["openvino"],
    "msnet models psm": ["psmnet", "psmnet-basic"],
    "msnet predict --max-dep": ["--max-depth"],
}


def test_names_complete_without_heavy_imports():
    done = subprocess.run(
        [sys.executable, "-c", COMPLETE],
        input="\n".join(COMPLETED),
        capture_output=True,
        text=True,
        check=True,
        env=os.environ | {"_TYPER_COMPLETE_TEST_DISABLE_SHELL_DETECTION": "1"},
    )
    answers = [answer.split() for answer in done.stdout.split("--\n")[:-1]]
    assert dict(zip(COMPLETED, answers, strict=True)) == COMPLETED
