"""Options and arguments that several commands have."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, TypeAlias

import typer

from mobilestereonet.atomic import unused_path
from mobilestereonet.cli.early import (
    PAIR_BY,
    Callback,
    existing_file,
    existing_folder,
    one_of,
    recipe_name,
    recipe_value,
)

RECIPE_KINDS = (
    "procedural, procedural-plain, a published one such as paper-sceneflow (`msnet models NAME` "
    "shows a network's), or another run's recipe.json."
)


def new_output(name: str, what: str, callback: Callback | None = None) -> Any:
    """The option ``--output`` of a command; its default is a name where nothing is yet.

    Args:
        name: The default; if it is there, the next of name-2, name-3 and so on.
        what: Help text.
        callback: Check of the value.
    """
    return typer.Option(
        *("--output", "-o"),
        help=what,
        callback=callback,
        default_factory=lambda: unused_path(Path(name)),
        show_default=f"{name}, numbered if that is there",
    )


LeftView: TypeAlias = Annotated[
    Path, typer.Argument(help="Left view of a rectified pair.", callback=existing_file)
]
RightView: TypeAlias = Annotated[
    Path, typer.Argument(help="Right view, of the same size.", callback=existing_file)
]
SecondView: TypeAlias = Annotated[
    Path | None,
    typer.Argument(
        help="Right view, of the same size. Without it the first file has both: an MPO, or one "
        "picture with both views side by side or one above the other.",
        callback=existing_file,
    ),
]
PairBy: TypeAlias = Annotated[
    str | None,
    typer.Option(
        "--pair",
        help="Pair image files by their name, by their order, or by the nearest time stamp in "
        "their names. Default: name, and nearest where no name is in both folders.",
        callback=one_of(PAIR_BY),
    ),
]
AsJson: TypeAlias = Annotated[bool, typer.Option("--json", help="Print JSON.")]
DataRoot: TypeAlias = Annotated[
    Path,
    typer.Option(help="Folder in which its archives were unpacked.", callback=existing_folder),
]
Split: TypeAlias = Annotated[
    str | None,
    typer.Option(help="Split of the data set, see `msnet data list`. Default: its first."),
]
Textures: TypeAlias = Annotated[
    Path | None,
    typer.Option(help="Folder of photographs for procedural scenes.", callback=existing_folder),
]
Recipe: TypeAlias = Annotated[
    str | None,
    typer.Option(
        help=f"{RECIPE_KINDS} Default: procedural, or procedural-plain for a network that lacks "
        "what that needs.",
        callback=recipe_name,
    ),
]
RecipeValues: TypeAlias = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        help="Override a value of the recipe, such as lr=5e-4, augment.noise=0.02, scenes.seed=7 "
        "or net.cost_volume=correlation. Repeat for more.",
        callback=recipe_value,
    ),
]
