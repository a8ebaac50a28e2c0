"""What large near surfaces without texture cost: procedural scenes with them and without.

    python benchmarks/textureless.py [ROW ...] [--scenes 16] [--square 60] [--weights FILE ...]
        [--precision bf16]

A row is one of `accuracy.py`; without rows, its own. Rooms, tables and slanted planes, near; the
same layouts twice. Beside EPE and D1 the share of pixels whose disparity is less than half of the
truth: near surfaces taken for far ones. Then squares of one colour before a textured wall, scored
inside: their borders alone tell their disparity, so the side from which on they fail tells how far
a method sees.
"""

from __future__ import annotations

import argparse
import statistics
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from rich.console import Console
from rich.table import Table

from accuracy import SCENE_SEED, matchers
from mobilestereonet.data.sample import StereoSample, collate
from mobilestereonet.metrics import StereoMetrics
from mobilestereonet.scenes import ProceduralScenes, SceneConfig
from mobilestereonet.scenes.noise import noise_field

CONFIG = SceneConfig(
    height=384,
    width=768,
    min_disparity=60.0,
    seed=SCENE_SEED,
    kinds={"room": 0.3, "table": 0.4, "planes": 0.3},
)

SQUARES = (64, 128, 192, 256, 384)
"""Sides of the squares, in px."""

SQUARE, WALL = 60, 20
"""Disparity of the squares, and of the wall behind them, in px."""

NOISE = 0.008
"""Standard deviation of the sensor's noise in each view, of a full range of 1."""


def squares(side: int, count: int, disparity: int = SQUARE) -> Iterator[StereoSample]:
    """Pairs of 480 x 1024 px with one square each; valid in the square only."""
    height, width = 480, 1024
    top, left = (height - side) // 2, (width - side) // 2
    rng = np.random.default_rng([SCENE_SEED, side])
    for index in range(count):
        wall = np.stack([noise_field(rng, 1152, 1.0)[:height] for _ in range(3)])
        colour = rng.uniform(0.2, 0.8, (3, 1, 1))
        views = wall[..., :width].copy(), wall[..., WALL : WALL + width].copy()
        for view, shift in zip(views, (0, disparity), strict=True):
            view[:, top : top + side, left - shift : left - shift + side] = colour
            view += rng.normal(0, NOISE, view.shape)
        valid = torch.zeros(height, width, dtype=torch.bool)
        valid[top : top + side, left : left + side] = True
        yield StereoSample(
            *(torch.from_numpy(view.clip(0, 1)) for view in views),
            disparity=disparity * valid.float(),
            valid=valid,
            name=f"{side}-{index}",
        )


def score(matcher, scenes: Iterable[StereoSample]) -> tuple[float, ...]:
    """Means over scenes: EPE in px, D1 and the share of what is taken for far, in %."""
    metrics, far = StereoMetrics(), []
    for scene in scenes:
        batch = collate([scene])
        disparity = matcher.disparity(batch.left, batch.right)
        metrics.update(disparity, batch)
        scored = (batch.disparity > 0) & (batch.disparity < metrics.max_disparity)
        far.append(100 * (disparity < batch.disparity / 2)[scored].float().mean().item())
    figures = metrics.compute().masks["all"].per_image
    return figures["epe"], figures["d1"], statistics.mean(far)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("rows", nargs="*", metavar="ROW", help="name or file[,setting=value ...]")
    parser.add_argument(
        "--scenes", type=int, default=16, help="scenes of each sort; half as many squares"
    )
    parser.add_argument(
        "--square", type=int, default=SQUARE, help=f"disparity of the squares; the wall has {WALL}"
    )
    parser.add_argument("--weights", type=Path, nargs="*", default=[], help="further weights files")
    parser.add_argument("--precision", default="fp32", help="the networks': fp32, bf16")
    arguments = parser.parse_args()
    config = replace(CONFIG, length=arguments.scenes)
    sorts = {
        "textured": ProceduralScenes(config),
        "textureless": ProceduralScenes(replace(config, textureless=1.0)),
    } | {
        f"squares of {side} px": list(squares(side, (arguments.scenes + 1) // 2, arguments.square))
        for side in SQUARES
    }
    table = Table("model", "surfaces", "EPE, px", "D1, %", "less than half, %")
    for name, matcher in matchers(arguments.weights, arguments.precision, arguments.rows).items():
        for sort, scenes in sorts.items():
            table.add_row(name, sort, *(f"{figure:.2f}" for figure in score(matcher, scenes)))
    Console(width=100).print(table)


if __name__ == "__main__":
    main()
