"""Boxes and arrows: what the diagrams are drawn with."""

from __future__ import annotations

import io
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import FancyBboxPatch

INK = "#1f2933"
QUIET = "#616e7c"
VIEW, FEATURES, VOLUME, DECODER, HEAD = "#e4e7eb", "#cfe3f7", "#ffe3c2", "#d6efd8", "#ead9f5"

STYLE = {
    "svg.fonttype": "none",  # text stays text: to be searched, and read aloud
    "svg.hashsalt": "mobilestereonet",
    "font.family": ["DejaVu Sans"],
    "font.size": 9,
    "text.color": INK,
}
"""For `matplotlib.rc_context`."""


def canvas(width: float, height: float) -> Axes:
    """Axes in which a unit is a hundredth of an inch, without frame; y goes down."""
    figure = Figure(figsize=(width / 100, height / 100), facecolor="white")
    axes = figure.add_axes((0, 0, 1, 1))
    axes.set(xlim=(0, width), ylim=(height, 0))
    axes.axis("off")
    return axes


def box(
    axes: Axes, x: float, y: float, width: float, height: float, colour: str, *lines: str
) -> None:
    """A rounded box, its first line in bold."""
    patch = FancyBboxPatch(
        (x, y), width, height, boxstyle="round,pad=0,rounding_size=6", fc=colour, ec=INK, lw=0.8
    )
    axes.add_patch(patch)
    top = y + height / 2 - 7 * (len(lines) - 1)
    for index, line in enumerate(lines):
        label(axes, x + width / 2, top + 14 * index, line, bold=index == 0, quiet=index > 0)


def label(
    axes: Axes,
    x: float,
    y: float,
    text: str,
    *,
    bold: bool = False,
    quiet: bool = False,
    align: str = "center",
) -> None:
    """One line of text; quiet is smaller and grey."""
    axes.text(
        x,
        y,
        text,
        ha=align,
        va="center",
        weight="bold" if bold else "normal",
        size=8 if quiet else 9,
        color=QUIET if quiet else INK,
    )


def arrow(axes: Axes, start: tuple[float, float], end: tuple[float, float]) -> None:
    """A thin arrow."""
    style = {"arrowstyle": "-|>", "lw": 0.9, "color": INK, "shrinkA": 0, "shrinkB": 0}
    axes.annotate("", xy=end, xytext=start, arrowprops=style)


def line(axes: Axes, *places: tuple[float, float]) -> None:
    """A thin line through places."""
    axes.plot(*zip(*places, strict=True), color=INK, lw=0.9, solid_capstyle="butt")


DARK = (
    "<style>@media (prefers-color-scheme: dark) "
    "{svg {filter: invert(.88) hue-rotate(180deg)}}</style>"
)
"""Turns a figure around on a dark page: white becomes nearly black, and colours stay."""


def save(figure: Figure, path: Path) -> None:
    """Write the figure; the same content gives the same file."""
    if path.suffix != ".svg":
        figure.savefig(path)
        return
    content = io.StringIO()
    figure.savefig(content, format="svg", metadata={"Date": None})
    path.write_text(content.getvalue().replace(" <defs>", f" {DARK}\n <defs>", 1), "utf-8")
