"""Seconds from the command line to the first result, and where they go.

    python benchmarks/cold_start.py [--models msnet2d msnet3d] [--engines torch ...] [--rounds 3]

Each command runs in a process of its own, as a user starts it, in turns; the median of the rounds
counts. The pair is scikit-image's Motorcycle (500 x 741). Converted networks are in their cache
before the clock starts.
"""

from __future__ import annotations

import argparse
import importlib.util
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from pathlib import Path

from rich.console import Console
from rich.table import Table

PYTHON = sys.executable
BARE = {
    "python": [PYTHON, "-c", "pass"],
    "import numpy": [PYTHON, "-c", "import numpy"],
    "import torch": [PYTHON, "-c", "import torch"],
    "msnet --help": [PYTHON, "-m", "mobilestereonet", "--help"],
}
ENGINES = ("torch", "onnxruntime", "openvino")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    installed = [name for name in ENGINES if importlib.util.find_spec(name)]
    parser.add_argument("--models", nargs="+", default=["msnet2d", "msnet3d"])
    parser.add_argument("--engines", nargs="+", default=installed, choices=ENGINES)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--rounds", type=int, default=3)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        demo = [PYTHON, "-m", "mobilestereonet", "demo", "-o", folder]
        subprocess.run(demo, check=True, stdout=subprocess.DEVNULL)  # leaves its pair
        views = [str(Path(folder, f"{name}.png")) for name in ("left", "right")]
        commands = dict(BARE)
        for model in arguments.models:
            for engine in arguments.engines:
                commands[f"msnet predict --model {model} --runtime {engine}"] = [
                    *(PYTHON, "-m", "mobilestereonet", "predict", *views, "-o", folder),
                    *("--model", model, "--runtime", engine),
                    *("--threads", str(arguments.threads)),
                ]
        seconds = measure(commands, arguments.threads, arguments.rounds)
    table = Table("command", title=f"{arguments.threads} threads, median of {arguments.rounds}")
    for column in ("seconds", "of the processor"):
        table.add_column(column, justify="right")
    for name, times in seconds.items():
        table.add_row(
            name, *(f"{statistics.median(time):.2f}" for time in zip(*times, strict=True))
        )
    Console(width=100).print(table)


def measure(
    commands: dict[str, list[str]], threads: int, rounds: int
) -> dict[str, list[tuple[float, float]]]:
    """Seconds, and seconds of processor time, of each command and round; one more warms up."""
    seconds: dict[str, list[tuple[float, float]]] = defaultdict(list)
    for turn in range(rounds + 1):
        for name, command in commands.items():
            started, before = time.perf_counter(), sum(os.times()[2:4])
            subprocess.run(
                command,
                check=True,
                stdout=subprocess.DEVNULL,
                env={**os.environ, "OMP_NUM_THREADS": str(threads)},
            )
            if turn:
                wall = time.perf_counter() - started
                seconds[name].append((wall, sum(os.times()[2:4]) - before))
    return seconds


if __name__ == "__main__":
    main()
