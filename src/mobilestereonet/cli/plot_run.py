"""``msnet plot-run``."""

from __future__ import annotations

import os.path
from pathlib import Path
from typing import Annotated

import typer

from mobilestereonet.cli.early import each
from mobilestereonet.errors import InputError


def _check_run(option: str, path: Path) -> None:
    if not path.exists():
        raise FileNotFoundError(f"no folder {path}")


def plot_run(
    folders: Annotated[
        list[Path],
        typer.Argument(
            metavar="RUN...", help="Folders of runs of `msnet train`.", callback=each(_check_run)
        ),
    ],
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            help="PNG file. Default: curves.png in the folder of the run, or of all runs.",
        ),
    ] = None,
) -> None:
    """Draw the curves of runs in one picture, loss and EPE first; all starts of a run together."""
    from mobilestereonet.atomic import check_outputs, note_inputs
    from mobilestereonet.training.curves import plot_curves

    # A pattern such as runs/* finds the files beside the runs, too.
    runs = {folder: _logs(folder) for folder in folders if folder.is_dir()}
    if not runs:
        raise InputError(f"{' '.join(map(str, folders))}: no folder of a run")
    place = (
        next(iter(runs))
        if len(runs) == 1
        else Path(os.path.commonpath([run.resolve() for run in runs]))
    )
    picture = output or place / "curves.png"
    for folder, logs in runs.items():
        note_inputs(*logs, folder / "recipe.json")
    check_outputs(picture)
    names = [folder.name for folder in runs]
    distinct = len(set(names)) == len(names)
    plot_curves({f.name if distinct else str(f): logs for f, logs in runs.items()}, picture)
    starts = sum(map(len, runs.values()))
    of_runs = f" of {len(runs)} runs" if len(runs) > 1 else ""
    print(f"{picture}: curves of {starts} start{'s' if starts > 1 else ''}{of_runs}")


def _logs(folder: Path) -> list[Path]:
    """Logs of a run, one for each start, in the order of time."""
    logs = sorted(folder.glob("csv/version_*/metrics.csv"), key=lambda log: log.stat().st_mtime)
    if not logs:
        raise FileNotFoundError(f"{folder}: no csv/version_*/metrics.csv in it: is it a run?")
    return logs
