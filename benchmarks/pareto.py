"""Pareto plot of an accuracy run: time per pair against the median D1 of the real pairs.

    python benchmarks/accuracy.py --root DIR --csv accuracy.csv
    python benchmarks/pareto.py accuracy.csv -o pareto.png [--column d1_noc]

Times of one file belong together: they were measured by turns on one machine (see `accuracy.py`).
"""

from __future__ import annotations

import argparse
import csv
from pathlib import Path

from accuracy import SYNTHETIC, Records, median, rows_of, times
from mobilestereonet.evaluation import ParetoPoint, plot_pareto

LABELS = {"sgbm": "StereoSGBM"}
TEXTS = ("model", "data", "pair")
"""Columns of the file that hold no numbers."""


def read(path: Path) -> Records:
    """Records of a file that ``accuracy.py --csv`` wrote: numbers, None where a cell is empty."""
    with path.open(newline="", encoding="utf-8") as file:
        return [
            {name: text if name in TEXTS else float(text) if text else None for name, text in row}
            for row in (line.items() for line in csv.DictReader(file))
        ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("file", type=Path, help="what accuracy.py --csv wrote")
    parser.add_argument("-o", "--output", type=Path, required=True, help="file for the plot (.png)")
    parser.add_argument("--column", default="d1_all", help="such as d1_all, bad1_noc, epe_all")
    arguments = parser.parse_args()
    real = [record for record in read(arguments.file) if record["data"] not in SYNTHETIC]
    by_row = rows_of(real)
    points = [
        ParetoPoint(LABELS.get(row, row), seconds, error)
        for row, (seconds, _) in times(real).items()
        if seconds is not None and (error := median(by_row[row], arguments.column)) is not None
    ]
    pairs = len(next(iter(by_row.values())))
    unit = "px" if arguments.column.startswith("epe") else "%"
    label = f"median {title(arguments.column)} of {pairs} real pairs, {unit}"
    plot_pareto(points, arguments.output, "seconds per pair (logarithmic)", label)


def title(column: str) -> str:
    """Words for a column: ``bad1_noc`` is bad-1 (non-occluded)."""
    figure, mask = column.split("_")
    name = figure.replace("bad", "bad-") if figure.startswith("bad") else figure.upper()
    return name if mask == "all" else f"{name} (non-occluded)"


if __name__ == "__main__":
    main()
