"""Does removing the least confident pixels lower the error? Curves and areas, pair by pair.

    python benchmarks/confidence.py [--root DIR] [--model msnet2d] [--picture curves.png]

Two ways to tell what to remove: the network's own confidence, and the left-right check.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from accuracy import real_and_synthetic
from mobilestereonet.evaluation.sparsification import plot_sparsification, sparsification
from mobilestereonet.inference import StereoMatcher


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--root", type=Path, help="folder of the data sets' folders")
    parser.add_argument("--model", default="msnet2d")
    parser.add_argument("--picture", type=Path, default=Path("sparsification.png"))
    arguments = parser.parse_args()

    matcher = StereoMatcher.from_pretrained(arguments.model, confidence=True, left_right=True)
    table = Table("pair", title=f"{arguments.model}: EPE in px without the least confident pixels")
    for column in ("all", "-10 %", "-20 %", "-50 %", "area", "failed check", "the rest"):
        table.add_column(column, justify="right")
    curves = []
    for name, samples in real_and_synthetic(arguments.root):
        for sample in samples:
            result = matcher(sample.left, sample.right)
            truth, known = sample.disparity.numpy(), sample.valid.numpy()
            known &= (truth > 0) & (truth < 192)
            error = np.abs(result.disparity - truth)[known]
            curve = sparsification(error, result.confidence[known])
            curves.append((f"{name} {sample.name}", curve))
            occluded = result.occluded[known]
            figures = [
                *(f"{curve.error[percent]:.2f}" for percent in (0, 10, 20, 50)),
                f"{curve.area:.3f}",
                f"{100 * occluded.mean():.1f} %",
                f"{error[~occluded].mean():.2f}",
            ]
            table.add_row(curves[-1][0], *figures)
    Console(width=110).print(table)
    print(f"mean area {np.mean([curve.area for _, curve in curves]):.3f}")
    plot_sparsification(curves, arguments.picture)


if __name__ == "__main__":
    main()
