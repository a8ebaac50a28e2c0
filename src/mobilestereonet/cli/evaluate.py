"""``msnet evaluate``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from mobilestereonet.cli.engine import Device, Precision, Refine, Runtime, Threads, Weights


def evaluate(
    data: Annotated[str, typer.Option(help="Data set, such as kitti2015, sceneflow, folder.")],
    root: Annotated[Path, typer.Option(help="Folder in which its archives were unpacked.")],
    model: Annotated[
        list[str] | None,
        typer.Option(
            help="Model, as in predict. Repeat for more. Default: msnet3d, or what the weights "
            "hold."
        ),
    ] = None,
    weights: Weights = None,
    runtime: Runtime = "torch",
    precision: Precision = "fp32",
    threads: Threads = None,
    device: Device = "auto",
    refine: Refine = None,
    split: Annotated[
        str | None, typer.Option(help="Split of the data set. Default: its first.")
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
        list[float] | None, typer.Option(help="An n of px-n. Repeat for more. Default: 1 2 3.")
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

    from mobilestereonet.atomic import make_folder, refuse_folder
    from mobilestereonet.cli.engine import open_matcher
    from mobilestereonet.data import open_data_set
    from mobilestereonet.errors import InputError
    from mobilestereonet.evaluation import (
        EvaluationProtocol,
        authors_protocol,
        save_evaluations,
    )
    from mobilestereonet.evaluation import evaluate as run
    from mobilestereonet.settings import parse_assignments

    models: list[str | None] = [*model] if model else [None]
    if weights is not None and len(models) > 1:
        raise InputError(f"{weights} belongs to one model: give --model once, or not at all")
    options = parse_assignments(assignments or [])
    if split is not None:
        options["split"] = split
    pairs = open_data_set(data, root, **options)
    pairs.require_truth()
    protocol = authors_protocol(data) if authors else EvaluationProtocol()
    protocol = replace(protocol, max_disparity=max_disparity)
    # The padding is one of normalised views, which sgbm does not take.
    protocols = [replace(protocol, padding=None) if n == "sgbm" else protocol for n in models]
    engine = (runtime, precision, threads, device, refine)
    # Beside networks sgbm takes no part in the choice of their engine.
    opencv = ("torch", "fp32", None, "auto", None) if len(models) > 1 else engine
    matchers = [
        open_matcher(name, weights, *(opencv if name == "sgbm" else engine), padding=own.padding)
        for name, own in zip(models, protocols, strict=True)
    ]
    for folder in (pictures, json and json.parent):
        if folder is not None:
            make_folder(folder)
    if json is not None:
        refuse_folder(json)
    progress = Console(stderr=True)
    evaluations = []
    for matcher, own in zip(matchers, protocols, strict=True):
        title, quiet = f"{matcher.model} on {pairs}", not progress.is_terminal
        indices = track(range(len(pairs)), title, console=progress, transient=True, disable=quiet)
        evaluations.append(
            run(
                matcher.disparity,
                (pairs[index] for index in indices),
                model=matcher.model if weights is None else f"{matcher.model} ({weights.name})",
                data_name=str(pairs),
                protocol=own,
                thresholds=threshold or (1, 2, 3),
                batch_size=batch_size,
                pictures=None if pictures is None else pictures / matcher.model,
            )
        )
        Console().print(evaluations[-1].table(legend=False))
    Console().print(evaluations[-1].scores.legend())
    if json is not None:
        save_evaluations(evaluations, json)
