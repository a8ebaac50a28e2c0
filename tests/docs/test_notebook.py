"""The notebook in the docs: its cells are those that were run, and all of them ended well."""

import importlib
import json

from pages import ROOT


def test_the_notebook_was_run(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "docs/figures"))
    source = importlib.import_module("notebook")
    notebook = json.loads(source.NOTEBOOK.read_text())
    assert ["".join(cell["source"]) for cell in notebook["cells"]] == list(source.CELLS)
    code = [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]
    assert [cell["execution_count"] for cell in code] == [1, 2, 3, 4]
    assert all(cell["outputs"] for cell in code)
    pictures = [
        output
        for cell in code
        for output in cell["outputs"]
        if "image/png" in output.get("data", ())
    ]
    assert len(pictures) == 2


def test_a_cell_keeps_what_it_shows(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "docs/figures"))
    run = importlib.import_module("notebook").run
    names = {}
    first = run("a = 2\nprint(a)", names, 1)
    assert [output.get("text") for output in first["outputs"]] == [["2\n"]]
    second = run("b = a\na + b", names, 2)
    assert second["outputs"][0]["data"] == {"text/plain": ["4"]}
    assert second["outputs"][0]["execution_count"] == 2
