"""``msnet plot-run``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from mobilestereonet.cli.early import existing_folder


def plot_run(
    folder: Annotated[
        Path, typer.Argument(help="Folder of a run of `msnet train`.", callback=existing_folder)
    ],
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="PNG file. Default: FOLDER/curves.png.")
    ] = None,
) -> None:
    """Draw the curves of a run, all its starts together."""
    from mobilestereonet.atomic import check_outputs, note_inputs
    from mobilestereonet.plots import plot_curves

    logs = sorted(folder.glob("csv/version_*/metrics.csv"), key=lambda log: log.stat().st_mtime)
    if not logs:
        raise FileNotFoundError(f"{folder}: no csv/version_*/metrics.csv in it: is it a run?")
    picture = output or folder / "curves.png"
    note_inputs(*logs, folder / "recipe.json")
    check_outputs(picture)
    plot_curves(logs, picture)
    print(f"{picture}: curves of {len(logs)} start{'s' if len(logs) > 1 else ''}")
