"""Ablations: several networks under one recipe, beside the paper's table."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import torch
from rich.table import Table
from torch import Tensor

from mobilestereonet.atomic import write_text
from mobilestereonet.errors import InputError
from mobilestereonet.evaluation import EvaluationProtocol, evaluate
from mobilestereonet.inference import StereoMatcher
from mobilestereonet.nets import list_models, model_config
from mobilestereonet.paper.tables import ablation_tables
from mobilestereonet.settings import build
from mobilestereonet.text import read_json
from mobilestereonet.training.data import RunData
from mobilestereonet.training.named_recipes import read_recipe
from mobilestereonet.training.recipe import Recipe
from mobilestereonet.training.run import train

TABLES = ("2", "3a", "3b", "appendix2d", "appendix3d")
"""The paper's ablations, by what `table_models` takes."""

_FIGURES = {"EPE": "epe", "D1": "d1", "px-3": "bad3"}
"""The paper's names of the figures, and those of `StereoScores`."""


def table_models(table: str) -> list[str]:
    """Names of the networks in one of the paper's ablation tables.

    Raises:
        InputError: If the table is unknown.
    """
    if table not in TABLES:
        raise InputError(f"unknown table {table!r}: choose one of {', '.join(TABLES)}")
    prefix = table if table.startswith("appendix") else f"table{table}"
    return [model for model in list_models() if model.startswith(f"{prefix}-")]


@dataclass(frozen=True)
class AblationRow:
    """One trained network.

    Attributes:
        model: Its name.
        pairs: Validation pairs that were scored.
        figures: Means over these pairs, by the paper's names: EPE in px, D1 and px-3 in percent.
    """

    model: str
    pairs: int
    figures: dict[str, float]

    def __post_init__(self) -> None:
        for name in _FIGURES:
            if not isinstance(self.figures.get(name), float | int):
                raise InputError(f"figures lack {name}, a number")


def ablate(
    models: Sequence[str],
    recipe: Recipe,
    folder: Path,
    *,
    precision: str = "32-true",
    accelerator: str = "auto",
    workers: int = 0,
    progress: bool = True,
) -> Iterator[AblationRow]:
    """Train and score networks, all on the same pairs in the same order.

    What is done already is not done again: a finished network is read from its folder, a started
    one is resumed.

    Args:
        models: Names of networks.
        recipe: How each of them is trained; its own model does not matter.
        folder: Gets the folder of a run for each network, and ``ablation.json``: the recipe and
            the rows so far.
        precision: See `train`, as for the other arguments.
        accelerator: Likewise.
        workers: Likewise.
        progress: Likewise.

    Yields:
        A row per network, as soon as it is done.

    Raises:
        InputError: If a network is unknown, the recipe has weights to start from, or a folder
            holds a run under another recipe.
    """
    for model in models:
        model_config(model, **recipe.net)  # what is wrong is told now, not after some runs
    if recipe.weights is not None:
        raise InputError(
            f"an ablation starts from fresh weights, not from {recipe.weights}: leave weights out"
        )
    recipe = recipe.with_absolute_paths()
    rows: list[AblationRow] = []
    for model in models:
        own = replace(recipe, model=model).with_absolute_paths()
        run = folder / Path(model).name.replace(":", ".")  # the user's own have a folder
        if (run / "recipe.json").is_file():
            before = read_recipe(
                run / "recipe.json", trusted=(own.model, own.loss)
            ).with_absolute_paths()
            if changed := before.changes(own):
                raise InputError(
                    f"{run} holds a run under another recipe ({changed}): set it as it was, or "
                    "choose another folder"
                )
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
        rows.append(build(AblationRow, read_json(score), str(score)))
        record = {"recipe": asdict(recipe), "rows": [asdict(row) for row in rows]}
        _write_json(folder / "ablation.json", record)
        yield rows[-1]


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
    scores = result.scores.masks["all"]
    figures = {name: scores.per_image[key] for name, key in _FIGURES.items()}
    known = {name: value for name, value in figures.items() if value is not None}
    if len(known) < len(figures):
        raise InputError(f"{recipe.data}: no pixel to score in 0 < d < {max_disparity}")
    return AblationRow(recipe.model, scores.images, known)


def ablation_table(rows: Sequence[AblationRow], recipe: Recipe) -> Table:
    """The rows beside the paper's figures, with what such a comparison can tell."""
    printed = {row.name: row.errors for table in ablation_tables() for row in table.rows}
    counted = f"{recipe.steps} steps" if recipe.steps else f"{recipe.epochs} epochs"
    length = recipe.duration or counted
    table = Table(
        title=f"{length} of {recipe.batch_size} pairs on {recipe.data}, "
        f"scored on {rows[0].pairs if rows else 0} pairs",
        caption="Per-image means, measured here and printed in the paper (20 epochs of SceneFlow, "
        "its test set). Other data and another budget: compare the order of the rows, not the "
        "figures. It is one seed: differences that another seed would turn around are none.",
        caption_justify="left",
    )
    table.add_column("model")
    for name in _FIGURES:
        table.add_column(f"{name}\nmeasured", justify="right")
        table.add_column("\npaper", justify="right")
    for row in rows:
        cells = []
        for name, measured in row.figures.items():
            paper = printed.get(row.model, {}).get(name)
            cells += [f"{measured:.2f}", "" if paper is None else f"{paper:.2f}"]
        table.add_row(row.model, *cells)
    return table
