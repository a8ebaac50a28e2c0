"""The page of all networks: its figures are the code's, and it tells what the registry knows."""

import re

import pytest
from pages import ROOT

from mobilestereonet.cli.early import ABLATIONS
from mobilestereonet.costs import count_costs
from mobilestereonet.nets import list_models, model_info
from mobilestereonet.weights import count_parameters

PAGE = (ROOT / "docs/zoo.md").read_text("utf-8")
ABLATION_ROWS = {name for pattern in ABLATIONS for name in list_models(pattern)}
NETWORKS = [name for name in list_models() if name not in ABLATION_ROWS]
COSTS = PAGE.partition("## Costs")[2].partition("\n## ")[0]
CELLS = [
    [cell.strip() for cell in row.strip("|").split("|")]
    for row in re.findall(r"^\| \[?`.*\|$", COSTS, re.M)
]
ROWS = {name for pattern in ABLATIONS for name in list_models(pattern)}
NETWORKS = [name for name in list_models() if name not in ABLATION_ROWS]
CELLS = [
    [cell.strip() for cell in row.strip("|").split("|")]
    for row in re.findall(
        r"^\| \[?`.*\|$", PAGE.partition("## Costs")[2].partition("\n## ")[0], re.M
    )
]
ROWS = {name.split("`")[1]: cells for name, *cells in CELLS}


def test_the_page_has_all_networks():
    assert sorted(ROWS) == sorted(NETWORKS)
    section = PAGE.partition("## What was tested")[2].partition("\n## ")[0]
    for name in set(NETWORKS) - {"msnet3d", "msnet3d-cascade", "baseline2d", "baseline3d"}:
        assert f"`{name}`" in section, name


@pytest.mark.parametrize("name", NETWORKS)
def test_facts(name):
    info = model_info(name)
    venue, _, reach, parameters, _ = ROWS[name]
    assert info.paper.endswith(venue)
    assert int(reach) == info.config.max_disparity
    assert parameters == f"{count_parameters(name) / 1e6:.3f}"
    repositories = re.findall(r"[\w-]+/[\w-]+(?= on GitHub)", info.checkpoints)
    for repository in repositories:
        row = next(line for line in PAGE.splitlines() if f"| {repository} |" in line)
        assert f"`{name}`" in row
        assert ("| no: " in row) == info.checkpoints.startswith("none")


@pytest.mark.parametrize("name", NETWORKS)
def test_macs(name):
    # In proportion to the number of pixels (GA-Net) or of rows: the whole takes long.
    sizes = {"ganet": (48, 96, 36), "mccnn": (32, 512, 8)}
    height, width, factor = sizes.get(name.partition("-")[0], (256, 512, 1))
    macs = factor * count_costs(name, height, width)["total"].macs
    assert ROWS[name][-1].removesuffix(" †") == f"{macs / 1e9:.1f}"
