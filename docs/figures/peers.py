"""The paper's Figure 1 again, and once more with what a CPU takes in place of MACs."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import NamedTuple

from boxes import INK, QUIET, save
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from mobilestereonet.evaluation.pareto import ParetoPoint, label_points, pareto_front
from mobilestereonet.paper.peers import compared_networks, comparison
from mobilestereonet.paper.rows import Row

MEASURED = Path(__file__).with_name("zoo.json")
"""What ``benchmarks/zoo.py`` measured."""

OURS, TWO_D, THREE_D = "#c4501b", "#2f7d3b", "#2b6cb0"
"""Colours of the paper's own networks, and of others with 2D and with 3D convolutions."""


class Panel(NamedTuple):
    """Axes, their points, and the diameters of these, in units of 1/72 inch."""

    axes: Axes
    points: list[ParetoPoint]
    sizes: list[float]


def draw_figure_1(path: Path) -> None:
    """EPE against MACs and parameters, on SceneFlow and on KITTI 2015."""
    two_d, three_d, kitti = map(comparison, ("Table 4a", "Table 4b", "Table 5"))
    figure, (left, right) = _panels()
    panels = []
    for axes, tables, title in (
        (left, (two_d, three_d), "SceneFlow, test set"),
        (right, (kitti,), "KITTI 2015, validation set"),
    ):
        rows = [row for table in tables for row in table.rows]
        points = [ParetoPoint(row.name, _cost(row, "macs"), row.errors["EPE"]) for row in rows]
        sizes = [_diameter(_cost(row, "params")) for row in rows]
        panels.append(Panel(axes, points, sizes))
        _scatter(panels[-1], {row.name for row in two_d.rows})
        axes.set(title=title, xlabel="MACs as the paper counts, G", ylabel="EPE in the paper, px")
    _finish(figure, panels, path)


def draw_measured(path: Path) -> None:
    """EPE on SceneFlow against seconds and memory of both forms of each network."""
    two_d, three_d = map(comparison, ("Table 4a", "Table 4b"))
    measured = json.loads(MEASURED.read_text())
    records = {(r["model"], r["form"]): r for r in measured["records"] if "failure" not in r}
    rows = {row.name: row for table in (two_d, three_d) for row in table.rows}
    networks = [
        (rows[title], records[name, "plain"], records[name, "accelerated"])
        for title, name in compared_networks().items()
        if title in rows and {(name, "plain"), (name, "accelerated")} <= records.keys()
    ]
    figure, (left, right) = _panels()
    panels = []
    for axes, key, label, unit in (
        (left, "seconds", "seconds per pair", 1),
        (right, "peak_mib", "peak memory of a pair, GiB", 1024),
    ):
        points = [
            ParetoPoint(row.name, fast[key] / unit, row.errors["EPE"]) for row, _, fast in networks
        ]
        sizes = [_diameter(_cost(row, "params")) for row, *_ in networks]
        _scatter(Panel(axes, points, sizes), {row.name for row in two_d.rows})
        plain = [
            point._replace(name="", seconds=slow[key] / unit)
            for point, (_, slow, _) in zip(points, networks, strict=True)
        ]
        for (_, x, y), (_, slow, _) in zip(points, plain, strict=True):
            axes.plot([slow, x], [y, y], color=QUIET, lw=0.8, alpha=0.5, zorder=1)
            axes.plot(slow, y, "o", mfc="white", mec=QUIET, ms=4, zorder=2)
        panels.append(Panel(axes, points + plain, sizes + [4.0] * len(plain)))
        axes.set(xlabel=label, ylabel="EPE on SceneFlow in the paper, px")
    processor = f"{measured['threads']} threads of {measured['processor']}"
    figure.suptitle(f"filled: accelerated, hollow: plain; fp32, {processor}", size=9)
    _finish(figure, panels, path)


def _cost(row: Row, what: str) -> float:
    cell = next(cell for cell in row.cells if cell.what == what)
    value = cell.printed if cell.counted is None else cell.counted
    assert value is not None
    return value


def _panels() -> tuple[Figure, list[Axes]]:
    figure = Figure(figsize=(10, 4.6), layout="constrained", facecolor="white")
    return figure, list(figure.subplots(1, 2))


def _scatter(panel: Panel, two_d: set[str]) -> None:
    """A disc for each point, and the front of them all."""
    axes, points, sizes = panel
    front = pareto_front(points)
    axes.plot([p.seconds for p in front], [p.error for p in front], "--", color=QUIET, lw=0.8)
    for (name, x, y), size in zip(points, sizes, strict=True):
        other = TWO_D if name in two_d else THREE_D
        colour = OURS if name.endswith("MobileStereoNet") else other
        axes.plot(x, y, "o", ms=size, mfc=colour, mec=colour, alpha=0.55, zorder=3)
    axes.set(xscale="log", ylim=(0, None))
    axes.grid(alpha=0.3)


def _diameter(millions: float) -> float:
    """Of a disc whose area is in proportion to the parameters, in units of 1/72 inch."""
    return 3.2 * math.sqrt(millions)


def _finish(figure: Figure, panels: list[Panel], path: Path) -> None:
    for axes, *_ in panels:
        low, high = axes.get_xlim()
        axes.set_xlim(low / 1.5, high * 1.8)
        axes.set_ylim(0, 1.12 * axes.get_ylim()[1])
        axes.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axes.xaxis.set_minor_formatter(NullFormatter())
    kinds = ((OURS, "MobileStereoNet"), (TWO_D, "2D"), (THREE_D, "3D"))
    handles = [
        *(Line2D([], [], ls="", marker="o", color=colour, label=label) for colour, label in kinds),
        Line2D([], [], ls="", marker="o", color=INK, ms=_diameter(5), label="5 M parameters"),
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=4, frameon=False)
    # Pixels of the canvas are known once the layout is.
    figure.draw_without_rendering()
    figure.set_layout_engine("none")
    for panel in panels:
        label_points(*panel, fontsize=8)
    save(figure, path)
