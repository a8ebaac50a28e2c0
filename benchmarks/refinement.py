"""What each step of the refinement gains: D1, bad-1 and EPE after each of them.

    python benchmarks/refinement.py [ROW ...] [--root DIR] [--scenes 16] [--precision bf16]

A row is one of `accuracy.py`; without rows, the quality levels. Medians and means are over the real
pairs under ``--root`` (see `accuracy.py`) and over procedural scenes.
"""

from __future__ import annotations

import argparse
import statistics
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any
from unittest.mock import patch

import torch
from rich.console import Console
from rich.table import Table
from torch import Tensor

from accuracy import SYNTHETIC, open_row, real_and_synthetic, scenes
from mobilestereonet.data.sample import StereoSample, collate
from mobilestereonet.inference import StereoMatcher, refine
from mobilestereonet.inference.predict import predict_disparity
from mobilestereonet.inference.quality import QUALITIES
from mobilestereonet.inference.subpixel import fit_subpixel
from mobilestereonet.metrics import StereoMetrics

STEPS: dict[str, dict[str, Any]] = {
    "occlusions filled": {"NEIGHBOUR_STEPS_PX": ()},
    "edges, by colour alone": {"MATCHING_WEIGHT": 0.0},
    "edges, by colour and match": {"MATCHING_WEIGHT": refine.MATCHING_WEIGHT},
}
"""Constants of `inference.refine` that leave it at a step."""


def steps(matcher: StereoMatcher, left: Tensor, right: Tensor) -> Iterator[tuple[str, Tensor]]:
    """Disparity (1, H, W) of the network, and after each step of the refinement."""
    disparity, confidence = predict_disparity(
        matcher.engine, left, right, padding=None, tile="auto", refine=False, confidence=True
    )
    assert confidence is not None
    yield "none", disparity
    refined = disparity
    for name, constants in STEPS.items():
        with patch.multiple(refine, **constants):
            refined = refine.refine_disparity(disparity, confidence, left, right)
        yield name, refined
    yield "and fractions", fit_subpixel(refined, left, right)


@torch.inference_mode()
def figures(
    matcher: StereoMatcher, samples: Iterable[StereoSample]
) -> dict[str, list[dict[str, float]]]:
    """Figures of each pair by the name of the step."""
    found: dict[str, list[dict[str, float]]] = {}
    for sample in samples:
        batch = collate([sample])
        for name, disparity in steps(matcher, batch.left, batch.right):
            metrics = StereoMetrics()
            metrics.update(disparity, batch)
            found.setdefault(name, []).append(metrics.compute().masks["all"].per_image)
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("rows", nargs="*", default=[f"quality={name}" for name in QUALITIES])
    parser.add_argument("--root", type=Path, help="folder of the data sets' folders")
    parser.add_argument("--scenes", type=int, default=16, help="procedural scenes")
    parser.add_argument("--precision", default="bf16", help="the networks': fp32, bf16")
    arguments = parser.parse_args()

    sets = real_and_synthetic(arguments.root)
    real = [pair for name, pairs in sets if name not in SYNTHETIC for pair in pairs]
    groups = {"real": real, "scenes": list(scenes(arguments.scenes))}
    table = Table("row", "refinement", "pairs", "D1 median", "D1 mean", "bad-1, %", "EPE, px")
    for row in arguments.rows:
        name, matcher = open_row(row, arguments.precision)
        for group, samples in groups.items():
            for step, pairs in figures(matcher, samples).items():
                d1, bad1, epe = ([pair[key] for pair in pairs] for key in ("d1", "bad1", "epe"))
                cells = (f"{statistics.median(d1):.2f}", f"{statistics.mean(d1):.2f}")
                cells += (f"{statistics.mean(bad1):.1f}", f"{statistics.mean(epe):.3f}")
                table.add_row(name, step, group, *cells)
    Console(width=110).print(table)


if __name__ == "__main__":
    main()
