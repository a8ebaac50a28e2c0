"""``msnet ablate``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from mobilestereonet.cli.training_options import (
    Accelerator,
    Precision,
    Progress,
    Root,
    Textures,
    Workers,
)


def ablate(
    folder: Annotated[Path, typer.Argument(help="Folder of the runs, one folder each.")],
    table: Annotated[
        str, typer.Option(help="The paper's table: 2, 3a, 3b, appendix2d or appendix3d.")
    ] = "2",
    models: Annotated[
        str | None, typer.Option(help="Networks instead of a table's, such as msnet2d,msnet3d.")
    ] = None,
    recipe: Annotated[
        str,
        typer.Option(help="procedural, procedural-plain, paper-sceneflow or paper-kitti2015."),
    ] = "procedural",
    steps: Annotated[
        int | None, typer.Option(min=1, help="Length of each run in place of the recipe's.")
    ] = None,
    assignments: Annotated[
        list[str] | None,
        typer.Option("--set", help="Override a value of the recipe; see msnet train."),
    ] = None,
    root: Root = None,
    textures: Textures = None,
    precision: Precision = "32-true",
    accelerator: Accelerator = "auto",
    workers: Workers = 0,
    progress: Progress = True,
) -> None:
    """Train and score several networks under one recipe, beside the paper's figures.

    Start it again to go on where it stopped, such as by Ctrl-C.
    """
    from rich.console import Console

    from mobilestereonet.paper.ablate import ablate as run
    from mobilestereonet.paper.ablate import ablation_table, table_models
    from mobilestereonet.settings import parse_assignments
    from mobilestereonet.training.recipe import get_recipe, override

    values = parse_assignments(assignments or [])
    if steps is not None:
        values |= {"steps": steps, "epochs": None, "duration": None}
    paths = {"root": root, "textures": textures}
    values |= {name: str(path) for name, path in paths.items() if path is not None}
    chosen = override(get_recipe(recipe), values)
    names = [model.strip() for model in models.split(",")] if models else table_models(table)
    names = list(dict.fromkeys(names))
    rows = []
    for row in run(
        names,
        chosen,
        folder,
        precision=precision,
        accelerator=accelerator,
        workers=workers,
        progress=progress,
    ):
        rows.append(row)
        print(f"{row.model}: EPE {row.figures['EPE']:.3f} px ({len(rows)} of {len(names)} done)")
    Console().print(ablation_table(rows, chosen))
    print(f"figures: {folder / 'ablation.json'}")
