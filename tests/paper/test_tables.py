"""The paper's tables of costs, counted and printed."""

import json
import re
from importlib import resources

import pytest

from extras import SHARED, needs_shared
from mobilestereonet.paper.peers import model_sizes, own_name
from mobilestereonet.paper.tables import paper_tables
from parity import REPOSITORY

COMPARISONS = ("Table 4a", "Table 4b", "Table 5", "Table 6")


@pytest.fixture(scope="module")
def tables():
    return {table.name: table for table in paper_tables()}


@pytest.fixture(scope="module")
def cells(tables):
    return [cell for table in tables.values() for row in table.rows for cell in row.cells]


def test_every_cell_agrees_but_the_known_misfits(tables, cells):
    misfits = {(cell.table, cell.row, cell.what) for cell in cells if not cell.agrees}
    assert misfits == {
        ("Modules", "encoder-decoder 3D, baseline", "macs"),
        ("Table 4a", "iResNet", "params"),
        ("Table 5", "2D-MobileStereoNet", "params"),
    }
    told = {
        (name, note.row, note.column)
        for name, table in tables.items()
        for note in table.notes()
        if not note.agrees
    }
    assert told == misfits
    for cell in cells:
        if cell.counted is not None and cell.printed is not None:
            tolerance = cell.printed / 1000
            if cell.what == "params":
                tolerance = 0.5 if cell.printed in (37, 38) else 0.01
            assert cell.agrees == (abs(cell.counted - cell.printed) <= tolerance)


def test_notes_to_printed_figures(tables):
    told = {
        (name, note.row, note.column) for name, table in tables.items() for note in table.notes()
    }
    assert {
        ("Table 4b", "GCNet", "EPE"),
        ("Table 4b", "GCNet", "macs"),
        ("Table 4b", "PSMNet", "EPE"),
        ("Table 4b", "GA-Net-deep", "EPE"),
        ("Table 4b", "GA-Net-deep", "macs"),
        ("Table 5", "GA-Net-11", "macs"),
    } <= told


def test_cells_are_the_printed_ones(cells):
    # Typed from the paper, not from the data file.
    printed = {(cell.table, cell.row, cell.what): cell.printed for cell in cells}
    for table, row, macs, params in (
        ("Table 3a", "table3a-v2-v1", 35.10, 1.26),
        ("Table 3b", "table3b-conv-v2", 149.01, 3.53),
        ("Appendix 2D", "appendix2d-v2-conv", 29.75, 1.20),
        ("Appendix 3D", "appendix3d-conv-v2", 69.44, 0.89),
        ("Table 4b", "3D-MobileStereoNet", 153.14, 1.77),
        ("Table 5", "2D-MobileStereoNet", 32.2, 2.32),
        ("Table 6", "GwcNet-g", None, None),
    ):
        assert (printed[table, row, "macs"], printed[table, row, "params"]) == (macs, params)
    assert printed["Modules", "features, both images, MobileStereoNet", "macs"] == 7.84
    assert printed["Modules", "encoder-decoder 2D, baseline", "params"] == 2.61
    assert len(cells) == len(printed)
    own = [cell for cell in cells if cell.table not in COMPARISONS]
    assert len(own) == 2 * (9 + 9 + 4 + 4 + 6)
    with_figures = [cell for cell in cells if cell.table in COMPARISONS and cell.printed]
    assert len(with_figures) == 5 + 2 * (10 + 7)


@pytest.mark.parametrize("name", COMPARISONS)
def test_every_network_that_is_here_is_counted(name, tables):
    for row in tables[name].rows:
        counted = {cell.what for cell in row.cells if cell.counted}
        assert counted == ({"macs", "params"} if own_name(row.name) else set())
    missing = {row.name for row in tables[name].rows if not own_name(row.name)}
    assert missing == ({"AutoDispNet-CSS"} if name == "Table 6" else set())


@pytest.mark.parametrize(
    ("row", "macs"),
    [
        ("GCNet", 718.043),
        ("GA-Net-11", 383.765),
        ("GA-Net-deep", 670.494),
        ("DeepPruner-Best", 129.228),
        ("DeepPruner-Fast", 51.832),
        ("Gwc40-Cat24-Base", 169.421),
    ],
)
def test_counts(row, macs, cells):
    cell = next(c for c in cells if (c.table, c.row, c.what) == ("Table 4b", row, "macs"))
    assert cell.counted == pytest.approx(macs, abs=0.001)


def test_the_page_has_these_counts(tables):
    page = (REPOSITORY / "docs/paper.md").read_text(encoding="utf-8")
    section = page.partition("### The networks")[2]
    rows = re.findall(r"^\| ([^|]+) \(`.*`\) \|(.*)\|$", section, re.M)
    assert len(rows) == 17
    counts = {
        (row.name, cell.what, f"{figure or 0:.2f}".removesuffix(".00"))
        for table in tables.values()
        for row in table.rows
        for cell in row.cells
        for figure in (cell.counted, cell.printed)
    }
    for name, texts in rows:
        params, printed_params, macs, printed_macs, _ = (text.strip() for text in texts.split("|"))
        for what, figures in (("params", (params, printed_params)), ("macs", (macs, printed_macs))):
            for figure in filter(None, figures):
                assert (name, what, figure) in counts


def number(text):
    digits = re.sub(r"[^\d.]", "", text)
    return float(digits) if digits else None


@needs_shared
def test_data_is_the_papers():
    """Every row of the comparisons as the source of the paper has it."""
    source = (SHARED / "paper" / "mobilestereonet.tex").read_text()
    lines = [line.split("&") for line in source.splitlines() if line.count("&") > 1]
    own = json.loads((resources.files("mobilestereonet.paper") / "tables.json").read_text())
    for table in ("table4a", "table4b", "table5", "table6"):
        for row in own[table]:
            name, *figures = row.values()
            found = [
                [number(cell) for cell in cells[: len(figures)]]
                for first, *cells in lines
                if re.split(r"\\cite", first)[0].strip() == name and len(cells) >= len(figures)
            ]
            assert figures in found, (table, name)


@needs_shared
def test_data_is_the_shared_copy():
    own = json.loads((resources.files("mobilestereonet.paper") / "tables.json").read_text())
    original = json.loads((SHARED / "paper" / "tables.json").read_text())
    for key in own.keys() & original.keys() - {"note"}:
        assert own[key] == original[key]
    assert own["table7"] == original["model_size_mb"]


def test_model_sizes():
    found = {size.model: size for size in model_sizes()}
    assert len(found) == 7
    for size in found.values():
        assert size.measured == pytest.approx(size.printed, rel=0.015)
