"""``msnet train``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from mobilestereonet.cli.early import (
    check_network_values,
    matches,
    network_name,
    weights_file,
)
from mobilestereonet.cli.options import Recipe
from mobilestereonet.cli.training_options import RecipeOptions, TrainerOptions


def train(
    folder: Annotated[Path, typer.Argument(help="Folder of the run: checkpoints, logs, weights.")],
    model: Annotated[
        str | None,
        typer.Option(
            help="Network to train: a name of `msnet models`, or my_net.py:MyNet. Default: the "
            "recipe's.",
            callback=network_name,
        ),
    ] = None,
    recipe: Recipe = None,
    *,
    options: RecipeOptions,
    weights: Annotated[
        Path | None,
        typer.Option(
            help="Weights to start from: msnet2d or msnet3d, or a file of this package or of the "
            "authors.",
            callback=weights_file,
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
        str | None,
        typer.Option(
            help="Stop, with a checkpoint, after DD:HH:MM:SS.",
            callback=matches(r"\d\d(:\d\d){3}", "DD:HH:MM:SS"),
        ),
    ] = None,
    devices: Annotated[int, typer.Option(metavar="<n>", min=1, help="Devices per node.")] = 1,
    num_nodes: Annotated[
        int, typer.Option(metavar="<n>", min=1, help="Nodes; start the command on each (torchrun).")
    ] = 1,
    trainer: TrainerOptions,
) -> None:
    """Train a network under a recipe, of which --set changes any value.

    Without --recipe it is procedural, or procedural-plain for a network that lacks what that needs:
    both train on procedural scenes, which need no download. The others are published schedules.
    Ctrl-C ends the run after its current step, with a checkpoint.
    """
    values = options.values
    if model is not None:
        values["model"] = model
    if not resume and not (recipe or "").endswith(".json"):  # whose network may be the user's own
        network_values = [name[4:] for name in values if name.startswith("net.")]
        check_network_values(values.get("model"), network_values)

    from mobilestereonet.training.named_recipes import default_recipe, get_recipe, read_recipe
    from mobilestereonet.training.recipe import override
    from mobilestereonet.training.run import train as run

    if resume and recipe is None:
        chosen = read_recipe(
            folder / "recipe.json", trusted=[str(values.get(name)) for name in ("model", "loss")]
        )
    elif recipe is not None:
        chosen = get_recipe(recipe)
    else:
        chosen = default_recipe(str(values.get("model", "msnet2d")))
    if weights is not None:
        values["weights"] = str(weights)
    run(
        override(chosen, values),
        folder,
        resume=resume,
        max_time=max_time,
        devices=devices,
        num_nodes=num_nodes,
        **vars(trainer),
    )
