import csv
import sys
from pathlib import Path

import cv2
import pytest

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"


@pytest.fixture
def accuracy(monkeypatch):
    """The script ``benchmarks/accuracy.py``."""
    monkeypatch.syspath_prepend(BENCHMARKS)
    for name in ("accuracy", "pareto"):
        monkeypatch.delitem(sys.modules, name, raising=False)
    import accuracy

    return accuracy


@pytest.fixture
def run(monkeypatch):
    """Run a script's main function with arguments."""

    def run(script, *arguments):
        monkeypatch.setattr(sys, "argv", ["script", *map(str, arguments)])
        script.main()

    return run


def test_accuracy_and_pareto(accuracy, run, tmp_path, capsys):
    table, plot = tmp_path / "accuracy.csv", tmp_path / "pareto.png"
    rows = ["sgbm", "sgbm,max_disparity=16"]
    run(accuracy, *rows, "--scenes", 1, "--repeats", 1, "--csv", table)
    text = capsys.readouterr().out
    assert "bad-1" in text and "procedural scenes" in text and "Over 1 real pairs" in text
    with table.open(newline="") as file:
        records = list(csv.DictReader(file))
    assert [record["model"] for record in records] == rows * 2
    assert [record["data"] for record in records] == ["skimage"] * 2 + ["procedural"] * 2
    # A search of 16 px is bad on the Motorcycle, whose occlusion is not known.
    assert float(records[1]["d1_all"]) > 50 > float(records[0]["d1_all"]) > 0
    assert records[0]["d1_noc"] == "" and float(records[2]["bad1_noc"]) >= 0
    assert float(records[0]["seconds"]) > 0 and records[2]["seconds"] == ""

    import pareto

    run(pareto, table, "-o", plot)
    assert cv2.imread(str(plot)) is not None


def test_rows(accuracy, tmp_path, monkeypatch):
    opened = []
    monkeypatch.setattr(
        accuracy.StereoMatcher, "from_pretrained", lambda **settings: opened.append(settings)
    )
    weights = tmp_path / "run.safetensors"
    weights.touch()
    rows = ["msnet2d.procedural-1", "msnet2d,refine=false", "quality=fast", "sgbm"]
    found = accuracy.matchers([weights], "bf16", rows)
    assert list(found) == [*rows, "run"]
    assert opened == [
        {"source": "msnet2d.procedural-1", "precision": "bf16"},
        {"source": "msnet2d", "refine": False, "precision": "bf16"},
        {"quality": "fast", "precision": "bf16"},
        {"source": "sgbm"},
        {"source": str(weights), "precision": "bf16"},
    ]
    with pytest.raises(SystemExit, match="rename the file"):
        accuracy.matchers([weights], rows=[f"{weights}"])


def test_times_are_ratios_to_the_first_row(accuracy):
    seconds = {"first": (1.0, 2.0, 9.0), "second": (3.0, 4.0, 9.0)}
    records = [
        {"model": model, "seconds": own[pair]}
        for pair in range(3)
        for model, own in seconds.items()
    ]
    assert accuracy.times(records) == {"first": (2.0, 1.0), "second": (4.0, 2.0)}
    assert accuracy.times([*records, {"model": "third", "seconds": None}]) == {
        "first": (None, None),
        "second": (None, None),
        "third": (None, None),
    }
