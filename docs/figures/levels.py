"""Speed of the quality levels in frames per second, and their time against their error."""

from __future__ import annotations

import json
from pathlib import Path

from boxes import INK, QUIET, save
from matplotlib.figure import Figure

from mobilestereonet.evaluation.pareto import ParetoPoint, label_points, pareto_front

MEASURED = json.loads(Path(__file__).with_name("levels.json").read_text("utf-8"))

COLOURS = {"bf16": "#2b6cb0", "fp32": "#90a4ae"}
SGBM_COLOUR = "#c4501b"


def draw_speed(path: Path) -> None:
    """Bars of frames per second, a pair of them per level."""
    figure = Figure(figsize=(7, 2.6), layout="constrained", facecolor="white")
    axes = figure.subplots()
    levels = MEASURED["levels"]
    ticks = []
    for index, level in enumerate(levels):
        for offset, (precision, colour) in enumerate(COLOURS.items()):
            seconds = level["seconds"][precision]
            y = 2.5 * index + offset
            axes.barh(y, 1 / seconds, 0.9, color=colour, label="" if index else precision)
            text = f"{1 / seconds:.2g} per second ({seconds:g} s a pair)"
            axes.text(1 / seconds + 0.02, y, text, va="center", size=8, color=INK)
        ticks.append((2.5 * index + 0.5, f"{level['quality']}\n({level['model']})"))
    axes.set_yticks(*zip(*ticks, strict=True))
    axes.invert_yaxis()
    axes.set(xlim=(0, 1.35), xlabel=f"frames per second at {_size()}, {MEASURED['machine']}")
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(loc="lower right", frameon=False)
    save(figure, path)


def draw_pareto(path: Path) -> None:
    """Seconds per pair against the median D1 of the real pairs; the line joins the front."""
    figure = Figure(figsize=(6, 3.6), layout="constrained", facecolor="white")
    axes = figure.subplots()
    levels, sgbm = MEASURED["levels"], MEASURED["sgbm"]
    points = [
        ParetoPoint(f"{level['model']} ({level['quality']})", seconds["bf16"], error)
        for level in levels
        for seconds, error in [(level["seconds"], level["d1_percent"])]
    ]
    points.append(ParetoPoint("StereoSGBM (OpenCV)", sgbm["seconds"], sgbm["d1_percent"]))
    front = pareto_front(points)
    axes.plot([p.seconds for p in front], [p.error for p in front], "--", color=QUIET, lw=0.8)
    for point in points:
        colour = SGBM_COLOUR if "SGBM" in point.name else COLOURS["bf16"]
        axes.plot(point.seconds, point.error, "o", ms=8, color=colour)
    axes.set(xscale="log", xlim=(0.08, 8), ylim=(0, 9))
    axes.set(xlabel=f"seconds per pair of {_size()}, bf16, {MEASURED['machine']}")
    axes.set(ylabel="median D1 of six real pairs, %")
    axes.set_xticks([0.1, 0.2, 0.5, 1, 2, 5], ["0.1", "0.2", "0.5", "1", "2", "5"])
    axes.minorticks_off()
    axes.grid(alpha=0.3)
    figure.draw_without_rendering()
    figure.set_layout_engine("none")
    label_points(axes, points, [8.0] * len(points), fontsize=9)
    save(figure, path)


def _size() -> str:
    return f"{MEASURED['width']} x {MEASURED['height']}"
