"""Options of all commands that give a table of results."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from mobilestereonet.cli.early import TABLE_ENDINGS, TABLE_FORMATS, ends_in, one_of

if TYPE_CHECKING:
    from mobilestereonet.evaluation.result_table import ResultTable


@dataclass(frozen=True)
class TableOptions:
    """Options for the table that compares models."""

    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            help="File for the table that compares models: .md, .tex, .csv or .html.",
            callback=ends_in(TABLE_ENDINGS, "tables are"),
        ),
    ] = None
    format: Annotated[
        str | None,
        typer.Option(
            help="Print that table alone, as markdown, latex, csv or html.",
            callback=one_of(TABLE_FORMATS),
        ),
    ] = None

    @property
    def wanted(self) -> bool:
        """Whether the table is asked for, however many models there are."""
        return self.output is not None or self.format is not None

    def prepare(self, *others: Path | None) -> None:
        """Make the folders of the table's file and of others, and check them: before the work."""
        from mobilestereonet.atomic import check_outputs, make_folder

        files = [file for file in (*others, self.output) if file is not None]
        for file in files:
            make_folder(file.parent)
        check_outputs(*files)

    def show(self, table: ResultTable) -> None:
        """Print the table, and write the file if there is to be one."""
        from rich.console import Console

        if self.format is None:
            Console().print(table)
        else:
            print(table.render(self.format), end="")
        if self.output is not None:
            table.write(self.output)
