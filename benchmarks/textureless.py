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
from mobilestereonet.data.sample import collate
from mobilestereonet.data.synthetic import ProceduralScenes, SceneConfig
from mobilestereonet.metrics import StereoMetrics

CONFIG = SceneConfig(
    height=384,
    width=768,
    min_disparity=60.0,
    seed=SCENE_SEED,
    kinds={"room": 0.3, "table": 0.4, "planes": 0.3},
)


def score(matcher, scenes: ProceduralScenes) -> tuple[float, ...]:
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
