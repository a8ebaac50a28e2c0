"""Curves of training runs: what Lightning's CSV logs hold, drawn by kind of figure."""

from __future__ import annotations

import csv
import math
from collections import defaultdict
from collections.abc import Mapping, Sequence
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING

from mobilestereonet.atomic import write_atomically
from mobilestereonet.errors import InputError, needs_extra
from mobilestereonet.text import decode, shorten

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_MAX_COLUMNS = 1000
"""Columns of a run's log: more of them are none."""

_FIRST = ("loss", "epe")
"""Figures whose panels come first."""

_STYLES = ("-", "--", ":", "-.")
"""Lines of a figure's columns, such as train and val, where runs have colours."""

_Curve = tuple[list[float], list[float]]
_Family = dict[str, dict[str, list[_Curve]]]
"""Curves of one kind of figure, by column and run."""


def plot_curves(runs: Mapping[str, Sequence[Path]], picture: Path) -> None:
    """Draw the curves of training runs, one panel for each kind of figure, loss and EPE first.

    ``train/loss`` and ``val/loss`` share the panel ``loss``, which has a logarithmic axis. The
    columns of one run have colours; several runs have a colour each.

    Args:
        runs: Name of each run to the ``metrics.csv`` files of Lightning's CSVLogger, one for each
            of its starts. Where a resumed run did steps again, both curves are drawn.
        picture: PNG file to write.

    Raises:
        InputError: If a log is not a file, or the logs have no curve.
    """
    # Imported here: its import is slow.
    with needs_extra("plots"):
        from matplotlib.figure import Figure

    families: dict[str, _Family] = defaultdict(lambda: defaultdict(lambda: defaultdict(list)))
    for run, logs in runs.items():
        for log in logs:
            for column, curve in _curves(log).items():
                name = column.removesuffix("_step").removesuffix("_epoch")
                family = "lr" if name.startswith("lr") else name.rsplit("/", 1)[-1]
                families[family][column][run].append(curve)
    if not families:
        listed = ", ".join(str(log) for logs in runs.values() for log in logs)
        raise InputError(f"{listed}: no curve in it; it needs a column step and numbers beside it")
    order = sorted(families, key=lambda name: (*(name != first for first in _FIRST), name))
    rows = math.ceil(len(families) / 2)
    figure = Figure(figsize=(13, 2.6 * rows), layout="constrained")
    panels = figure.subplots(rows, 2, sharex=True, squeeze=False).ravel()
    for axes, name in zip(panels, order, strict=False):
        _draw(axes, name, families[name], list(runs))
    for axes in panels[len(families) :]:
        axes.remove()
    write_atomically(picture, lambda path: figure.savefig(path, format="png", dpi=120))


def _draw(axes: Axes, name: str, family: _Family, runs: Sequence[str]) -> None:
    from matplotlib.ticker import LogFormatter, MaxNLocator

    for index, (column, of_runs) in enumerate(sorted(family.items())):
        for run, starts in of_runs.items():
            colour, style, label = f"C{index}", "-", column
            if len(runs) > 1:
                colour, style = f"C{runs.index(run)}", _STYLES[index % len(_STYLES)]
                label = run if len(family) == 1 else f"{run}: {column}"
            for start, (steps, values) in enumerate(starts):
                marker = "." if len(values) < 30 else ""
                told = None if start else label
                axes.plot(steps, values, style, c=colour, label=told, linewidth=1, marker=marker)
    axes.set_ylabel(name)
    drawn = [
        y
        for column in family.values()
        for starts in column.values()
        for _, ys in starts
        for y in ys
    ]
    if "loss" in name and min(drawn) > 0:
        axes.set_yscale("log")
        axes.yaxis.set_major_formatter(LogFormatter())
        axes.yaxis.set_minor_formatter(LogFormatter())
    axes.set_xlabel("step")
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.tick_params(labelbottom=True)
    axes.grid(alpha=0.3)
    axes.legend(fontsize="small")


def _curves(log: Path) -> dict[str, _Curve]:
    """Columns of a CSV log that hold numbers: each one's steps and values.

    The logger writes a row per event and leaves the other columns empty.
    """
    if not log.is_file():  # a pipe would wait for ever
        raise InputError(f"{log}: not a file")
    curves: dict[str, _Curve] = defaultdict(lambda: ([], []))
    rows = csv.DictReader(StringIO(decode(log.read_bytes(), str(log)), newline=""))
    try:
        if len(rows.fieldnames or ()) > _MAX_COLUMNS:
            raise InputError(f"{log}: more than {_MAX_COLUMNS} columns are no log of a run")
        for row in rows:
            step = row.pop("step", None)
            for column, cell in row.items():
                if step and cell and column and column != "epoch":
                    at, value = _number(log, "step", step), _number(log, column, cell)
                    steps, values = curves[column.replace("$", r"\$")]  # no mathematics
                    steps.append(at)
                    values.append(value)
    except csv.Error as error:
        raise InputError(f"{log}: not a CSV log: {error}") from None
    return curves


def _number(log: Path, column: str, cell: str) -> float:
    try:
        return float(cell)
    except ValueError:
        raise InputError(f"{log}: {column} holds {shorten(repr(cell))}, no number") from None
