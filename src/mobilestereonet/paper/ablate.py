"""Ablations: variants of a recipe, each with some seeds, trained and scored on the same pairs."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from mobilestereonet.atomic import write_text
from mobilestereonet.errors import InputError
from mobilestereonet.evaluation import (
    PAPER_COLUMNS,
    EvaluationProtocol,
    ResultTable,
    comparison_table,
    evaluate,
)
from mobilestereonet.inference import StereoMatcher
from mobilestereonet.nets import list_models, model_config
from mobilestereonet.paper.tables import printed_errors
from mobilestereonet.settings import build, choice_hint
from mobilestereonet.text import read_json
from mobilestereonet.training.data import RunData
from mobilestereonet.training.named_recipes import read_recipe
from mobilestereonet.training.recipe import Recipe, override
from mobilestereonet.training.run import train
from mobilestereonet.training.seeds import variation_label

TABLES = ("2", "3a", "3b", "appendix2d", "appendix3d")
"""The paper's ablations, by what `table_models` takes."""


def table_models(table: str) -> list[str]:
    """Names of the networks in one of the paper's ablation tables.

    Raises:
        InputError: If the table is unknown.
    """
    if table not in TABLES:
        raise InputError(f"unknown table {table!r}: {choice_hint(table, TABLES)}")
    prefix = table if table.startswith("appendix") else f"table{table}"
    return [model for model in list_models() if model.startswith(f"{prefix}-")]


@dataclass(frozen=True)
class Variant:
    """One run of an ablation.

    Attributes:
        label: Name of its row: the network and the values that are varied.
        folder: Name of its folder.
        recipe: How it is trained.
    """

    label: str
    folder: str
    recipe: Recipe


def variants(
    recipe: Recipe,
    models: Sequence[str],
    vary: Mapping[str, Sequence[Any]] | None = None,
    seeds: int = 1,
) -> list[Variant]:
    """Every combination of networks and values, with some seeds each.

    Args:
        recipe: The recipe; its own model does not matter.
        models: Names of networks.
        vary: Values of the recipe by name, such as ``{"lr": [1e-3, 5e-4]}``.
        seeds: Runs of each combination: the recipe's seed and those after it.

    Raises:
        InputError: If a name or value is none of the recipe's or of a network's, or one is given
            twice.
    """
    vary = vary or {}
    found: list[Variant] = []
    for model, *values in product(dict.fromkeys(models), *vary.values()):
        chosen = dict(zip(vary, values, strict=True))
        own = override(recipe, {"model": model, **chosen})
        model_config(own.model, **own.net)  # what is wrong is told now, not after some runs
        told = {name: value for name, value in chosen.items() if name != "model"}
        label = variation_label(own.model, told)
        name = re.sub(r"[^\w.=,+-]+", "_", label.replace(":", ".").replace(", ", ","))
        for index in range(seeds):
            folder = name if index == 0 else f"{name}.seed{own.seed + index}"
            found.append(Variant(label, folder, replace(own, seed=own.seed + index)))
    for at, variant in enumerate(found):
        if any(variant.folder == o.folder or variant.recipe == o.recipe for o in found[:at]):
            raise InputError(f"{variant.label} comes twice in this ablation: leave one of them out")
    return found


@dataclass(frozen=True)
class AblationRow:
    """One trained network.

    Attributes:
        model: Its name.
        pairs: Validation pairs that were scored.
        figures: Means over these pairs, by the paper's names: EPE in px, D1 and px-3 in percent.
        label: Name of its row, which it shares with other seeds.
        seed: Seed of its recipe.
    """

    model: str
    pairs: int
    figures: dict[str, float]
    label: str = ""
    seed: int = 0

    def __post_init__(self) -> None:
        for column in PAPER_COLUMNS:
            if not isinstance(self.figures.get(column.title), float | int):
                raise InputError(f"figures lack {column.title}, a number")


