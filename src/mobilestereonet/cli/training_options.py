"""Options of all commands that train."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import typer

from mobilestereonet.cli.early import ACCELERATORS, TRAINING_PRECISIONS, existing_folder, one_of
from mobilestereonet.cli.options import RecipeValues, Textures
from mobilestereonet.settings import parse_assignments


@dataclass(frozen=True)
class RecipeOptions:
    """Options that change values of a recipe."""

    assignments: RecipeValues = None
    root: Annotated[
        Path | None,
        typer.Option(help="Folder of the recipe's data set.", callback=existing_folder),
    ] = None
    textures: Textures = None

    @property
    def values(self) -> dict[str, Any]:
        """The values by their dotted names."""
        paths = {"root": self.root, "textures": self.textures}
        given = {name: str(path) for name, path in paths.items() if path is not None}
        return parse_assignments(self.assignments or []) | given


@dataclass(frozen=True)
class TrainerOptions:
    """Options that change how a run is computed, and not what is trained."""

    precision: Annotated[
        str,
        typer.Option(
            help="Lightning's precision: 32-true, bf16-mixed, 16-mixed.",
            callback=one_of(TRAINING_PRECISIONS),
        ),
    ] = "32-true"
    accelerator: Annotated[
        str, typer.Option(help="auto, cpu or gpu.", callback=one_of(ACCELERATORS))
    ] = "auto"
    workers: Annotated[
        int,
        typer.Option(
            metavar="<n>",
            min=0,
            help="Processes that read the data set's files or make procedural scenes; without any, "
            "scenes are made on the training device.",
        ),
    ] = 0
    progress: Annotated[bool, typer.Option(help="Show a progress bar.")] = True
