"""``msnet cost``: MACs and parameters of a network, or of the paper's tables."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from mobilestereonet.cli.early import check_network_values, network_name
from mobilestereonet.cli.engine import NetworkValues, network_values
from mobilestereonet.cli.options import AsJson
from mobilestereonet.errors import InputError

if TYPE_CHECKING:
    from mobilestereonet.paper.rows import Cell, PaperTable

_SIZE = (256, 512)


def cost(
    model: Annotated[
        str | None,
        typer.Option(
            help="Network: a name, or a class of your own, my_net.py:MyNet. "
            "Default: msnet3d-cascade.",
            callback=network_name,
        ),
    ] = None,
    height: Annotated[int, typer.Option(help="Height of a view, in pixels.")] = _SIZE[0],
    width: Annotated[int, typer.Option(help="Width of a view, in pixels.")] = _SIZE[1],
    settings: NetworkValues = None,
    paper: Annotated[
        bool, typer.Option("--paper", help="Print the paper's cost figures, counted and printed.")
    ] = False,
    plot: Annotated[
        Path | None,
        typer.Option(help="With --paper: draw its figure of the expansion factor, as PNG."),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Count MACs and parameters, exactly and as the paper counts."""
    check_network_values(model, network_values(settings))
    if paper:
        if model or settings or (height, width) != _SIZE:
            raise InputError(
                "--paper counts the paper's models at 256 x 512: no --model, --set or size"
            )
        _print_paper(plot, as_json)
    elif plot:
        raise InputError("--plot draws a figure of the paper: give --paper too")
    else:
        from mobilestereonet.inference import DEFAULT_MODEL

        _print_model(model or DEFAULT_MODEL, settings or [], height, width, as_json)


def _print_model(model: str, settings: list[str], height: int, width: int, as_json: bool) -> None:
    from mobilestereonet.costs import count_costs
    from mobilestereonet.nets import model_config
    from mobilestereonet.settings import override
    from mobilestereonet.weights import card, embedded_models

    values = network_values(settings)
    config = override(model_config(model), values, f"model {model}")
    checked = {field: getattr(config, field) for field in values}
    parts = count_costs(model, height, width, checked)
    if as_json:
        facts = {"model": model, "config": asdict(config), "height": height, "width": width}
        costs = {name: asdict(cost) for name, cost in parts.items()}
        total = costs.pop("total")
        print(json.dumps({**facts, "parts": costs, "total": total}, indent=2))
        return
    _print_table(
        f"{' '.join([model, *settings])}, two views of 3 x {height} x {width}",
        ["part", "exact\nMACs G", "\nparams M", "paper's count\nMACs G", "\nparams M"],
        [
            [
                name,
                f"{cost.macs / 1e9:.3f}",
                f"{cost.params / 1e6:.4f}",
                f"{cost.paper_macs / 1e9:.3f}",
                f"{cost.paper_params / 1e6:.4f}",
            ]
            for name, cost in parts.items()
        ],
    )
    if model in embedded_models():
        told = card(model)["config"]
        other = {name: told[name] for name in told if name not in values}
        try:
            differ = count_costs(model, height, width, checked | other) != parts
        except InputError:  # a size or range that the embedded weights' network does not take
            differ = False
        if differ:
            texts = [f"{name}={json.dumps(value)}" for name, value in other.items()]
            options = " ".join(f"--set net.{text}" for text in texts)
            print(f"the embedded weights have {', '.join(texts)}: add {options} to count that")


def _print_paper(plot: Path | None, as_json: bool) -> None:
    from mobilestereonet.paper import blocks, peers, tables

    if plot:
        blocks.plot_expansion(plot)
    printed = tables.paper_tables()
    if as_json:
        cells = [asdict(cell) for table in printed for row in table.rows for cell in row.cells]
        print(json.dumps(cells, indent=2))
        return
    print(
        "Errors are the paper's figures. ! marks a cost that does not agree with the printed one."
    )
    _print_blocks()
    for table in printed:
        _print_rows(table)
    _print_table(
        "Table 7: checkpoint file in MB (1e6 bytes)",
        ["model", "measured", "paper"],
        [
            [size.model, f"{size.measured:.2f}", f"{size.printed:.2f}"]
            for size in peers.model_sizes()
        ],
    )
    if plot:
        print(f"figure of the expansion factor: {plot}")


def _print_blocks() -> None:
    """The paper's Table 1 and the curves of its expansion-factor figure."""
    from mobilestereonet.paper import blocks, tables

    printed = tables.printed_reduction_factors()
    _print_table(
        "Table 1: MACs per output element, k = 3, 32 -> 64 channels, t = 2",
        ["block", "MACs", "reduction\nfactor", "\npaper"],
        [
            [
                f"{dims}D {kind}",
                str(blocks.block_macs(kind, dims, 32, 64)),
                f"{blocks.reduction_factor(kind, dims, 32, 64):.2f}",
                str(printed.get(f"{dims}d_{kind}", "")),
            ]
            for dims in (2, 3)
            for kind in ("conv", "v1", "v2")
        ],
    )
    kinds = [(dims, channels) for dims in (2, 3) for channels in blocks.EXPANSION_CHANNELS]
    curves = [blocks.expansion_curve(dims, channels) for dims, channels in kinds]
    _print_table(
        "Expansion factor t: reduction factor of v2 blocks of C channels",
        ["t", *(f"{dims}D\nC = {channels}" for dims, channels in kinds)],
        [
            [str(t), *(f"{factor:.2f}" for factor in factors)]
            for t, factors in zip(blocks.EXPANSIONS, zip(*curves, strict=True), strict=True)
        ],
    )


def _print_rows(table: PaperTable) -> None:
    """A table with printed errors and costs (counted and printed), and the notes to them."""
    errors = list(dict.fromkeys(error for row in table.rows for error in row.errors))
    lines = [
        [row.name, *(f"{row.errors[error]:.2f}" if error in row.errors else "" for error in errors)]
        for row in table.rows
    ]
    headers = ["row", *(error.replace(" ", "\n") for error in errors)]
    for what, title in (("macs", "MACs G"), ("params", "params M")):
        column = [next((c for c in row.cells if c.what == what), None) for row in table.rows]
        counted = ["" if cell is None else _counted(cell) for cell in column]
        printed = ["" if cell is None else _number(cell.printed, 2) for cell in column]
        for header, texts in ((f"{title}\ncounted", counted), ("\npaper", printed)):
            if any(texts):
                headers.append(header)
                lines = [[*line, text] for line, text in zip(lines, texts, strict=True)]
    _print_table(f"{table.name}: {table.caption}", headers, lines)
    for note in table.notes():
        print(f"{'  ' if note.agrees else '! '}{note.row}, {note.column}: {note.text}")


def _counted(cell: Cell) -> str:
    return _number(cell.counted, 3) + ("" if cell.agrees else " !")


def _number(value: float | None, decimals: int) -> str:
    return "" if value is None else f"{value:.{decimals}f}"


def _print_table(title: str, headers: list[str], lines: list[list[str]]) -> None:
    """The first column is text, the others are numbers."""
    from rich.box import SIMPLE_HEAD
    from rich.console import Console
    from rich.table import Table

    table = Table(box=SIMPLE_HEAD, pad_edge=False, collapse_padding=True)
    for index, header in enumerate(headers):
        table.add_column(header, justify="right" if index else "left", no_wrap=True)
    for line in lines:
        table.add_row(*line)
    print(f"\n{title}", flush=True)
    Console().print(table)
