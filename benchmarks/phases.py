"""Does a network prefer some sub-pixel phases? Its disparities modulo 4 px, and their errors.

    python benchmarks/phases.py [--root DIR] [--scenes 16] [--weights FILE ...] [--precision bf16]
        [--no-refine] [--picture phases.png]

Networks score every fourth disparity. Of the pixels whose disparity is within 1.5 px of the truth,
the histogram of the disparity modulo 4 px (even: 6.25 % in each quarter-pixel bin) and the median
signed error in each bin, over all pairs together; the ground truth's own phases at these pixels for
comparison. An unbiased network has the truth's histogram, and no median error anywhere.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from accuracy import matchers, real_and_synthetic, scenes
from mobilestereonet.data.sample import StereoSample
from mobilestereonet.inference import StereoMatcher

PLANES_PX = 4
"""Distance of the planes that a network scores, in px."""

BIN_PX = 0.25
"""Width of a bin of the histogram, in px."""

NEAR_PX = 1.5
"""Error up to which a pixel counts, in px: beyond, it is not fineness that lacks."""


class Phases(NamedTuple):
    """Disparities by their phase; a bin is `BIN_PX` wide.

    Attributes:
        share: Share of the disparities found in each bin, in %.
        truth: Share of the ground truth of the same pixels in each bin, in %.
        bias: Median of what is found minus the truth in each bin, in px; NaN in empty ones.
        pixels: Number of pixels.
    """

    share: NDArray[np.float64]
    truth: NDArray[np.float64]
    bias: NDArray[np.float64]
    pixels: int

    def __str__(self) -> str:
        """Extremes, and the share that would have to move for the truth's histogram."""
        moved = np.abs(self.share - self.truth).sum() / 2
        return (
            f"bins hold {self.share.min():.1f} to {self.share.max():.1f} % (the truth's "
            f"{self.truth.min():.1f} to {self.truth.max():.1f} %), {moved:.1f} % lie in another "
            f"bin's place; median error {np.nanmin(self.bias):+.2f} to "
            f"{np.nanmax(self.bias):+.2f} px; {self.pixels:,} pixels"
        )


def phases(found: NDArray[np.floating], truth: NDArray[np.floating]) -> Phases:
    """Phases of disparities near the truth.

    Args:
        found: Disparities in px, (N,).
        truth: Their ground truth in px, (N,).
    """
    near = np.abs(found - truth) < NEAR_PX
    found, truth = found[near], truth[near]
    bins = round(PLANES_PX / BIN_PX)
    index, true_index = (
        np.minimum((values % PLANES_PX / BIN_PX).astype(int), bins - 1) for values in (found, truth)
    )
    shares = [100 * np.bincount(i, minlength=bins) / max(i.size, 1) for i in (index, true_index)]
    error = found - truth
    bias = [np.median(error[index == i]) if (index == i).any() else np.nan for i in range(bins)]
    return Phases(*shares, np.array(bias), found.size)


def phases_of(matcher: StereoMatcher, samples: Iterable[StereoSample]) -> Phases:
    """Phases over the pixels of some pairs."""
    found, truth = [], []
    for sample in samples:
        (disparity,) = matcher.disparity(sample.left[None], sample.right[None]).numpy()
        true = sample.disparity.numpy()
        known = sample.valid.numpy() & (true > 0)
        found.append(disparity[known])
        truth.append(true[known])
    return phases(np.concatenate(found), np.concatenate(truth))


def plot(found: dict[str, Phases], path: Path) -> None:
    """Draw shares and median errors over the phase, one line per model."""
    figure = Figure(figsize=(7, 6), layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True)
    for index, (name, each) in enumerate(found.items()):
        edges = BIN_PX * np.arange(len(each.share) + 1)
        if index == 0:
            above.stairs(each.truth, edges, fill=True, color="0.85", label="ground truth")
        above.stairs(each.share, edges, label=name)
        below.plot(edges[:-1] + BIN_PX / 2, each.bias, marker=".", label=name)
    above.set_ylabel("share of the pixels, %")
    above.legend()
    below.axhline(0, color="0.7", linewidth=1)
    below.set_ylabel("median error, px")
    below.set_xlabel(f"disparity modulo {PLANES_PX} px")
    figure.savefig(path, dpi=120)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--root", type=Path, help="folder of the data sets' folders")
    parser.add_argument("--scenes", type=int, default=16, help="procedural scenes")
    parser.add_argument("--models", nargs="*", help="only these of the models")
    parser.add_argument("--weights", type=Path, nargs="*", default=[], help="further weights files")
    parser.add_argument("--no-refine", action="store_true", help="the networks' own disparity")
    parser.add_argument("--precision", default="fp32", help="the networks': fp32, bf16")
    parser.add_argument("--picture", type=Path, default=Path("phases.png"))
    arguments = parser.parse_args()

    samples = [each for _, pairs in real_and_synthetic(arguments.root) for each in pairs]
    groups = {"pairs": samples}
    if arguments.scenes:
        groups["scenes"] = list(scenes(arguments.scenes))
    found: dict[str, Phases] = {}
    for model, matcher in matchers(arguments.weights, arguments.precision).items():
        if arguments.models and model not in arguments.models:
            continue
        if arguments.no_refine:
            matcher = StereoMatcher(matcher.engine, name=model)
        found |= {f"{model}, {group}": phases_of(matcher, groups[group]) for group in groups}
    table = Table("from, px", *found, title="Share of the pixels, and median error in px")
    for index in range(round(PLANES_PX / BIN_PX)):
        cells = (f"{each.share[index]:.1f} % {each.bias[index]:+.2f}" for each in found.values())
        table.add_row(f"{BIN_PX * index:.2f}", *cells)
    Console(width=120).print(table)
    for name, each in found.items():
        print(f"{name}: {each}")
    plot(found, arguments.picture)


if __name__ == "__main__":
    main()
