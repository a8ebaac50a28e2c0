"""Markdown tables of the networks in the paper's tables: costs, lines of code, speed.

    python benchmarks/zoo_table.py [docs/figures/zoo.json]

Parameters and MACs are counted as the paper counts, beside its figures; MACs also exactly. Lines
are those of a network's own file in ``nets/``. With a file of ``benchmarks/zoo.py``: seconds and
peak memory of both forms.
"""

from __future__ import annotations

import argparse
import inspect
import json
from pathlib import Path
from typing import Any

from mobilestereonet.nets import model_info
from mobilestereonet.paper.peers import compared_networks, comparison_cost, comparisons
from mobilestereonet.paper.rows import Cell


def markdown(header: list[str], rows: list[list[str]]) -> str:
    """A table whose first column is text, and the others numbers."""
    lines = [header, ["---", *["---:"] * (len(header) - 1)], *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def costs() -> str:
    """Parameters and MACs, counted and printed."""
    cells: dict[str, dict[str, Cell]] = {}
    for table in comparisons():
        for row in table.rows:
            for cell in row.cells:
                known = cells.setdefault(row.name, {}).get(cell.what)
                if known is None or known.printed is None:
                    cells[row.name][cell.what] = cell
    names = compared_networks()
    rows = []
    for title, of_row in cells.items():
        name = names.get(title)
        exact = f"{comparison_cost(name).macs / 1e9:.2f}" if name else ""
        figures = [text for what in ("params", "macs") for text in both(of_row[what])]
        rows.append([f"{title} (`{name}`)" if name else title, *figures, exact])
    header = ["network", "parameters, M", "printed", "MACs, G", "printed", "exact MACs, G"]
    return markdown(header, rows)


def both(cell: Cell) -> list[str]:
    """The counted and the printed figure; 38.00 M is printed as 38."""
    figures = (cell.counted, cell.printed)
    return ["" if x is None else f"{x:.2f}".removesuffix(".00") for x in figures]


def lines() -> str:
    """Lines of each file, and the networks that it holds."""
    files: dict[str, list[str]] = {}
    for name in compared_networks().values():
        files.setdefault(inspect.getfile(model_info(name).network), []).append(f"`{name}`")
    rows = [
        [
            f"`nets/{Path(file).name}`",
            ", ".join(names),
            str(len(Path(file).read_text().split("\n"))),
        ]
        for file, names in files.items()
    ]
    return markdown(["file", "networks", "lines"], rows)


def speed(path: Path) -> str:
    """Seconds and peak memory of the plain and of the accelerated form."""
    records: dict[str, dict[str, Any]] = {}
    for record in json.loads(path.read_text())["records"]:
        records.setdefault(record["model"], {})[record["form"]] = record
    rows = []
    for model, forms in records.items():
        row = [f"`{model}`"]
        for key, digits in (("seconds", 2), ("peak_mib", 0)):
            row += [
                f"{form[key]:.{digits}f}" if key in form else form["failure"]
                for form in (forms["plain"], forms["accelerated"])
            ]
        rows.append(row)
    header = ["network", "plain, s", "accelerated, s", "plain, MiB", "accelerated, MiB"]
    return markdown(header, rows)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("measured", nargs="?", type=Path, help="what zoo.py -o wrote (.json)")
    arguments = parser.parse_args()
    tables = [costs(), lines()]
    if arguments.measured:
        tables.append(speed(arguments.measured))
    print("\n\n".join(tables))


if __name__ == "__main__":
    main()
