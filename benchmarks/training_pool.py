"""Training pairs per second: rendering, the pool with its augmentation, and the step.

    python benchmarks/training_pool.py [--model msnet2d] [--uses 1 2 4] [--pool 64] [--workers 1]
        [--device cuda] [--set augment.height=128 ...]

The recipe is ``procedural``. "rendered" counts the scenes, "used" the pairs that were trained on,
both from a cold start. "pool" is the rate at which batches come when nobody else takes time, after
the pool is full; "step" that of the training step alone, on noise.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from statistics import median

import torch
from rich.console import Console
from rich.table import Table
from torch.utils.data import DataLoader

from mobilestereonet.scenes import ProceduralScenes
from mobilestereonet.settings import parse_assignments
from mobilestereonet.training.batches import StepRequests, TrainingPairs, Uses
from mobilestereonet.training.named_recipes import get_recipe
from mobilestereonet.training.pool import PairPool
from mobilestereonet.training.recipe import Recipe, override
from training_step import our_steps, random_pairs


@dataclass
class Rates:
    """What the pool delivered."""

    rendered: int
    used: int
    per_second: float


def deliver(recipe: Recipe, uses: Uses, workers: int, device: str, steps: int) -> Rates:
    """Batches of ``steps`` steps, after those that fill the pool."""
    textures = None if recipe.textures is None else Path(recipe.textures)
    source = ProceduralScenes(recipe.scenes, textures=textures, device="cpu" if workers else device)
    filling = -(-uses.times * uses.pool // recipe.batch_size) if uses.times > 1 else 1
    requests = StepRequests(lambda: 0, filling + steps, recipe.batch_size, uses)
    loader = DataLoader(
        TrainingPairs(source, recipe.seed),
        sampler=requests,
        batch_size=None,
        num_workers=workers,
        collate_fn=lambda delivery: delivery,
        pin_memory=device == "cuda" and workers > 0,
    )
    pool = PairPool(recipe.augment, recipe.seed)
    rendered, started = 0, 0.0
    for step, delivery in enumerate(loader):
        if step == filling:
            started = time.perf_counter()
        rendered += len(delivery.loaded)
        there = {number: pair.to(device) for number, pair in delivery.loaded.items()}
        pool.batch(delivery._replace(loaded=there))
    if device == "cuda":
        torch.cuda.synchronize()
    seconds = time.perf_counter() - started
    size = recipe.batch_size
    return Rates(rendered, (filling + steps) * size, steps * size / seconds)


def scenes_per_second(recipe: Recipe, count: int) -> float:
    """Rate at which one worker renders."""
    scenes = ProceduralScenes(recipe.scenes)
    seconds = []
    for index in range(count + 1):
        started = time.perf_counter()
        scenes.batch([index])
        seconds.append(time.perf_counter() - started)
    return 1 / median(seconds[1:])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--model", default="msnet2d")
    parser.add_argument("--uses", type=int, nargs="+", default=[1, 2, 4])
    parser.add_argument("--pool", type=int, default=16)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--steps", type=int, default=8, help="timed steps of the pool")
    parser.add_argument("--repeats", type=int, default=3, help="timed steps of the network")
    parser.add_argument("--device", choices=("cpu", "cuda"), default="cpu")
    parser.add_argument("--set", dest="values", action="append", default=[], metavar="NAME=VALUE")
    arguments = parser.parse_args()
    recipe = override(get_recipe("procedural"), parse_assignments(arguments.values))
    recipe = replace(recipe, model=arguments.model)
    size, crop = recipe.batch_size, recipe.augment
    pairs = random_pairs(size, crop.height, crop.width)
    seconds = our_steps(arguments.model, pairs, arguments.device, False, arguments.repeats + 1)
    step = size / median(islice(seconds, 1, None))
    table = Table(
        title=f"{arguments.model}, batches of {size} x {crop.height} x {crop.width}, workers: "
        f"{arguments.workers} of {scenes_per_second(recipe, 4):.2f} scenes/s",
    )
    for column in ("uses", "rendered", "used", "pool, pairs/s", "step, pairs/s", "pool / step"):
        table.add_column(column, justify="right")
    for times in arguments.uses:
        uses = Uses(times, arguments.pool)
        rates = deliver(recipe, uses, arguments.workers, arguments.device, arguments.steps)
        cells = [times, rates.rendered, rates.used, f"{rates.per_second:.2f}", f"{step:.2f}"]
        table.add_row(*map(str, cells), f"{rates.per_second / step:.1f}")
    Console(width=100).print(table)


if __name__ == "__main__":
    main()