def ablate(
    runs: Sequence[Variant],
    folder: Path,
    *,
    precision: str = "32-true",
    accelerator: str = "auto",
    workers: int = 0,
    progress: bool = True,
) -> Iterator[AblationRow]:
    """Train and score variants, those with the same data on the same pairs in the same order.

    What is done already is not done again: a finished run is read from its folder, a started one
    is resumed.

    Args:
        runs: The variants, see `variants`.
        folder: Gets a folder for each of them, and ``ablation.json``: the rows so far and the
            recipe of the first.
        precision: See `train`, as for the other arguments.
        accelerator: Likewise.
        workers: Likewise.
        progress: Likewise.

    Yields:
        A row per variant, as soon as it is done.

    Raises:
        InputError: If a recipe has weights to start from, or a folder holds a run under another
            recipe.
    """
    for variant in runs:
        if variant.recipe.weights is not None:
            raise InputError(
                f"an ablation starts from fresh weights, not from {variant.recipe.weights}: leave "
                "weights out"
            )
    rows: list[AblationRow] = []
    for variant in runs:
        own, run = variant.recipe.with_absolute_paths(), folder / variant.folder
        _check_run(own, run)
        score = run / "score.json"
        if not score.is_file():
            train(
                own,
                run,
                resume=(run / "last.ckpt").is_file(),
                precision=precision,
                accelerator=accelerator,
                workers=workers,
                progress=progress,
            )
            device = "cuda" if accelerator != "cpu" and torch.cuda.is_available() else "cpu"
            pairs = RunData(own, workers).validation(device)
            _write_json(score, asdict(_score(own, run, pairs, device)))
        row = build(AblationRow, read_json(score), str(score))
        rows.append(replace(row, label=variant.label, seed=own.seed))
        first = runs[0].recipe.with_absolute_paths()
        record = {"recipe": asdict(first), "rows": [asdict(row) for row in rows]}
        _write_json(folder / "ablation.json", record)
        yield rows[-1]


def _check_run(recipe: Recipe, run: Path) -> None:
    """Refuse a folder that holds a run under another recipe."""
    if not (run / "recipe.json").is_file():
        return
    before = read_recipe(run / "recipe.json", trusted=(recipe.model, recipe.loss))
    if changed := before.with_absolute_paths().changes(recipe):
        raise InputError(
            f"{run} holds a run under another recipe ({changed}): set it as it was, or "
            "choose another folder"
        )


def _write_json(path: Path, record: dict[str, Any]) -> None:
    write_text(path, json.dumps(record, indent=2) + "\n")


def _score(recipe: Recipe, run: Path, pairs: Any, device: str) -> AblationRow:
    """Score the exported weights."""
    own = recipe.model if ".py:" in recipe.model else None
    matcher = StereoMatcher.from_pretrained(
        run / "weights.safetensors", model=own, device=device, refine=False
    )
    max_disparity = model_config(recipe.model, **recipe.net).max_disparity
    result = evaluate(
        matcher.disparity,
        # Scenes may have been rendered on a GPU; scores are taken on the CPU.
        (pairs[index].map(Tensor.cpu) for index in range(len(pairs))),
        model=recipe.model,
        data_name=recipe.data,
        protocol=EvaluationProtocol(max_disparity),
    )
    figures = {column.title: column.of(result, "mean") for column in PAPER_COLUMNS}
    known = {name: value for name, value in figures.items() if value is not None}
    if len(known) < len(figures):
        raise InputError(f"{recipe.data}: no pixel to score in 0 < d < {max_disparity}")
    return AblationRow(recipe.model, result.scores.masks["all"].images, known)


def ablation_table(rows: Iterable[AblationRow], recipe: Recipe) -> ResultTable:
    """The rows beside the paper's figures, with what such a comparison can tell.

    Args:
        rows: Rows, of which those with one label differ by their seed.
        recipe: The recipe that is varied.
    """
    groups: dict[str, list[AblationRow]] = {}
    for row in rows:
        groups.setdefault(row.label or row.model, []).append(row)
    pairs = max((row.pairs for group in groups.values() for row in group), default=0)
    counted = f"{recipe.steps} steps" if recipe.steps else f"{recipe.epochs} epochs"
    seeds = max((len(group) for group in groups.values()), default=0)
    printed = printed_errors("sceneflow")
    printed = {label: printed[label] for label in groups if label in printed}
    notes = "Per-image means."
    if printed:
        notes += (
            " Paper: 20 epochs of SceneFlow, its test set. Other data and another budget: compare "
            "the order of the rows, not the figures."
        )
    if seeds < 2:
        notes += " It is one seed: differences that another seed would turn around are none."
    return comparison_table(
        {label: [row.figures for row in group] for label, group in groups.items()},
        PAPER_COLUMNS,
        title=f"{recipe.duration or counted} of {recipe.batch_size} pairs on {recipe.data}, "
        f"scored on {pairs} pairs",
        notes=notes,
        printed=printed or None,
    )
