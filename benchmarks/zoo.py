"""Seconds and peak memory of every network in the paper's tables, plain and accelerated.

    python benchmarks/zoo.py -o docs/figures/zoo.json [--models psmnet gcnet ...] [--threads 2]
        [--seconds 60] [--time-limit 1800] [--memory-limit 23] [--size HEIGHTxWIDTH]
    python docs/figures/draw.py

Each network and form runs in a process of its own, in float32 and with fresh weights, on
scikit-image's Motorcycle pair resized to 256 x 512 (GA-Net: 288 x 576). "plain" is the network of
``nets/``, "accelerated" what the engine "torch" runs. After the first run as many are timed as fit
into some seconds, three at most; their median counts, or the first run where none fits. Peak memory
is the highest resident size during the runs less that after loading. A process that exceeds the
time or the memory (its whole resident size) is stopped, and the file says so.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import statistics
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import torch
from rich.console import Console
from rich.table import Table

from mobilestereonet.memory import keep_freed_memory
from mobilestereonet.nets import model_config
from mobilestereonet.paper.peers import compared_networks, comparison_size
from speed import Case, memory, reset_peak_memory

FORMS = {"plain": "plain", "accelerated": "torch"}
"""Forms of a network, and `Case`'s engines for them."""

RUNS = 3
"""Most timed runs after the first."""

POLL_SECONDS = 0.05
"""Time between two looks at the memory of a process."""


def case_of(model: str, form: str, size: str | None) -> Case:
    height, width = comparison_size(model)
    reach = model_config(model).max_disparity
    return Case(model, FORMS[form], "fp32", size or f"{height}x{width}", reach)


def measure(case: Case, threads: int, seconds: float) -> dict[str, float]:
    """Seconds of the first run and of those after it, and the peak memory in MiB."""
    engine, views = case.open(threads), case.views()
    reset_peak_memory()
    before = memory("VmRSS")
    times: list[float] = []
    while not times or (len(times) <= RUNS and sum(times) + times[-1] < seconds):
        started = time.perf_counter()
        engine(*views)
        times.append(time.perf_counter() - started)
    return {
        "seconds": statistics.median(times[1:] or times),
        "first": times[0],
        "runs": len(times),
        "peak_mib": memory("VmHWM") - before,
    }


def measure_apart(options: dict[str, Any], limits: tuple[float, float]) -> dict[str, Any]:
    """`measure` in a process of its own; "failure" says why there is nothing else.

    Args:
        options: Of `case_of` and `measure`.
        limits: Seconds and GiB.
    """
    time_limit, memory_limit = limits
    child = subprocess.Popen(
        [sys.executable, __file__, "--child", json.dumps(options)],
        env={**os.environ, "OMP_NUM_THREADS": str(options["threads"])},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    failure = None
    started = time.monotonic()
    while child.poll() is None and failure is None:
        if resident_gib(child.pid) > memory_limit:
            failure = f"does not fit in {memory_limit:g} GiB"
        elif time.monotonic() - started > time_limit:
            failure = f"took more than {time_limit:g} s"
        time.sleep(POLL_SECONDS)
    if failure is not None:
        child.kill()
    output, errors = child.communicate()
    if failure is None and child.returncode:
        lines = errors.splitlines() or [f"ended with status {child.returncode}"]
        failure = lines[-1]
    return {"failure": failure} if failure else json.loads(output.splitlines()[-1])


def resident_gib(process: int) -> float:
    try:
        pages = int(Path(f"/proc/{process}/statm").read_text().split()[1])
    except (FileNotFoundError, ProcessLookupError):
        return 0.0
    return pages * os.sysconf("SC_PAGE_SIZE") / 2**30


def processor() -> str:
    lines = Path("/proc/cpuinfo").read_text().splitlines()
    names = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(names, platform.machine())


def table(records: list[dict[str, Any]]) -> Table:
    result = Table("network", "form", "size")
    for column in ("seconds", "first", "times faster", "peak MiB"):
        result.add_column(column, justify="right")
    plain: dict[str, float] = {}
    for record in records:
        names = (record["model"], record["form"], record["size"])
        if "failure" in record:
            result.add_row(*names, record["failure"])
            continue
        plain.setdefault(record["model"], record["seconds"])
        ratio = plain[record["model"]] / record["seconds"]
        figures = (f"{record['seconds']:.3f}", f"{record['first']:.3f}", f"{ratio:.2f}")
        result.add_row(*names, *figures, f"{record['peak_mib']:.0f}")
    return result


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("-o", "--output", type=Path, help="file for the figures (.json)")
    parser.add_argument("--models", nargs="+", help="default: all of the paper's tables")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--seconds", type=float, default=60, help="of timed runs per process")
    parser.add_argument("--time-limit", type=float, default=1800, help="per process, in seconds")
    parser.add_argument("--memory-limit", type=float, default=23, help="per process, in GiB")
    parser.add_argument("--size", help="of the views, HEIGHTxWIDTH, for a quick look")
    parser.add_argument("--child", type=json.loads, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.child:
        keep_freed_memory()
        names = {key: arguments.child.pop(key) for key in ("model", "form", "size")}
        print(json.dumps(measure(case_of(**names), **arguments.child)))
        return
    machine = {"processor": processor(), "threads": arguments.threads, "torch": torch.__version__}
    records: list[dict[str, Any]] = []
    for model in arguments.models or compared_networks().values():
        for form in FORMS:
            names = {"model": model, "form": form, "size": arguments.size}
            options = {**names, "threads": arguments.threads, "seconds": arguments.seconds}
            limits = (arguments.time_limit, arguments.memory_limit)
            result = measure_apart(options, limits)
            records.append({**names, "size": case_of(**names).size, **result})
            print(records[-1], file=sys.stderr)
            if arguments.output:
                text = json.dumps({**machine, "records": records}, indent=1)
                arguments.output.write_text(text + "\n")
    Console(width=110).print(table(records))


if __name__ == "__main__":
    main()
