"""``msnet ablate``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from mobilestereonet.cli.early import (
    TABLES,
    check_network,
    check_network_values,
    one_of,
    recipe_value,
)
from mobilestereonet.cli.options import Recipe
from mobilestereonet.cli.table_options import TableOptions
from mobilestereonet.cli.training_options import RecipeOptions, TrainerOptions
from mobilestereonet.settings import parse_variations


def ablate(
    folder: Annotated[Path, typer.Argument(help="Folder of the runs, one folder each.")],
    table: Annotated[
        str | None,
        typer.Option(
            help=f"The paper's table: {', '.join(TABLES[:-1])} or {TABLES[-1]}. Default: 2, or the "
            "recipe's network with --vary.",
            callback=one_of(TABLES),
        ),
    ] = None,
    models: Annotated[
        str | None,
        typer.Option(
            help="Networks instead of a table's, such as msnet2d,msnet3d.",
        ),
    ] = None,
    vary: Annotated[
        list[str] | None,
        typer.Option(
            help="Values of the recipe to compare, such as lr=1e-3,5e-4 or "
            "net.cost_volume=correlation,concatenation. Repeat for all combinations.",
            callback=recipe_value,
        ),
    ] = None,
    seeds: Annotated[
        int,
        typer.Option(
            metavar="<n>", min=1, help="Runs of each: the recipe's seed and those after it."
        ),
    ] = 1,
    recipe: Recipe = None,
    steps: Annotated[
        int | None, typer.Option(min=1, help="Length of each run in place of the recipe's.")
    ] = None,
    *,
    options: RecipeOptions,
    trainer: TrainerOptions,
    tables: TableOptions,
) -> None:
    """Train and score networks or values of a recipe, beside the paper's figures.

    Start it again to go on where it stopped, such as by Ctrl-C.
    """
    chosen_names = [name.strip() for name in models.split(",")] if models else []
    for name in chosen_names:
        check_network("--models", name)
    variations = parse_variations(vary or [])
    values = options.values
    if not (recipe or "").endswith(".json"):  # whose network may be the user's own
        given = [name[4:] for name in (*values, *variations) if name.startswith("net.")]
        check_network_values(models, given)

    from mobilestereonet.paper.ablate import ablate as run
    from mobilestereonet.paper.ablate import ablation_table, table_models, variants
    from mobilestereonet.training.named_recipes import default_recipe, get_recipe
    from mobilestereonet.training.recipe import override

    if steps is not None:
        values |= {"steps": steps, "epochs": None, "duration": None}
    names = chosen_names or (table_models(table or "2") if table or not vary else [])
    varied = variations.get("model") or [values.get("model", "msnet2d")]
    chosen = default_recipe(*names or map(str, varied)) if recipe is None else get_recipe(recipe)
    chosen = override(chosen, values)
    runs = variants(chosen, names or [chosen.model], variations, seeds)
    tables.prepare()
    rows = []
    for row in run(runs, folder, **vars(trainer)):
        rows.append(row)
        which = f"{row.label}, seed {row.seed}" if seeds > 1 else row.label
        told = f"{which}: EPE {row.figures['EPE']:.3f} px ({len(rows)} of {len(runs)} done)"
        typer.echo(told, err=tables.format is not None)
    tables.show(ablation_table(rows, chosen))
    typer.echo(f"figures: {folder / 'ablation.json'}", err=tables.format is not None)
