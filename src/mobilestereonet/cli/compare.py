"""``msnet compare``."""

from __future__ import annotations

import warnings
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from mobilestereonet.cli.early import WEIGHTS_ENDINGS, check_trained, each
from mobilestereonet.cli.engine import (
    Device,
    MatcherOptions,
    Precision,
    Refine,
    Runtime,
    Threads,
)
from mobilestereonet.cli.evaluate import distinct
from mobilestereonet.cli.scoring import ScoringOptions
from mobilestereonet.cli.table_options import TableOptions
from mobilestereonet.errors import InputError

if TYPE_CHECKING:
    from mobilestereonet.training.recipe import Recipe


def compare(
    sources: Annotated[
        list[str],
        typer.Argument(
            metavar="RUN...",
            help="Folders of `msnet train` or `msnet ablate`, and any models: names, weights "
            "files, sgbm, onnx:FILE.",
            callback=each(lambda option, source: check_trained(source, None, "RUN")),
        ),
    ],
    scoring: ScoringOptions,
    *,
    runtime: Runtime = "torch",
    precision: Precision = "fp32",
    device: Device = "auto",
    threads: Threads = None,
    refine: Refine = None,
    tables: TableOptions,
) -> None:
    """Score several runs and models on a data set, in one table.

    Runs that differ only by their seed are one row: the mean and the standard deviation over them.
    """
    options = MatcherOptions(
        runtime=runtime,
        precision=precision,
        device=device,
        threads=threads,
        refine=refine,
        settings=scoring.of_networks,
    )
    runs, others = _sort([run for source in sources for run in _runs_of(source)])

    from mobilestereonet.training.named_recipes import read_recipe
    from mobilestereonet.training.seeds import group_by_seed

    recipes = {str(run): read_recipe(run / "recipe.json") for run in runs}
    grouped = group_by_seed(recipes)
    pairs, printed = scoring.open(), scoring.printed()
    tables.prepare()
    # A run beside the embedded weights of its network is told apart by its folder.
    labels = (
        f"{label} ({names[0]})" if label in others else label for label, names in grouped.items()
    )
    rows = distinct([*labels, *others])
    members = [*grouped.values(), *([source] for source in others)]
    matchers = {
        name: scoring.open_matcher(_of_source(options, name, recipes.get(name)))
        for names in members
        for name in names
    }
    groups = {
        row: [scoring.score(matchers[name], pairs, name) for name in names]
        for row, names in zip(rows, members, strict=True)
    }
    networks = {
        row: matchers[names[0]].model.partition(".")[0]
        for row, names in zip(rows, members, strict=True)
    }
    tables.show(scoring.table(groups, networks, printed))


def _runs_of(source: str) -> list[str]:
    """The runs in the folder of an ablation; anything else as it is."""
    path = Path(source)
    if (path / "recipe.json").is_file():
        return [source]
    return sorted(str(recipe.parent) for recipe in path.glob("*/recipe.json")) or [source]


def _sort(sources: list[str]) -> tuple[list[Path], list[str]]:
    """Folders of runs, and other models; what a pattern such as ``runs/*`` finds beside is told."""
    runs: list[Path] = []
    others: list[str] = []
    for source in sources:
        path = Path(source)
        if (path / "recipe.json").is_file():
            if path.resolve() in [run.resolve() for run in runs]:
                raise InputError(f"{source} is given twice: leave one of them out")
            if not (path / "weights.safetensors").is_file():
                raise InputError(
                    f"{source}: the run has no weights.safetensors yet: go on with "
                    "`msnet train --resume`, or leave it out"
                )
            runs.append(path)
        elif path.is_file() and path.suffix == ".onnx" and not source.startswith("onnx:"):
            raise InputError(f"{source}: a network in a file of ONNX is given as onnx:{source}")
        elif path.is_file() and path.suffix not in WEIGHTS_ENDINGS:
            warnings.warn(f"{source}: neither a run nor weights, left out", stacklevel=2)
        else:
            others.append(source)
    if not runs and not others:
        raise InputError(f"{' '.join(sources)}: no run among them, which has a recipe.json")
    return runs, others


def _of_source(options: MatcherOptions, source: str, recipe: Recipe | None) -> MatcherOptions:
    if source == "sgbm":
        return MatcherOptions(model=source)
    if recipe is None:
        return replace(options, model=source)
    own = recipe.model if ".py:" in recipe.model else None
    return replace(options, model=own, weights=Path(source) / "weights.safetensors")
