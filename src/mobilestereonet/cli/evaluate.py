"""``msnet evaluate``."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from mobilestereonet.cli.calibration import RigFiles
from mobilestereonet.cli.early import ends_in
from mobilestereonet.cli.engine import MatcherOptions, Precision
from mobilestereonet.cli.scoring import ScoringOptions
from mobilestereonet.cli.table_options import TableOptions
from mobilestereonet.errors import InputError


def evaluate(
    scoring: ScoringOptions,
    *,
    options: MatcherOptions,
    cameras: RigFiles,
    model: Annotated[
        list[str] | None,
        typer.Option(
            help="Model, as in predict. Repeat for more. Default: msnet3d-cascade, or what the "
            "weights hold."
        ),
    ] = None,
    precision: Precision = "fp32",
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
    tables: TableOptions,
) -> None:
    """Score models on a data set: EPE, D1, bad-t over all its masks.

    Several models are compared in one more table, which -o writes for a paper. With --rig raw
    views are rectified first; the ground truth is that of the rectified left view.
    """
    models: list[str | None] = [*model] if model else [None]
    if options.weights is not None and len(models) > 1:
        raise InputError(
            f"{options.weights} belongs to one model: give --model once, or not at all"
        )
    options = replace(options, precision=precision, settings=scoring.of_networks)
    # Beside networks sgbm takes no part in the choice of their engine and their configs.
    choices = [
        MatcherOptions(model=name)
        if name == "sgbm" and len(models) > 1
        else replace(options, model=name)
        for name in models
    ]

    from rich.console import Console

    from mobilestereonet.atomic import make_folder
    from mobilestereonet.evaluation import legend, save_evaluations

    pairs, printed, rectifier = scoring.open(), scoring.printed(), cameras.read()
    matchers = [scoring.open_matcher(chosen) for chosen in choices]
    if pictures is not None:
        make_folder(pictures)
    tables.prepare(json, csv, per_pair)
    evaluations = []
    for matcher in matchers:
        name = matcher.model + (f" ({options.weights.name})" if options.weights else "")
        place = None if pictures is None else pictures / matcher.model
        evaluations.append(scoring.score(matcher, pairs, name, place, rectifier))
        if tables.format is None:
            Console().print(evaluations[-1].table(legend=False))
    if tables.format is None:
        Console().print(legend(evaluations[-1].scores))
    save_evaluations(evaluations, json, csv, per_pair)
    if len(models) > 1 or tables.wanted or scoring.paper:
        rows = distinct([evaluation.model for evaluation in evaluations])
        networks = [matcher.model.partition(".")[0] for matcher in matchers]
        groups = {row: [one] for row, one in zip(rows, evaluations, strict=True)}
        tables.show(scoring.table(groups, dict(zip(rows, networks, strict=True)), printed))


def distinct(names: list[str]) -> list[str]:
    """Names, numbered where one comes again."""
    return [
        name if name not in names[:at] else f"{name} ({names[:at].count(name) + 1})"
        for at, name in enumerate(names)
    ]
