"""The cost figures that the paper prints, each beside this package's count.

MACs and parameters are those of `count_costs` as the paper counts, at 256 x 512. Errors, such as
EPE, are shown as printed: none of them was measured here.
"""

from __future__ import annotations

import functools
from typing import Any

from mobilestereonet.costs.count import Cost, count_costs
from mobilestereonet.errors import InputError
from mobilestereonet.paper.peers import comparisons, own_name
from mobilestereonet.paper.rows import PaperTable, Row, cells, printed


@functools.cache
def _costs(model: str, **overrides: Any) -> dict[str, Cost]:
    return count_costs(model, height=256, width=512, config=overrides)


def _ablation(table: str, caption: str, key: str, fields: tuple[str, str]) -> PaperTable:
    """Table whose rows are models named ``<table>-<field>-<field>``, without the table's space."""
    rows = []
    for line in printed()[key]:
        model = "-".join([table.lower().replace(" ", ""), *(line[field] for field in fields)])
        costs = cells(table, model, _costs(model)["total"], line["macs"], line["params"])
        rows.append(Row(model, {"EPE": line["epe"]}, costs))
    return PaperTable(table, caption, tuple(rows))


def _cost_volumes() -> PaperTable:
    rows = tuple(
        Row(
            f"table2-{line['cost_volume']}",
            {"EPE": line["epe"], "D1": line["d1"], "px-3": line["px3"]},
        )
        for line in printed()["table2_cost_volume_sceneflow"]
    )
    return PaperTable("Table 2", "2D baseline by cost volume", rows)


def _modules() -> PaperTable:
    def encoder_decoder(model: str, **overrides: Any) -> Cost:
        costs = _costs(model, **overrides)
        return costs["pre_hourglass"] + costs["hourglasses"]

    features = _costs("baseline3d")["features"], _costs("msnet3d")["features"]
    decoder2d = encoder_decoder("baseline2d", hourglasses=3), encoder_decoder("msnet2d")
    # See the notes: the paper's MACs and parameters are of two different pre-hourglasses.
    final3d = Cost(
        paper_macs=encoder_decoder("msnet3d", pre_expansion=2).paper_macs,
        paper_params=encoder_decoder("msnet3d").paper_params,
    )
    decoder3d = encoder_decoder("baseline3d", hourglasses=3), final3d
    rows = []
    for line, (baseline, final) in zip(
        printed()["table_appendix_modules"], (features, decoder2d, decoder3d), strict=True
    ):
        for kind, cost, prefix in (
            ("baseline", baseline, "baseline_"),
            ("MobileStereoNet", final, ""),
        ):
            name = f"{line['module']}, {kind}"
            costs = cells("Modules", name, cost, line[f"{prefix}macs"], line[f"{prefix}params"])
            rows.append(Row(name, {}, costs))
    caption = "an encoder-decoder is the pre-hourglass and three hourglasses"
    return PaperTable("Modules", caption, tuple(rows))


def ablation_tables() -> list[PaperTable]:
    """Tables 2, 3a and 3b, and both ablations of the appendix."""
    blocks, further = ("features", "hourglass"), ("first_conv", "pre_hourglass")
    by_blocks = "by features and hourglass"
    by_further = "by first convolutions and pre-hourglass"
    return [
        _cost_volumes(),
        _ablation("Table 3a", f"2D networks {by_blocks}", "table3a_2d", blocks),
        _ablation("Table 3b", f"3D networks {by_blocks}", "table3b_3d", blocks),
        _ablation("Appendix 2D", f"2D networks {by_further}", "table_appendix_2d_further", further),
        _ablation("Appendix 3D", f"3D networks {by_further}", "table_appendix_3d_further", further),
    ]


def paper_tables() -> list[PaperTable]:
    """The ablations, the table of modules, and the comparisons with other networks.

    Takes some seconds: about forty networks are counted.
    """
    return [*ablation_tables(), _modules(), *comparisons()]


def printed_reduction_factors() -> dict[str, float]:
    """The example of the paper's Table 1 (k = 3, 32 -> 64 channels, t = 2): "2d_v1" to "3d_v2"."""
    table = printed()["table1_reduction"]
    return {key: table[key] for key in ("2d_v1", "2d_v2", "3d_v1", "3d_v2")}


_FIGURES = {"EPE": "epe", "D1": "d1", "px-3": "bad3", "epe": "epe", "d1": "d1", "px3": "bad3"}
"""The paper's names of errors, and those of `MaskScores`."""

_ERROR_TABLES: dict[str, dict[str, tuple[str, ...]]] = {
    "sceneflow": {
        "table2_cost_volume_sceneflow": ("table2", "cost_volume"),
        "table3a_2d": ("table3a", "features", "hourglass"),
        "table3b_3d": ("table3b", "features", "hourglass"),
        "table_appendix_2d_further": ("appendix2d", "first_conv", "pre_hourglass"),
        "table_appendix_3d_further": ("appendix3d", "first_conv", "pre_hourglass"),
        "table4a": (),
        "table4b": (),
    },
    "kitti2015": {"table5": ()},
}
"""Tables with errors, by data set: the fields of a row that make a registered name."""


PRINTED_ON = (
    "Paper: means over the images as its authors measured them, on the test split of SceneFlow or "
    "on 40 validation pairs of KITTI 2015 (--split val), of networks trained on those data sets."
)
"""What the figures of `printed_errors` are."""


def printed_errors(data: str) -> dict[str, dict[str, float]]:
    """The errors that the paper prints, all measured by its authors.

    Args:
        data: "sceneflow" (its test split) or "kitti2015" (the paper's 40 validation pairs).

    Returns:
        Registered name of a network to its errors, by the names of `MaskScores`: ``epe`` in px,
        ``d1`` and ``bad3`` in percent.

    Raises:
        InputError: If the paper prints none for a data set.
    """
    if data not in _ERROR_TABLES:
        raise InputError(
            f"the paper prints no errors on {data}, only on {', '.join(_ERROR_TABLES)}"
        )
    errors: dict[str, dict[str, float]] = {}
    for table, fields in _ERROR_TABLES[data].items():
        for line in printed()[table]:
            parts = [fields[0], *(line[field] for field in fields[1:])] if fields else []
            name = "-".join(parts) if parts else own_name(line["model"])
            if name:
                errors[name] = {_FIGURES[key]: line[key] for key in line if key in _FIGURES}
    return errors
