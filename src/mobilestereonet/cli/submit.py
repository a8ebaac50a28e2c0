"""``msnet submit``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def submit(
    benchmark: Annotated[
        str, typer.Argument(help="kitti2015, kitti2012, middlebury or eth3d.", metavar="BENCHMARK")
    ],
    root: Annotated[Path, typer.Option(help="Folder in which its archives were unpacked.")],
    output: Annotated[Path, typer.Option("--output", "-o", help="ZIP file to write.")],
    model: Annotated[str, typer.Option(help="Network, or sgbm.")] = "msnet2d",
    weights: Annotated[Path | None, typer.Option(help="Weights file of the network.")] = None,
    method: Annotated[
        str | None,
        typer.Option(help="Name of the method in Middlebury's files. [default: the model's]"),
    ] = None,
    size: Annotated[str, typer.Option(help="Middlebury's size: Q, H or F.")] = "Q",
    training_only: Annotated[
        bool,
        typer.Option("--training-only", help="Middlebury's training scenes alone, for a trial."),
    ] = False,
) -> None:
    """Match a benchmark's pairs and write the archive that its server takes, checked."""
    from rich.console import Console
    from rich.progress import track

    from mobilestereonet.evaluation import (
        load_matcher,
        open_benchmark,
        plan_submission,
        write_submission,
    )

    plan = plan_submission(benchmark, method or model, size, training_only)
    parts = open_benchmark(benchmark, root, size, training_only)
    places = [(part, index) for part in parts for index in range(len(part))]
    progress = track(places, benchmark, console=Console(stderr=True), transient=True)
    pairs = (part[index] for part, index in progress)
    write_submission(plan, load_matcher(model, weights), pairs, output)
    print(
        f"{output}: {len(plan.maps)} disparity maps, {len(plan.runtimes)} times; "
        "names, counts, types and sizes are as the server wants them"
    )
