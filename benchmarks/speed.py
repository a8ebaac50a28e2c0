"""Speed and memory of every engine and precision against the paper's network as `nets/` has it.

    python benchmarks/speed.py [--models msnet2d msnet3d] [--sizes 256x512 384x1248 1088x1920]
        [--engines plain:fp32 torch:fp32 torch:bf16 ...] [--threads 2] [--plot growth.png]

Each measurement runs in a process of its own, on scikit-image's Motorcycle pair resized. Rounds
over all engines follow each other, so that a load on the machine meets them alike; medians over
all rounds count. On a busy machine ``--threads 1 --cpu-time`` counts the seconds in which a process
really ran. Peak memory is the highest resident size during inference less that after loading.
"of GEMM" is the share of the machine's own rate of matrix products, measured in the same rounds,
that an engine reaches on the exact MACs of `msnet cost`. Differences are those to the plain
formulation. Networks without embedded weights have fresh ones, which amplify rounding: their
differences say little.

"plain" is the network of ``nets/``, unaccelerated; "compile" (not among the default engines: it
takes minutes) is that network under torch.compile with inductor and freezing. "first" is the first
run, in which torch.compile compiles; in later rounds inductor has a cache. As on the command line,
the C library keeps freed memory.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
import torch.nn.functional as F
from rich.console import Console
from rich.table import Table
from torch import Tensor

from mobilestereonet.costs import count_costs
from mobilestereonet.data.motorcycle import motorcycle
from mobilestereonet.engines.benchmark import EagerNetwork
from mobilestereonet.engines.choose import open_engine
from mobilestereonet.memory import keep_freed_memory
from mobilestereonet.nets import StereoModel, build_model, model_info
from mobilestereonet.weights import embedded_models, load_model

ENGINES = (
    "plain:fp32",
    "torch:fp32",
    "torch:bf16",
    "onnxruntime:fp32",
    "openvino:fp32",
    "openvino:bf16",
)
TYPES = {"fp32": torch.float32, "bf16": torch.bfloat16}
GROWTH_SIZES = ("128x256", "256x512", "384x768", "512x1024")
GROWTH_RANGES = (64, 128, 192, 256, 320)


@dataclass(frozen=True)
class Case:
    """What one process measures."""

    model: str
    engine: str
    precision: str
    size: str
    max_disparity: int = 192

    @property
    def height_width(self) -> tuple[int, int]:
        height, width = self.size.split("x")
        return int(height), int(width)

    def macs(self) -> int:
        costs = count_costs(self.model, *self.height_width, {"max_disparity": self.max_disparity})
        return costs["total"].macs

    def net(self) -> StereoModel:
        torch.manual_seed(0)
        if self.model not in embedded_models() or self.max_disparity != 192:
            return build_model(self.model, max_disparity=self.max_disparity).eval()
        net = load_model(self.model)
        # As the authors estimate, for the differences; "mode" takes some percent more time.
        values = {} if net.config.band else {"coarse_pass": False, "coarse_levels": 1}
        net.config = replace(net.config, estimator="mean", **values)
        net.regression.estimator = "mean"
        return net

    def views(self) -> tuple[Tensor, Tensor]:
        pair = motorcycle()
        preprocessing = model_info(self.model).network.preprocessing
        left, right = (
            F.interpolate(preprocessing(view)[None], self.height_width, mode="bilinear")
            for view in (pair.left, pair.right)
        )
        return left, right

    def open(self, threads: int, device: str = "cpu") -> Callable[[Tensor, Tensor], Tensor]:
        torch.set_num_threads(threads)
        net = self.net()
        if self.engine in ("plain", "compile"):
            engine = EagerNetwork(net, device)
            if self.engine == "compile":
                engine.compile(options={"freezing": True})
        else:
            engine = open_engine(
                self.engine, net, device=device, precision=self.precision, threads=threads
            )
        return lambda left, right: engine(left, right).disparity


def measure(
    case: Case, *, threads: int, cpu_time: bool, repeats: int, output: str
) -> dict[str, Any]:
    """Seconds per repeat and peak memory; the disparity goes into the file ``output``."""
    clock = time.process_time if cpu_time else time.perf_counter
    engine = case.open(threads)
    views = case.views()
    reset_peak_memory()
    before = memory("VmRSS")
    started = clock()
    disparity = engine(*views)
    first = clock() - started
    np.save(output, disparity.float().numpy())
    seconds = []
    for _ in range(repeats):
        started = clock()
        engine(*views)
        seconds.append(clock() - started)
    return {"seconds": seconds, "first": first, "peak": memory("VmHWM") - before}


def reset_peak_memory() -> None:
    Path("/proc/self/clear_refs").write_text("5")


def memory(field: str) -> float:
    """A field of /proc/self/status, in MiB."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) / 1024 for line in lines if line.startswith(field))


