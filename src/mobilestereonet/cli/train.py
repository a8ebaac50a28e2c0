"""``msnet train``."""

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


def train(
    folder: Annotated[Path, typer.Argument(help="Folder of the run: checkpoints, logs, weights.")],
    model: Annotated[
        str | None,
        typer.Option(help="Network to train: a name of `msnet models`, or my_net.py:MyNet."),
    ] = None,
    recipe: Annotated[
        str | None,
        typer.Option(
            help="procedural, procedural-plain, paper-sceneflow or paper-kitti2015, or another "
            "run's recipe.json. [default: procedural; procedural-plain for a network that lacks "
            "what that needs]"
        ),
    ] = None,
    assignments: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            help="Override a value of the recipe, such as lr=5e-4, augment.noise=0.02, "
            "scenes.seed=7 or net.cost_volume=correlation. Repeat for more.",
        ),
    ] = None,
    root: Root = None,
    textures: Textures = None,
    weights: Annotated[
        Path | None,
        typer.Option(
            help="Weights to start from: msnet2d or msnet3d, or a file, ours or the authors'."
        ),
    ] = None,
    resume: Annotated[
        bool,
        typer.Option(
            "--resume",
            help="Go on exactly where FOLDER/last.ckpt was written, under its recipe; repeat "
            "--precision and the devices' options.",
        ),
    ] = False,
    max_time: Annotated[
        str | None, typer.Option(help="Stop, with a checkpoint, after DD:HH:MM:SS.")
    ] = None,
    precision: Precision = "32-true",
    accelerator: Accelerator = "auto",
    devices: Annotated[int, typer.Option(help="Devices per node.")] = 1,
    num_nodes: Annotated[
        int, typer.Option(help="Nodes; start the command on each (torchrun).")
    ] = 1,
    workers: Workers = 0,
    progress: Progress = True,
) -> None:
    """Train a network under a recipe; every value of it can be overridden.

    Without a data set it trains on procedural scenes, which need no download. Ctrl-C ends the run
    after its current step, with a checkpoint.
    """
    from mobilestereonet.settings import parse_assignments
    from mobilestereonet.training.recipe import default_recipe, get_recipe, override, read_recipe
    from mobilestereonet.training.run import train as run

    values = parse_assignments(assignments or [])
    if model is not None:
        values["model"] = model
    if resume and recipe is None:
        chosen = read_recipe(folder / "recipe.json")
    elif recipe is not None:
        chosen = get_recipe(recipe)
    else:
        chosen = default_recipe(str(values.get("model", "msnet2d")))
    paths = {"root": root, "textures": textures, "weights": weights}
    values |= {name: str(path) for name, path in paths.items() if path is not None}
    run(
        override(chosen, values),
        folder,
        resume=resume,
        max_time=max_time,
        precision=precision,
        accelerator=accelerator,
        devices=devices,
        num_nodes=num_nodes,
        workers=workers,
        progress=progress,
    )
