"""Speed and memory on a GPU against the paper's network as `nets/` has it, in one table.

    python benchmarks/gpu.py [--models msnet2d msnet3d] [--sizes 256x512 384x1248 1088x1920]
        [--engines plain:fp32 torch:fp32 torch:bf16 torch:fp16] [--repeats 20]

Pairs, networks and engines are those of `speed.py`, ``compile:fp32`` among them; the pair is on the
GPU before the clock starts. Peak memory is what PyTorch allocates, weights included. Differences
are those to the first engine. PyTorch's settings are its own: float32 convolutions in TF32.
"""

from __future__ import annotations

import argparse
import statistics
import sys
import time

import torch
from rich.console import Console
from rich.table import Table
from torch import Tensor

from speed import Case

ENGINES = ("plain:fp32", "torch:fp32", "torch:bf16", "torch:fp16")
WARM_UP = 3
"""Runs before the clock starts."""

ENOUGH = 2.0
"""Seconds after which no further run is timed."""


def measure(case: Case, repeats: int) -> tuple[float, float, Tensor]:
    """Median seconds, peak memory in GiB, and the disparity."""
    engine = case.open(torch.get_num_threads(), "cuda")
    views = [view.cuda() for view in case.views()]
    torch.cuda.empty_cache()
    torch.cuda.reset_peak_memory_stats()
    for _ in range(WARM_UP):
        disparity = engine(*views).cpu()
    seconds: list[float] = []
    while len(seconds) < repeats and sum(seconds) < ENOUGH:
        torch.cuda.synchronize()
        started = time.perf_counter()
        engine(*views)
        torch.cuda.synchronize()
        seconds.append(time.perf_counter() - started)
    peak = torch.cuda.max_memory_allocated() / 1024**3
    return statistics.median(seconds), peak, disparity


def add_rows(table: Table, cases: list[Case], repeats: int) -> None:
    """One row per engine, of one network at one size, each compared with the first engine."""
    yardstick = None
    for case in cases:
        names = (case.model, case.size, f"{case.engine} {case.precision}")
        try:
            seconds, peak, disparity = measure(case, repeats)
        except RuntimeError as error:  # such as a lack of memory
            print(*names, error, file=sys.stderr)
            table.add_row(*names, "failed")
            continue
        figures = [f"{1000 * seconds:.2f}", f"{1 / seconds:.1f}", f"{peak:.2f}"]
        if case is cases[0]:
            yardstick = seconds, disparity
        if yardstick is not None:
            difference = (disparity - yardstick[1]).abs()
            figures.append(f"{yardstick[0] / seconds:.2f}")
            figures += [f"{float(difference.max()):.3f}", f"{float(difference.mean()):.5f}"]
        table.add_row(*names, *figures)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--models", nargs="+", default=["msnet2d", "msnet3d"])
    parser.add_argument("--sizes", nargs="+", default=["256x512", "384x1248", "1088x1920"])
    parser.add_argument("--engines", nargs="+", default=ENGINES, help="engine:precision")
    parser.add_argument("--repeats", type=int, default=20, help="timed runs at most")
    arguments = parser.parse_args()
    title = f"One pair, {torch.cuda.get_device_name()}, median of up to {arguments.repeats} runs"
    table = Table("network", "size", "engine", title=title)
    for column in ("ms", "frames/s", "peak GiB", "times faster", "max px", "mean px"):
        table.add_column(column, justify="right")
    for model in arguments.models:
        for size in arguments.sizes:
            cases = [Case(model, *name.split(":"), size) for name in arguments.engines]
            add_rows(table, cases, arguments.repeats)
            table.add_section()
    Console(width=120).print(table)


if __name__ == "__main__":
    main()
