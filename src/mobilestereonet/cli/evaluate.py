"""``msnet evaluate``."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from mobilestereonet.cli.early import assignment, ends_in, one_of
from mobilestereonet.cli.engine import MatcherOptions, Precision
from mobilestereonet.cli.options import DataRoot, Split
from mobilestereonet.cli.sources import data_sets
from mobilestereonet.errors import InputError
from mobilestereonet.settings import parse_assignments


def evaluate(
    data: Annotated[
        str,
        typer.Option(
            help="Data set of `msnet data list`, such as kitti2015, sceneflow, folder.",
            callback=one_of(data_sets),
        ),
    ],
    root: DataRoot,
    *,
    options: MatcherOptions,
    model: Annotated[
        list[str] | None,
        typer.Option(
            help="Model, as in predict. Repeat for more. Default: msnet3d, or what the weights "
            "hold."
        ),
    ] = None,
    precision: Precision = "fp32",
    split: Split = None,
    settings: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            help="An option of the data set, such as size=H, or a value of the networks' configs "
            "in place of the weights' own, such as net.estimator=mean. Repeat for more.",
            callback=assignment,
        ),
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
        list[float] | None, typer.Option(help="A t of bad-t. Repeat for more. Default: 1 2 3.")
    ] = None,
    batch_size: Annotated[int, typer.Option(metavar="<n>", min=1, help="Pairs per call.")] = 1,
    pictures: Annotated[
        Path | None, typer.Option(help="Folder for error maps, one folder per model in it.")
    ] = None,
    json: Annotated[
        Path | None,
        typer.Option(
            help="JSON file for all figures, those of each pair too: a list of models.",
            callback=ends_in([".json"], "all figures are"),
        ),
    ] = None,
    csv: Annotated[
        Path | None,
        typer.Option(
            help="CSV file: means and medians, one row per model.",
            callback=ends_in([".csv"], "tables are"),
        ),
    ] = None,
    per_pair: Annotated[
        Path | None,
        typer.Option(
            help="CSV file, a row per model and pair.", callback=ends_in([".csv"], "tables are")
        ),
    ] = None,
) -> None:
    """Score models on a data set: EPE, D1, bad-t over all its masks."""
    models: list[str | None] = [*model] if model else [None]
    if options.weights is not None and len(models) > 1:
        raise InputError(
            f"{options.weights} belongs to one model: give --model once, or not at all"
        )
    of_network = [text for text in settings or () if text.startswith("net.")]
    of_data = parse_assignments([text for text in settings or () if text not in of_network])
    if split is not None:
        of_data["split"] = split
    options = replace(options, precision=precision, settings=of_network)
    # Beside networks sgbm takes no part in the choice of their engine and their configs.
    choices = [
        MatcherOptions(model=name)
        if name == "sgbm" and len(models) > 1
        else replace(options, model=name)
        for name in models
    ]

    from rich.console import Console
    from rich.progress import track

    from mobilestereonet.atomic import check_outputs, make_folder
    from mobilestereonet.data import open_data_set
    from mobilestereonet.evaluation import (
        EvaluationProtocol,
        authors_protocol,
        legend,
        save_evaluations,
    )
    from mobilestereonet.evaluation import evaluate as run

    pairs = open_data_set(data, root, **of_data)
    pairs.require_truth()
    protocol = authors_protocol(data) if authors else EvaluationProtocol()
    protocol = replace(protocol, max_disparity=max_disparity)
    # The padding is one of normalised views, which sgbm does not take.
    protocols = [replace(protocol, padding=None) if n == "sgbm" else protocol for n in models]
    matchers = [
        chosen.open_matcher(padding=own.padding)
        for chosen, own in zip(choices, protocols, strict=True)
    ]
    files = [file for file in (json, csv, per_pair) if file is not None]
    for folder in (pictures, *(file.parent for file in files)):
        if folder is not None:
            make_folder(folder)
    check_outputs(*files)
    progress = Console(stderr=True)
    evaluations = []
    for matcher, own in zip(matchers, protocols, strict=True):
        title, quiet = f"{matcher.model} on {pairs}", not progress.is_terminal
        indices = track(range(len(pairs)), title, console=progress, transient=True, disable=quiet)
        evaluations.append(
            run(
                matcher.disparity,
                (pairs[index] for index in indices),
                model=matcher.model + (f" ({options.weights.name})" if options.weights else ""),
                data_name=str(pairs),
                protocol=own,
                thresholds=threshold or (1, 2, 3),
                batch_size=batch_size,
                pictures=None if pictures is None else pictures / matcher.model,
            )
        )
        Console().print(evaluations[-1].table(legend=False))
    Console().print(legend(evaluations[-1].scores))
    save_evaluations(evaluations, json, csv, per_pair)
