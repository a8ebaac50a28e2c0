"""A table of the paper as data: printed errors, and cells computed beside the printed costs."""

from __future__ import annotations

import functools
import json
from collections.abc import Iterator
from dataclasses import dataclass
from importlib import resources
from typing import Any, Literal

from mobilestereonet.costs.count import Cost

What = Literal["macs", "params"]


@dataclass(frozen=True)
class Cell:
    """A cost in one of the paper's tables, counted and printed.

    Attributes:
        table: "Table 3a", "Table 3b", "Appendix 2D", "Appendix 3D", "Modules", "Table 4a",
            "Table 4b", "Table 5" or "Table 6".
        row: Name of the model, where it has one, or the paper's words.
        what: "macs", in 1e9 (G), or "params", in 1e6 (M).
        counted: The count of this package, as the paper counts; None of a network that is not
            here.
        printed: The paper's figure; None where it prints none.
    """

    table: str
    row: str
    what: What
    counted: float | None
    printed: float | None

    @property
    def agrees(self) -> bool:
        """Within 0.1 % of the printed MACs, or 0.01 M of the printed parameters, or nothing to say.

        Parameters without decimals, such as 38 M, are rounded: within half of one.
        """
        if self.counted is None or self.printed is None:
            return True
        decimals = 0.5 if float(self.printed).is_integer() else 0.01
        tolerance = 0.001 * self.printed if self.what == "macs" else decimals
        return abs(self.counted - self.printed) <= tolerance


@dataclass(frozen=True)
class Row:
    """A row of a table: its name, its printed errors by name, and its costs."""

    name: str
    errors: dict[str, float]
    cells: tuple[Cell, ...] = ()


@dataclass(frozen=True)
class Note:
    """What there is to know about a figure.

    Attributes:
        row: Name of its row.
        column: "macs", "params" or the name of an error.
        text: The note.
        agrees: False where a computed cell does not agree with the printed one.
    """

    row: str
    column: str
    text: str
    agrees: bool


@dataclass(frozen=True)
class PaperTable:
    """One of the paper's tables."""

    name: str
    caption: str
    rows: tuple[Row, ...]

    def notes(self) -> Iterator[Note]:
        """Notes to its figures; every computed cell that does not agree has one."""
        notes = _data("notes").get(self.name, {})
        for row in self.rows:
            agreement: dict[str, bool] = {cell.what: cell.agrees for cell in row.cells}
            for column in (*row.errors, *agreement):
                if text := notes.get(row.name, {}).get(column):
                    yield Note(row.name, column, text, agreement.get(column, True))


def cells(
    table: str, row: str, cost: Cost | None, macs: float | None, params: float | None
) -> tuple[Cell, ...]:
    """The cells of a row, from its cost and the printed figures (G and M), as far as there are."""
    counted = (cost.paper_macs / 1e9, cost.paper_params / 1e6) if cost else (None, None)
    both = (
        Cell(table, row, "macs", counted[0], macs),
        Cell(table, row, "params", counted[1], params),
    )
    return tuple(cell for cell in both if (cell.counted, cell.printed) != (None, None))


def printed() -> dict[str, Any]:
    """The paper's figures, as ``tables.json`` has them."""
    return _data("tables")


@functools.cache
def _data(name: str) -> dict[str, Any]:
    text = resources.files(__package__).joinpath(f"{name}.json").read_text(encoding="utf-8")
    data: dict[str, Any] = json.loads(text)
    return data
