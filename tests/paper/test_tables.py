"""The paper's tables of costs, counted and printed."""

import json
from importlib import resources

import pytest

from extras import SHARED, needs_shared
from mobilestereonet.paper.tables import model_sizes, paper_tables


@pytest.fixture(scope="module")
def cells():
    return [cell for table in paper_tables() for row in table.rows for cell in row.cells]


def test_every_cell_agrees_but_the_known_misfits(cells):
    misfits = {(cell.table, cell.row, cell.what) for cell in cells if not cell.agrees}
    assert misfits == {
        ("Modules", "encoder-decoder 3D, baseline", "macs"),
        ("Finals", "2D-MobileStereoNet, KITTI", "params"),
    }
    assert all(cell.note for cell in cells if not cell.agrees)
    for cell in cells:
        tolerance = 0.01 if cell.what == "params" else cell.printed / 1000
        assert cell.agrees == (abs(cell.counted - cell.printed) <= tolerance)


def test_cells_are_the_printed_ones(cells):
    # Typed from the paper, not from the data file.
    printed = {(cell.table, cell.row, cell.what): cell.printed for cell in cells}
    for table, row, macs, params in (
        ("Table 3a", "table3a-v2-v1", 35.10, 1.26),
        ("Table 3b", "table3b-conv-v2", 149.01, 3.53),
        ("Appendix 2D", "appendix2d-v2-conv", 29.75, 1.20),
        ("Appendix 3D", "appendix3d-conv-v2", 69.44, 0.89),
    ):
        assert (printed[table, row, "macs"], printed[table, row, "params"]) == (macs, params)
    assert printed["Modules", "features, both images, MobileStereoNet", "macs"] == 7.84
    assert printed["Modules", "encoder-decoder 2D, baseline", "params"] == 2.61
    assert printed["Finals", "3D-MobileStereoNet", "macs"] == 153.14
    assert printed["Peers", "PSMNet", "macs"] == 256.66
    assert len(cells) == len(printed)
    own = [cell for cell in cells if cell.table != "Peers"]
    assert len(own) == 2 * (9 + 9 + 4 + 4 + 6 + 4)


@needs_shared
def test_data_is_the_shared_copy():
    own = resources.files("mobilestereonet.paper") / "tables.json"
    copy, original = (
        json.loads(path.read_text()) for path in (own, SHARED / "paper" / "tables.json")
    )
    copy.pop("note"), original.pop("note")
    assert copy == original


def test_model_sizes():
    found = {size.model: size for size in model_sizes() if size.measured is not None}
    assert {"2D-MobileStereoNet", "3D-MobileStereoNet", "PSMNet"} <= set(found)
    for size in found.values():
        assert size.measured == pytest.approx(size.printed, rel=0.015)