def gemm_rate(precision: str, *, threads: int, cpu_time: bool) -> float:
    """MACs per second of a large matrix product, the best of some."""
    clock = time.process_time if cpu_time else time.perf_counter
    torch.set_num_threads(threads)
    a, b = torch.randn(2, 2048, 2048).to(TYPES[precision])
    seconds = []
    for _ in range(8):
        started = clock()
        a @ b
        seconds.append(clock() - started)
    return 2048**3 / min(seconds)


def apart(**options: Any) -> Any:
    """The result of `child` in a process of its own; None, with a line of why, if it failed."""
    done = subprocess.run(
        [sys.executable, __file__, "--child", json.dumps(options)],
        env={**os.environ, "OMP_NUM_THREADS": str(options["threads"])},
        capture_output=True,
        text=True,
    )
    if done.returncode:
        reason = (done.stderr.splitlines() or [f"exit status {done.returncode}"])[-1]
        print(f"{options.get('case') or options}: {reason}", file=sys.stderr)
        return None
    return json.loads(done.stdout.splitlines()[-1])


def child(options: dict[str, Any]) -> Any:
    keep_freed_memory()
    if "gemm" in options:
        return gemm_rate(options.pop("gemm"), **options)
    return measure(Case(**options.pop("case")), **options)


def run(cases: list[Case], *, rounds: int, repeats: int, **options: Any) -> list[dict[str, Any]]:
    """Records of all cases that could be measured, in their order; options as of `gemm_rate`."""
    seconds: dict[Any, list[float]] = defaultdict(list)
    first: dict[Case, float] = {}
    peak: dict[Case, float] = {}
    rates: dict[str, float] = defaultdict(float)
    disparity: dict[Case, Any] = {}
    with tempfile.TemporaryDirectory() as folder:
        output = str(Path(folder, "disparity.npy"))
        for _ in range(rounds):
            for precision in {case.precision for case in cases} & TYPES.keys():
                rate = apart(gemm=precision, **options)
                rates[precision] = max(rates[precision], rate)
            for case in cases:
                result = apart(case=asdict(case), repeats=repeats, output=output, **options)
                if result is not None:
                    seconds[case] += result["seconds"]
                    first.setdefault(case, result["first"])
                    peak[case] = max(peak.get(case, 0), result["peak"])
                    disparity[case] = np.load(output)
    records = []
    for case in peak:
        median = statistics.median(seconds[case])
        record = {**asdict(case), "seconds": median, "first": first[case], "peak": peak[case]}
        if case.precision in rates:
            record["gemm"] = case.macs() / median / rates[case.precision]
        yardstick = Case(case.model, "plain", "fp32", case.size, case.max_disparity)
        if yardstick in peak:
            record["ratio"] = statistics.median(seconds[yardstick]) / median
            record["peak_ratio"] = peak[case] / peak[yardstick]
            difference = np.abs(disparity[case] - disparity[yardstick])
            record |= {"max": float(difference.max()), "mean": float(difference.mean())}
        records.append(record)
    for precision, rate in rates.items():
        print(f"{precision}: {rate / 1e9:.0f} GMAC/s in matrix products")
    return records


COLUMNS = {
    "seconds": ("seconds", 3),
    "first": ("first", 1),
    "times faster": ("ratio", 2),
    "of GEMM": ("gemm", 2),
    "peak MiB": ("peak", 0),
    "of plain's": ("peak_ratio", 2),
    "max px": ("max", 3),
    "mean px": ("mean", 5),
}
"""Titles of columns: the figures below them, and their digits."""


