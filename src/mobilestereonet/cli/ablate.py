"""``msnet ablate``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from mobilestereonet.cli.early import TABLES, check_network, one_of, recipe_name
from mobilestereonet.cli.options import RECIPE_KINDS
from mobilestereonet.cli.training_options import RecipeOptions, TrainerOptions


def ablate(
    folder: Annotated[Path, typer.Argument(help="Folder of the runs, one folder each.")],
    table: Annotated[
        str,
        typer.Option(
            help=f"The paper's table: {', '.join(TABLES[:-1])} or {TABLES[-1]}.",
            callback=one_of(TABLES),
        ),
    ] = "2",
    models: Annotated[
        str | None,
        typer.Option(
            help="Networks instead of a table's, such as msnet2d,msnet3d.",
        ),
    ] = None,
    recipe: Annotated[str, typer.Option(help=RECIPE_KINDS, callback=recipe_name)] = "procedural",
    steps: Annotated[
        int | None, typer.Option(min=1, help="Length of each run in place of the recipe's.")
    ] = None,
    *,
    options: RecipeOptions,
    trainer: TrainerOptions,
) -> None:
    """Train and score several networks, beside the paper's figures.

    Start it again to go on where it stopped, such as by Ctrl-C.
    """
    chosen_names = [name.strip() for name in models.split(",")] if models else []
    for name in chosen_names:
        check_network("--models", name)

    from rich.console import Console

    from mobilestereonet.paper.ablate import ablate as run
    from mobilestereonet.paper.ablate import ablation_table, table_models
    from mobilestereonet.training.named_recipes import get_recipe
    from mobilestereonet.training.recipe import override

    values = options.values
    if steps is not None:
        values |= {"steps": steps, "epochs": None, "duration": None}
    chosen = override(get_recipe(recipe), values)
    names = list(dict.fromkeys(chosen_names or table_models(table)))
    rows = []
    for row in run(names, chosen, folder, **vars(trainer)):
        rows.append(row)
        print(f"{row.model}: EPE {row.figures['EPE']:.3f} px ({len(rows)} of {len(names)} done)")
    Console().print(ablation_table(rows, chosen))
    print(f"figures: {folder / 'ablation.json'}")
