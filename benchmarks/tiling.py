"""What tiles change, and what memory they need.

    python benchmarks/tiling.py [--root DIR] [--model msnet2d] [--tile 448 768] [--large]

Three measurements: how far a border reaches into the disparities (which the margins of the tiles
follow from); how far tiled and whole results differ on each pair, and beside it, where OpenVINO is
installed, what rounding alone changes: the whole pairs in OpenVINO instead of PyTorch; and with
``--large`` the peak memory of a pair of 3000 x 4000 px from files to result (minutes).
"""

from __future__ import annotations

import argparse
import importlib.util
import itertools
import resource
import tempfile
import time
from collections import defaultdict
from pathlib import Path

import cv2
import torch
from rich.console import Console
from rich.table import Table
from torch import Tensor

from accuracy import real_and_synthetic
from mobilestereonet.data.files import write_png
from mobilestereonet.data.images import to_picture
from mobilestereonet.data.motorcycle import motorcycle
from mobilestereonet.inference import StereoMatcher

STEPS = (0, 32, 64, 96, 128, 160, 224, 288, 320, 10_000)
"""Distances from a border, in px."""

LARGE = 0.5
"""Changes above this, in px, are counted."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--root", type=Path, help="folder of the data sets' folders")
    parser.add_argument("--model", default="msnet2d")
    parser.add_argument("--tile", type=int, nargs=2, default=(448, 768), metavar=("H", "W"))
    parser.add_argument("--large", action="store_true", help="measure 3000 x 4000 px")
    arguments = parser.parse_args()

    # The network's own disparities: the refinement looks at the whole picture in any case.
    matcher = StereoMatcher.from_pretrained(arguments.model, refine=False)
    if arguments.large:
        print(large_pair(matcher))
    others = {"tiles": StereoMatcher(matcher.engine, tile=tuple(arguments.tile))}
    if importlib.util.find_spec("openvino"):
        others["rounding"] = StereoMatcher.from_pretrained(
            arguments.model, engine="openvino", refine=False
        )
    columns = ("pair", "size", "by", "max", "99.9 %", "mean", f"pixels above {LARGE} px")
    changes = Table(*columns, title="change of the whole pair's disparities, px")
    reach: dict[str, list[Tensor]] = defaultdict(list)
    for _, samples in real_and_synthetic(arguments.root):
        for sample in samples:
            views = sample.left[None], sample.right[None]
            whole = matcher.disparity(*views)[0]
            size = "{} x {}".format(*whole.shape)
            for by, other in others.items():
                change = (other.disparity(*views)[0] - whole).abs()
                figures = change.max(), change.flatten().quantile(0.999), change.mean()
                cells = [f"{float(figure):.3f}" for figure in figures]
                changes.add_row(sample.name, size, by, *cells, str(int((change > LARGE).sum())))
            for side, maxima in border_reach(matcher, *views, whole).items():
                reach[side].append(maxima)
    console = Console(width=110)
    console.print(changes)
    table = Table("border", title="largest change by a border, px, by the distance from it")
    for low, high in itertools.pairwise(STEPS):
        table.add_column(f"{low}-{high}" if high < 10_000 else f"{low}-", justify="right")
    for side, maxima in reach.items():
        table.add_row(side, *(f"{float(v):.2f}" for v in torch.stack(maxima).amax(0)))
    console.print(table)


def border_reach(
    matcher: StereoMatcher, left: Tensor, right: Tensor, whole: Tensor
) -> dict[str, Tensor]:
    """Largest change per band of distances when everything beyond a border is cut away."""
    height, width = whole.shape
    above = -height % 16  # padding goes above: the grid of downsampling begins at the bottom
    row = height * 4 // 10 // 16 * 16 - above
    column = width * 4 // 10 // 16 * 16
    rows, columns = torch.arange(height)[:, None], torch.arange(width)
    windows = {
        "left": ((slice(None), slice(column, None)), columns - column),
        "right": ((slice(None), slice(0, column)), column - 1 - columns),
        "top": ((slice(row, None), slice(None)), rows - row),
        "bottom": ((slice(0, row), slice(None)), row - 1 - rows),
    }
    result = {}
    for side, (window, distance) in windows.items():
        part = matcher.disparity(left[(..., *window)], right[(..., *window)])[0]
        change = (part - whole[window]).abs()
        distance = distance.expand(height, width)[window]
        bands = [
            change[(distance >= low) & (distance < high)] for low, high in itertools.pairwise(STEPS)
        ]
        result[side] = torch.stack([b.max() if b.numel() else change.new_zeros(()) for b in bands])
    return result


def large_pair(matcher: StereoMatcher) -> str:
    """Peak resident memory of matching 12 megapixels, from files to result."""
    sample = motorcycle()
    with tempfile.TemporaryDirectory() as folder:
        paths = [Path(folder) / name for name in ("left.png", "right.png")]
        for path, view in zip(paths, (sample.left, sample.right), strict=True):
            write_png(path, cv2.resize(to_picture(view), (4000, 3000)))
        started = time.perf_counter()
        result = matcher(*paths)
    seconds = time.perf_counter() - started
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    height, width = result.disparity.shape
    return f"{height} x {width}: peak memory {peak:.2f} GiB, {seconds:.0f} s"


if __name__ == "__main__":
    main()
