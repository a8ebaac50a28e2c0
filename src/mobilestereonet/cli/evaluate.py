"""``msnet evaluate``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def evaluate(
    data: Annotated[str, typer.Option(help="Data set, such as kitti2015, sceneflow, folder.")],
    root: Annotated[Path, typer.Option(help="Folder in which its archives were unpacked.")],
    model: Annotated[
        list[str] | None,
        typer.Option(help="Network, or sgbm. Repeat for more. [default: msnet2d]"),
    ] = None,
    weights: Annotated[Path | None, typer.Option(help="Weights file of the network.")] = None,
    split: Annotated[
        str | None, typer.Option(help="Split of the data set. [default: its first]")
    ] = None,
    assignments: Annotated[
        list[str] | None,
        typer.Option("--set", help="An option of the data set, such as size=H. Repeat for more."),
    ] = None,
    authors: Annotated[
        bool,
        typer.Option(
            "--authors-protocol",
            help="Crop, pad and skip images as the paper's authors do on this data set.",
        ),
    ] = False,
    max_disparity: Annotated[
        float, typer.Option(help="Score ground truth below this, in px; inf for all of it.")
    ] = 192,
    threshold: Annotated[
        list[float] | None, typer.Option(help="An n of px-n. Repeat for more. [default: 1 2 3]")
    ] = None,
    batch_size: Annotated[int, typer.Option(min=1, help="Pairs per call.")] = 1,
    pictures: Annotated[
        Path | None, typer.Option(help="Folder for error maps, one folder per model in it.")
    ] = None,
    json: Annotated[
        Path | None, typer.Option(help="File for the figures: a list, one record per model.")
    ] = None,
) -> None:
    """Score models on a data set: EPE, D1 and px-n over all its masks."""
    from dataclasses import replace

    from rich.console import Console
    from rich.progress import track

    from mobilestereonet.cli.assignments import parse_assignments
    from mobilestereonet.data import open_data_set
    from mobilestereonet.errors import InputError
    from mobilestereonet.evaluation import (
        EvaluationProtocol,
        authors_protocol,
        load_matcher,
        save_evaluations,
    )
    from mobilestereonet.evaluation import evaluate as run

    models = model or ["msnet2d"]
    if weights is not None and len(models) > 1:
        raise InputError(f"--weights {weights} belongs to one --model, not to {', '.join(models)}")
    options = parse_assignments(assignments or [])
    if split is not None:
        options["split"] = split
    pairs = open_data_set(data, root, **options)
    protocol = authors_protocol(data) if authors else EvaluationProtocol()
    protocol = replace(protocol, max_disparity=max_disparity)
    progress = Console(stderr=True)
    evaluations = []
    for name in models:
        indices = track(range(len(pairs)), f"{name} on {pairs}", console=progress, transient=True)
        result = run(
            load_matcher(name, weights),
            (pairs[index] for index in indices),
            model=name if weights is None else f"{name} ({weights.name})",
            data_name=str(pairs),
            protocol=protocol,
            thresholds=threshold or (1, 2, 3),
            batch_size=batch_size,
            pictures=None if pictures is None else pictures / name,
        )
        Console().print(result)
        evaluations.append(result)
    if json is not None:
        save_evaluations(evaluations, json)
