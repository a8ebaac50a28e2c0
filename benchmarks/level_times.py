"""Seconds of the quality levels against `msnet2d`'s, in turns in one process, not refined.

    python benchmarks/level_times.py [--sizes 256x512 384x1248] [--precisions bf16 fp32]
        [--rounds 9] [--accuracy FILE --output docs/figures/levels.json]

On scikit-image's Motorcycle pair, resized. Every round runs each of them once; the ratios are the
medians of those within a round, so that a load on the machine meets both alike. With the CSV that
`accuracy.py quality=fast quality=balanced quality=best sgbm --csv FILE` writes, ``--output`` keeps
what the charts of the documentation show: seconds at the last size, and the median D1 of the real
pairs.
"""

from __future__ import annotations

import argparse
import csv
import json
import statistics
import time
from pathlib import Path

import torch.nn.functional as F
from rich.console import Console
from rich.table import Table
from torch import Tensor

from accuracy import SYNTHETIC
from mobilestereonet import StereoMatcher
from mobilestereonet.data.motorcycle import motorcycle
from mobilestereonet.inference import QUALITIES

BASELINE, SGBM = "msnet2d", "sgbm"


def open_all(precision: str) -> dict[str, StereoMatcher]:
    """The baseline, the levels, and StereoSGBM, which has one precision."""
    values = {"precision": precision, "refine": False}
    found = {BASELINE: StereoMatcher.from_pretrained(BASELINE, **values)}
    found |= {name: StereoMatcher.from_pretrained(quality=name, **values) for name in QUALITIES}
    return found | {SGBM: StereoMatcher.from_pretrained(SGBM)}


def views(size: str) -> list[Tensor]:
    height, width = map(int, size.split("x"))
    pair = motorcycle()
    return [
        F.interpolate(view[None], (height, width), mode="bilinear", antialias=True)
        for view in (pair.left, pair.right)
    ]


def seconds_of(
    matchers: dict[str, StereoMatcher], size: str, rounds: int
) -> dict[str, list[float]]:
    """Seconds of each round, by name; one more round before them is not counted."""
    pair = views(size)
    seconds: dict[str, list[float]] = {name: [] for name in matchers}
    for _ in range(rounds + 1):
        for name, matcher in matchers.items():
            started = time.perf_counter()
            matcher.disparity(*pair)
            seconds[name].append(time.perf_counter() - started)
    return {name: times[1:] for name, times in seconds.items()}


def median_d1(path: Path, row: str) -> float:
    """Median D1 in % over the real pairs of a row of `accuracy.py`'s CSV."""
    with path.open(newline="", encoding="utf-8") as file:
        errors = [
            float(record["d1_all"])
            for record in csv.DictReader(file)
            if record["model"] == row and record["data"] not in SYNTHETIC
        ]
    if not errors:
        raise SystemExit(f"{path}: no real pair of the row {row}: run accuracy.py with it")
    return round(statistics.median(errors), 2)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--sizes", nargs="+", default=["256x512", "384x1248"])
    parser.add_argument("--precisions", nargs="+", default=["bf16", "fp32"])
    parser.add_argument("--rounds", type=int, default=9)
    parser.add_argument("--accuracy", type=Path, help="CSV of accuracy.py")
    parser.add_argument("--output", type=Path, help="the charts' JSON file; needs --accuracy")
    arguments = parser.parse_args()
    if arguments.output and not arguments.accuracy:
        parser.error("--output needs --accuracy FILE")
    columns = [
        f"{precision}, {size}" for precision in arguments.precisions for size in arguments.sizes
    ]
    table = Table("seconds (times msnet2d)", *columns)
    seconds: dict[str, dict[str, float]] = {}
    cells: dict[str, list[str]] = {}
    for precision in arguments.precisions:
        matchers = open_all(precision)
        for size in arguments.sizes:
            rounds = seconds_of(matchers, size, arguments.rounds)
            for name, times in rounds.items():
                ratios = [own / base for own, base in zip(times, rounds[BASELINE], strict=True)]
                median = seconds.setdefault(name, {})[precision] = statistics.median(times)
                text = f"{median:.3f} ({statistics.median(ratios):.2f})"
                cells.setdefault(name, []).append(text)
    for name, texts in cells.items():
        table.add_row(name, *texts)
    Console(width=110).print(table)
    if arguments.output:
        found = json.loads(arguments.output.read_text("utf-8"))
        found["height"], found["width"] = map(int, arguments.sizes[-1].split("x"))
        for level in found["levels"]:
            name = level["quality"]
            level["seconds"] |= {key: round(value, 2) for key, value in seconds[name].items()}
            level["d1_percent"] = median_d1(arguments.accuracy, f"quality={name}")
        found["sgbm"] = {
            "seconds": round(seconds[SGBM][arguments.precisions[0]], 2),
            "d1_percent": median_d1(arguments.accuracy, SGBM),
        }
        arguments.output.write_text(json.dumps(found, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
