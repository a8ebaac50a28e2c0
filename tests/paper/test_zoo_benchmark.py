"""The benchmark of all networks: its measurement, its limits and its tables."""

import json
import sys

import pytest
import torch

from extras import need_extra
from parity import REPOSITORY

need_extra("skimage")


@pytest.fixture
def scripts(monkeypatch):
    """The scripts ``benchmarks/zoo.py`` and ``benchmarks/zoo_table.py``."""
    monkeypatch.syspath_prepend(REPOSITORY / "benchmarks")
    for name in ("speed", "zoo", "zoo_table"):
        monkeypatch.delitem(sys.modules, name, raising=False)
    import zoo
    import zoo_table

    return zoo, zoo_table


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_one_measurement(scripts):
    zoo, _ = scripts
    case = zoo.case_of("fast-ds-cs", "accelerated", "32x64")
    record = zoo.measure(case, torch.get_num_threads(), seconds=0)
    assert record["runs"] == 1
    assert record["seconds"] == record["first"] > 0
    assert abs(record["peak_mib"]) < 500  # of a process that holds other tests' memory
    options = {"model": "gcnet", "form": "plain", "size": None, "threads": 1, "seconds": 0}
    assert zoo.measure_apart(options, (60, 0.01)) == {"failure": "does not fit in 0.01 GiB"}
    assert zoo.measure_apart(options, (0, 8)) == {"failure": "took more than 0 s"}


def test_tables(scripts, tmp_path):
    zoo, zoo_table = scripts
    names = {"model": "psmnet", "size": "256x512"}
    records = [
        {**names, "form": "plain", "seconds": 4.0, "first": 5.0, "peak_mib": 2000.0},
        {**names, "form": "accelerated", "failure": "does not fit in 23 GiB"},
    ]
    (tmp_path / "zoo.json").write_text(json.dumps({"records": records}))
    row = "| `psmnet` | 4.00 | does not fit in 23 GiB | 2000 | does not fit in 23 GiB |"
    assert row in zoo_table.speed(tmp_path / "zoo.json")
    assert "| `nets/gwcnet.py` | `gwcnet-gc-base`, `gwcnet-gc` | " in zoo_table.lines()
    assert zoo.table(records).row_count == 2
