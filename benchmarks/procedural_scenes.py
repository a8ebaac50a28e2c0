"""Benchmark: procedural scenes per second, as the recipe ``procedural`` draws them.

python benchmarks/procedural_scenes.py [--batches 4] [--batch-size 8] [--textures DIR]
"""

from __future__ import annotations

import argparse
import statistics
import time
from pathlib import Path

import torch
from rich.console import Console
from rich.table import Table

from mobilestereonet.scenes import ProceduralScenes
from mobilestereonet.training.batches import TrainingPairs
from mobilestereonet.training.recipe import get_recipe


def seconds_per_batch(scenes: ProceduralScenes, size: int, batches: int, augmented: bool) -> float:
    """Median time of a batch, after one to warm up."""
    recipe = get_recipe("procedural")
    pairs = TrainingPairs(scenes, recipe.augment, recipe.seed)
    make = pairs.__getitems__ if augmented else scenes.batch
    seconds = []
    for batch in range(batches + 1):
        started = time.perf_counter()
        make(range(batch * size, (batch + 1) * size))
        if scenes.device.type == "cuda":
            torch.cuda.synchronize()
        seconds.append(time.perf_counter() - started)
    return statistics.median(seconds[1:])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--batches", type=int, default=4, help="timed batches, the median counts")
    parser.add_argument("--batch-size", type=int, default=8)
    parser.add_argument("--textures", type=Path, help="folder of photographs")
    arguments = parser.parse_args()

    config = get_recipe("procedural").scenes
    table = Table(
        title=f"Scenes per second, {config.height} x {config.width}, "
        f"batches of {arguments.batch_size}"
    )
    table.add_column("device")
    table.add_column("rendered", justify="right")
    table.add_column("rendered and augmented", justify="right")
    places = [("cpu", 1), ("cpu", 2)] + [("cuda", 1)] * torch.cuda.is_available()
    for device, threads in places:
        torch.set_num_threads(threads)
        scenes = ProceduralScenes(config, textures=arguments.textures, device=device)
        rates = [
            arguments.batch_size
            / seconds_per_batch(scenes, arguments.batch_size, arguments.batches, augmented)
            for augmented in (False, True)
        ]
        name = device if device == "cuda" else f"{device}, {threads} thread{'s' * (threads > 1)}"
        table.add_row(name, *(f"{rate:.2f}" for rate in rates))
    Console().print(table)


if __name__ == "__main__":
    main()
