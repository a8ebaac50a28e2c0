"""Tables of results: in the terminal, and as Markdown, LaTeX, CSV and HTML."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from io import StringIO
from pathlib import Path
from statistics import mean, stdev
from typing import NamedTuple

from rich import box
from rich.table import Table
from tabulate import tabulate

from mobilestereonet.atomic import write_text
from mobilestereonet.errors import InputError
from mobilestereonet.settings import choice_hint

ENDINGS = {".md": "markdown", ".tex": "latex", ".csv": "csv", ".html": "html"}
"""Formats of tables, by the ending of their files."""

_TABULATE = {"markdown": "github", "latex": "latex_booktabs", "html": "html"}
"""Formats of the library, by ours."""

_PAGE = """<!DOCTYPE html>
<html lang="en"><meta charset="utf-8"><title>{title}</title>
<style>td, th {{ padding: 0.1em 0.6em; border-bottom: thin solid #8888 }}</style>
<h1>{title}</h1>
{table}
<p>{notes}</p>
</html>"""


class Spread(NamedTuple):
    """Mean over seeds and its sample standard deviation, None of one seed."""

    mean: float
    deviation: float | None = None

    @classmethod
    def of(cls, values: Sequence[float | None]) -> Spread | None:
        """Spread of some figures; None if one of them is unknown."""
        known = [value for value in values if value is not None]
        if not known or len(known) < len(values):
            return None
        return cls(mean(known), stdev(known) if len(known) > 1 else None)


Cell = str | Spread | None
"""Text, a figure, or None where there is none."""


class TableColumn(NamedTuple):
    """Heading of a column, and the digits behind the point of its figures."""

    heading: str
    digits: int = 2


@dataclass(frozen=True)
class ResultTable:
    """Table of results; a console of `rich` prints it.

    Attributes:
        title: What was measured, on what.
        columns: Its columns; the first one holds names.
        rows: A cell per column.
        notes: What there is to know about the figures.
    """

    title: str
    columns: tuple[TableColumn, ...]
    rows: tuple[tuple[Cell, ...], ...]
    notes: str = ""

    def render(self, format: str) -> str:
        """The table as text.

        Args:
            format: "markdown", "latex" (with the package booktabs), "csv" (figures with all their
                digits, deviations in columns of their own) or "html" (a page).

        Raises:
            InputError: If there is no such format.
        """
        if format == "csv":
            return self._csv()
        if format not in _TABULATE:
            names = list(ENDINGS.values())
            raise InputError(f"format {format}: {choice_hint(format, names)}")
        headings = [column.heading for column in self.columns]
        rows = [self._texts(row) for row in self.rows]
        if format == "markdown":
            headings, *rows = [[text.replace("|", r"\|") for text in r] for r in (headings, *rows)]
        alignment = ["left", *["right"] * (len(headings) - 1)]
        style = _TABULATE[format]
        text: str = tabulate(rows, headings, style, colalign=alignment, disable_numparse=True)
        if format == "html":
            return _PAGE.format(title=escape(self.title), table=text, notes=escape(self.notes))
        if format == "latex":
            with_sign = text.replace("±", r"$\pm$")
            return f"% {self.title}\n{with_sign}\n% {self.notes}\n"
        return f"{self.title}\n\n{text}\n\n{self.notes}\n"

    def write(self, path: Path) -> None:
        """Write a file in the format that its ending names.

        Raises:
            InputError: If it names none of `ENDINGS`.
        """
        if path.suffix.lower() not in ENDINGS:
            raise InputError(f"{path}: tables are written as {', '.join(ENDINGS)}")
        write_text(path, self.render(ENDINGS[path.suffix.lower()]))

    def __rich__(self) -> Table:
        table = Table(
            title=self.title,
            caption=self.notes,
            caption_justify="left",
            box=box.SIMPLE_HEAD,
            padding=(0, 1, 0, 0),
        )
        for index, column in enumerate(self.columns):
            heading = column.heading.replace(" (", "\n(").replace(", ", "\n")
            table.add_column(heading, justify="right" if index else "left", overflow="fold")
        for row in self.rows:
            table.add_row(*self._texts(row))
        return table

    def _texts(self, row: Sequence[Cell]) -> list[str]:
        return [_text(cell, column.digits) for cell, column in zip(row, self.columns, strict=True)]

    def _csv(self) -> str:
        text = StringIO(newline="")
        spread = [
            any(isinstance(row[at], Spread) and row[at].deviation is not None for row in self.rows)  # type: ignore[union-attr]
            for at in range(len(self.columns))
        ]
        headings = []
        for column, has_deviation in zip(self.columns, spread, strict=True):
            headings += [column.heading, *([f"{column.heading} std"] if has_deviation else [])]
        rows = []
        for row in self.rows:
            cells: list[object] = []
            for cell, has_deviation in zip(row, spread, strict=True):
                parts = cell if isinstance(cell, Spread) else (cell, None)
                cells += parts if has_deviation else parts[:1]
            rows.append(cells)
        csv.writer(text).writerows([headings, *rows])
        return text.getvalue()


def _text(cell: Cell, digits: int) -> str:
    if cell is None:
        return "-"
    if isinstance(cell, str):
        return cell
    text = f"{cell.mean:.{digits}f}"
    return text if cell.deviation is None else f"{text} ± {cell.deviation:.{digits}f}"
