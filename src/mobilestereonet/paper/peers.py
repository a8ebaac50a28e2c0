"""The paper's comparisons with other networks: Tables 4a, 4b, 5, 6 and that of model sizes."""

from __future__ import annotations

import functools
import io
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import torch

from mobilestereonet.costs.count import Cost, count_costs
from mobilestereonet.nets import build_model, list_models
from mobilestereonet.paper.rows import PaperTable, Row, cells, printed

_OWN_NAMES = {
    "2D-MobileStereoNet": "msnet2d",
    "3D-MobileStereoNet": "msnet3d",
    "Gwc40-Cat24-Base": "gwcnet-gc-base",
    "MC-CNN": "mccnn-slow",
}
"""Registered names that are not the paper's in lower case."""

_CAPTIONS = {
    "Table 4a": "2D networks, errors on SceneFlow",
    "Table 4b": "3D networks, errors on SceneFlow",
    "Table 5": "errors on KITTI 2015 (validation)",
    "Table 6": "D1 in percent on KITTI 2015 (test), of all pixels and of those not occluded",
}


@dataclass(frozen=True)
class ModelSize:
    """Size of a model in MB (1e6 bytes).

    Attributes:
        model: The paper's name of it.
        measured: Size of this package's file.
        printed: The paper's figure.
    """

    model: str
    measured: float
    printed: float


def comparisons() -> list[PaperTable]:
    """Tables 4a, 4b, 5 and 6, with the costs of every network that is registered."""
    return [comparison(name) for name in _CAPTIONS]


def comparison(table: str) -> PaperTable:
    """A comparison table of the paper by its name, such as "Table 4a"."""
    rows = []
    for line in printed()[_key(table)]:
        model, name = line["model"], own_name(line["model"])
        cost = comparison_cost(name) if name else None
        costs = cells(table, model, cost, line.get("macs"), line.get("params"))
        rows.append(Row(model, _errors(line), costs))
    return PaperTable(table, _CAPTIONS[table], tuple(rows))


def _key(table: str) -> str:
    return table.lower().replace(" ", "")


def _errors(line: Mapping[str, Any]) -> dict[str, float]:
    return {key: line[key] for key in line if key not in ("model", "macs", "params")}


def own_name(model: str) -> str | None:
    """Registered name of a network by the paper's; None if it is not here."""
    names = {name.replace("-", ""): name for name in list_models()}
    return _OWN_NAMES.get(model) or names.get(model.replace("-", "").replace(" ", "").lower())


def compared_networks() -> dict[str, str]:
    """The networks of the comparisons that are here: the paper's name, and the registered one."""
    tables = (printed()[_key(table)] for table in _CAPTIONS)
    models = dict.fromkeys(line["model"] for lines in tables for line in lines)
    return {model: name for model in models if (name := own_name(model))}


def comparison_size(name: str) -> tuple[int, int]:
    """Height and width of the views on which a network is compared: 256 x 512, or the next one."""
    return (288, 576) if name.startswith("ganet") else (256, 512)


@functools.cache
def comparison_cost(name: str) -> Cost:
    """Cost of a registered network at `comparison_size`, as the paper counts.

    GA-Net's is without norms and ReLUs, see the notes.
    """
    height, width = comparison_size(name)
    if name.startswith("ganet"):
        return _enlarged(count_costs(name, height // 6, width // 6, elementwise=False)["total"], 36)
    if name.startswith("mccnn"):
        return _enlarged(count_costs(name, height // 8, width)["total"], 8)
    return count_costs(name, height, width)["total"]


def _enlarged(cost: Cost, factor: int) -> Cost:
    """The cost of views with so many times as many pixels, of a network in proportion to them.

    Layers that go line by line through a volume make a count on large views slow.
    """
    return Cost(factor * cost.macs, factor * cost.paper_macs, cost.params, cost.paper_params)


def checkpoint_megabytes(name: str) -> float:
    """Size in MB (1e6 bytes) of a registered network's checkpoint, the file of ``torch.save``.

    This reading of the paper's model size comes nearest. It holds all parameters and batch norm
    buffers in float32 (9.57 MB of the 2D network, 7.55 MB of the 3D one) and some 350 bytes a
    tensor for its name, headers and alignment. The latter depend on PyTorch's version and on the
    names, so the printed 10.03 and 7.99 are met to 1 % only: both are 44 bytes a tensor more than
    what PyTorch 2.13 writes.
    """
    with torch.device("meta"):
        state = build_model(name).state_dict(prefix="module.")
    state = {key: torch.empty_like(tensor, device="cpu") for key, tensor in state.items()}
    file = io.BytesIO()
    torch.save({"model": state}, file)
    return len(file.getvalue()) / 1e6


def model_sizes() -> list[ModelSize]:
    """The paper's table of model sizes, Table 7."""
    return [
        ModelSize(model, checkpoint_megabytes(name), size)
        for model, size in printed()["table7"].items()
        if (name := own_name(model))
    ]
