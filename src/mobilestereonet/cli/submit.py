"""``msnet submit``."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from mobilestereonet.cli.early import BENCHMARK_SIZES, BENCHMARKS, one_of
from mobilestereonet.cli.engine import MatcherOptions, Precision
from mobilestereonet.cli.options import DataRoot, new_output

_NAMED = 6
"""Missing scenes that are named."""


def submit(
    benchmark: Annotated[
        str,
        typer.Argument(
            help="Benchmark: kitti2015, kitti2012, middlebury or eth3d.",
            metavar="BENCHMARK",
            callback=one_of(BENCHMARKS),
        ),
    ],
    root: DataRoot,
    output: Annotated[Path, new_output("submission.zip", "ZIP file to write.")],
    *,
    options: MatcherOptions,
    precision: Precision = "fp32",
    method: Annotated[
        str | None,
        typer.Option(help="Name of the method in Middlebury's files. Default: the model's."),
    ] = None,
    size: Annotated[
        str, typer.Option(help="Middlebury's size: Q, H or F.", callback=one_of(BENCHMARK_SIZES))
    ] = "Q",
    training_only: Annotated[
        bool,
        typer.Option("--training-only", help="Middlebury's training scenes alone, for a trial."),
    ] = False,
    partial: Annotated[
        bool,
        typer.Option("--partial", help="Pack the scenes that are there, for a trial of your own."),
    ] = False,
) -> None:
    """Write the archive that a benchmark's server takes, checked."""
    options = replace(options, precision=precision)

    from rich.console import Console
    from rich.progress import track

    from mobilestereonet.atomic import check_outputs, make_folder
    from mobilestereonet.evaluation import open_benchmark, plan_submission, write_submission

    matcher = options.open_matcher()
    check_outputs(output, kind="ZIP file")
    plan = plan_submission(benchmark, method or matcher.model, size, training_only)
    parts = open_benchmark(benchmark, root, size, training_only, partial)
    there = {frame.name.rpartition("/")[2] for part in parts for frame in part.frames}
    missing = [scene for scene in plan.maps if scene not in there] if partial else []
    plan = plan.only(there) if missing else plan
    make_folder(output.parent)
    places = [(part, index) for part in parts for index in range(len(part))]
    console = Console(stderr=True)
    quiet = not console.is_terminal
    progress = track(places, benchmark, console=console, transient=True, disable=quiet)
    pairs = (part[index] for part, index in progress)
    write_submission(plan, matcher.disparity, pairs, output)
    times = f", {len(plan.runtimes)} files with times" if plan.runtimes else ""
    told = f"{output}: {len(plan.maps)} disparity maps{times}"
    if missing:
        some = ", ".join(missing[:_NAMED]) + (", ..." if len(missing) > _NAMED else "")
        print(f"{told}; a trial, which the server refuses: it lacks {len(missing)} scenes, {some}")
    else:
        print(f"{told}; names, counts, types and sizes are as the server wants them")