def table(records: Iterable[dict[str, Any]], title: str) -> Table:
    result = Table("network", "size", "engine", title=title)
    for column in COLUMNS:
        result.add_column(column, justify="right")
    section = None
    for record in records:
        names = (record["model"], record["size"])
        if section not in (None, names):
            result.add_section()
        section = names
        cells = [
            f"{record[key]:.{digits}f}" if key in record else "" for key, digits in COLUMNS.values()
        ]
        result.add_row(*names, f"{record['engine']} {record['precision']}", *cells)
    return result


def plot(records: list[dict[str, Any]], file: Path) -> None:
    """Time against the image's size and against the range of disparities, one line per engine."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10, 5), layout="constrained")
    axes = figure.subplots(1, 2)
    lines: list[dict[str, list[tuple[float, float]]]] = [defaultdict(list), defaultdict(list)]
    for record in records:
        name = f"{record['model']}, {record['engine']} {record['precision']}"
        name = name.replace("plain fp32", "as the paper writes it")
        height, width = map(int, record["size"].split("x"))
        if record["max_disparity"] == 192:
            lines[0][name].append((height * width / 1e6, record["seconds"]))
        if record["size"] == "256x512":
            lines[1][name].append((record["max_disparity"], record["seconds"]))
    titles = ("image in megapixels, 192 disparities", "largest disparity in px, 256 x 512")
    for axis, series, title in zip(axes, lines, titles, strict=True):
        for name, points in series.items():
            axis.plot(*zip(*sorted(points), strict=True), marker="o", label=name)
        ticks = sorted({x for points in series.values() for x, _ in points})
        axis.set(xlabel=title, ylabel="seconds", xscale="log", yscale="log")
        axis.set_xticks(ticks, [f"{x:.3g}" for x in ticks])
        axis.minorticks_off()
        axis.grid(alpha=0.3)
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=3)
    figure.savefig(file, dpi=130)


def growth(models: list[str], engines: list[list[str]]) -> list[Case]:
    points = [(size, 192) for size in GROWTH_SIZES]
    points += [("256x512", disparities) for disparities in GROWTH_RANGES if disparities != 192]
    return [
        Case(model, *engine, *point) for model in models for engine in engines for point in points
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    packages = {"plain": "torch"}
    installed = [
        name
        for name in ENGINES
        if importlib.util.find_spec(packages.get(name.split(":")[0], name.split(":")[0]))
    ]
    parser.add_argument("--models", nargs="+", default=["msnet2d", "msnet3d"])
    parser.add_argument("--sizes", nargs="+", default=["256x512", "384x1248", "1088x1920"])
    parser.add_argument("--engines", nargs="+", default=installed, help="engine:precision")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--cpu-time", action="store_true", help="count CPU time, not wall time")
    parser.add_argument("--rounds", type=int, default=2)
    parser.add_argument("--repeats", type=int, default=3, help="timed runs per process")
    parser.add_argument("--json", type=Path, help="file for the figures")
    parser.add_argument("--plot", type=Path, help="file for a plot of how time grows (.png)")
    parser.add_argument("--child", type=json.loads, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.child:
        print(json.dumps(child(arguments.child)))
        return
    engines = [name.split(":") for name in arguments.engines]
    cases = [
        Case(model, *engine, size)
        for model in arguments.models
        for size in arguments.sizes
        for engine in engines
    ]
    options = {
        name: getattr(arguments, name) for name in ("rounds", "repeats", "threads", "cpu_time")
    }
    records = run(cases, **options)
    title = f"One pair, {arguments.threads} threads, median of {arguments.rounds} x "
    Console(width=120).print(table(records, title + f"{arguments.repeats} runs"))
    if arguments.plot:
        grown = run(growth(arguments.models, engines), **options)
        plot(grown, arguments.plot)
        records += grown
    if arguments.json:
        arguments.json.write_text(json.dumps(records, indent=2) + "\n")


if __name__ == "__main__":
    main()
