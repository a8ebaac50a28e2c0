"""Options of all commands that train."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, TypeAlias

import typer

Root: TypeAlias = Annotated[Path | None, typer.Option(help="Folder of the recipe's data set.")]
Textures: TypeAlias = Annotated[
    Path | None, typer.Option(help="Folder of photographs for procedural scenes.")
]
Precision: TypeAlias = Annotated[
    str, typer.Option(help="Lightning's precision: 32-true, bf16-mixed, 16-mixed.")
]
Accelerator: TypeAlias = Annotated[str, typer.Option(help="auto, cpu or gpu.")]
Workers: TypeAlias = Annotated[
    int,
    typer.Option(
        help="Processes that read the data set's files or make procedural scenes; without any, "
        "scenes are made on the training device."
    ),
]
Progress: TypeAlias = Annotated[bool, typer.Option(help="Show a progress bar.")]
