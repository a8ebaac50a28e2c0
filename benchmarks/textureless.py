"""What large near surfaces without texture cost: procedural scenes with them and without.

    python benchmarks/textureless.py [--scenes 16] [--weights FILE ...] [--precision bf16]

Rooms, tables and slanted planes, near; the same layouts twice. Beside EPE and D1 the share of
pixels whose disparity is less than half of the truth: near surfaces taken for far ones.
"""

from __future__ import annotations

import argparse
import statistics
from dataclasses import replace
from pathlib import Path

from rich.console import Console
from rich.table import Table

from accuracy import SCENE_SEED, matchers
from mobilestereonet.data.synthetic import ProceduralScenes, SceneConfig

CONFIG = SceneConfig(
    height=384,
    width=768,
    min_disparity=60.0,
    seed=SCENE_SEED,
    kinds={"room": 0.3, "table": 0.4, "planes": 0.3},
)


def score(matcher, scenes: ProceduralScenes) -> tuple[float, ...]:
    """Means over scenes: EPE in px, D1 and the share of what is taken for far, in %."""
    rows = []
    for scene in scenes:
        (disparity,) = matcher.disparity(scene.left[None], scene.right[None])
        truth = scene.disparity
        mask = (truth > 0) & (truth < 192)
        truth, disparity = truth[mask], disparity[mask]
        error = (disparity - truth).abs()
        wrong = (error > 3) & (error > 0.05 * truth)
        shares = [100 * which.float().mean().item() for which in (wrong, disparity < truth / 2)]
        rows.append((error.mean().item(), *shares))
    return tuple(map(statistics.mean, zip(*rows, strict=True)))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--scenes", type=int, default=16, help="scenes of each sort")
    parser.add_argument("--weights", type=Path, nargs="*", default=[], help="further weights files")
    parser.add_argument("--precision", default="fp32", help="the networks': fp32, bf16")
    arguments = parser.parse_args()
    config = replace(CONFIG, length=arguments.scenes)
    sorts = {
        "textured": ProceduralScenes(config),
        "textureless": ProceduralScenes(replace(config, textureless=1.0)),
    }
    table = Table("model", "surfaces", "EPE, px", "D1, %", "less than half, %")
    for name, matcher in matchers(arguments.weights, arguments.precision).items():
        for sort, scenes in sorts.items():
            table.add_row(name, sort, *(f"{figure:.2f}" for figure in score(matcher, scenes)))
    Console(width=100).print(table)


if __name__ == "__main__":
    main()
