"""Pareto plot of matchers: time against error, and who is beaten by nobody in both."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from mobilestereonet.atomic import write_atomically
from mobilestereonet.errors import InputError, needs_extra

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.text import Annotation
    from matplotlib.transforms import Bbox

_LABEL_PLACES = tuple(
    (distance * across, distance * up)
    for distance in (7, 14, 22, 32, 44)
    for across, up in (
        (1, 0),
        (-1, 0),
        (0.7, 0.7),
        (-0.7, -0.7),
        (0.7, -0.7),
        (-0.7, 0.7),
        (0, 1),
        (0, -1),
    )
)
"""Offsets of a label from its point, in units of 1/72 inch, the best first."""

_MARKER_SIZE_PT = 7


class ParetoPoint(NamedTuple):
    """One matcher in the plot.

    Attributes:
        name: Its label.
        seconds: Time per pair.
        error: Its error, the smaller the better.
    """

    name: str
    seconds: float
    error: float


def pareto_front(points: Sequence[ParetoPoint]) -> list[ParetoPoint]:
    """Points that no other one beats: as fast and as accurate, and better in one of the two.

    Returns:
        They, the fastest first.
    """
    front: list[ParetoPoint] = []
    for point in sorted(points, key=lambda point: (point.seconds, point.error)):
        if not front or point.error < front[-1].error or point[1:] == front[-1][1:]:
            front.append(point)
    return front


def plot_pareto(
    points: Sequence[ParetoPoint], picture: Path, time: str = "seconds", error: str = "error"
) -> None:
    """Draw time (logarithmic) against error; a line joins the points of the front.

    Args:
        points: At least one.
        picture: PNG file to write.
        time: Label of the time's axis.
        error: Label of the error's axis.

    Raises:
        InputError: If there is no point, or a time is not positive and finite.
    """
    write_atomically(
        picture,
        lambda path: draw_pareto(points, time, error).savefig(path, format="png", dpi=130),
    )


def draw_pareto(points: Sequence[ParetoPoint], time: str, error: str) -> Figure:
    """The figure of `plot_pareto`, whose arguments and errors it has."""
    with needs_extra("plots"):
        from matplotlib.figure import Figure
        from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter
    if not points:
        raise InputError("a Pareto plot needs at least one point")
    for point in points:
        if not 0 < point.seconds < math.inf:
            raise InputError(f"{point.name}: a time must be positive, got {point.seconds:g} s")

    figure = Figure(figsize=(6.5, 4), layout="constrained")
    axes = figure.subplots()
    front = pareto_front(points)
    axes.plot([p.seconds for p in front], [p.error for p in front], "--", color="C0", alpha=0.6)
    for point in points:
        colour = "C0" if point in front else "0.5"
        axes.plot(point.seconds, point.error, "o", color=colour, markersize=_MARKER_SIZE_PT)
    axes.set(xlabel=time, ylabel=error, xscale="log")
    fastest, slowest = (f(p.seconds for p in points) for f in (min, max))
    axes.set_xlim(fastest / 1.7, slowest * 1.7)
    axes.set_ylim(0, 1.15 * max(p.error for p in points) or 1)
    axes.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.grid(alpha=0.3)
    # Pixels of the canvas are known once the layout is.
    figure.draw_without_rendering()
    figure.set_layout_engine("none")
    label_points(axes, points, [_MARKER_SIZE_PT] * len(points))
    return figure


def label_points(
    axes: Axes, points: Sequence[ParetoPoint], sizes: Sequence[float], fontsize: float | None = None
) -> None:
    """Write the names at places where they cover neither each other, a point nor the front.

    Args:
        axes: Axes of a figure whose layout is done; their first line is the front.
        points: The points.
        sizes: Diameters of their markers, in units of 1/72 inch.
        fontsize: Of the names, likewise.
    """
    from matplotlib.transforms import Bbox

    places = axes.transData.transform([(p.seconds, p.error) for p in points])
    radii = [size * axes.figure.dpi / 72 / 2 for size in sizes]
    taken = [Bbox([at - radius, at + radius]) for at, radius in zip(places, radii, strict=True)]
    front = axes.transData.transform_path(axes.lines[0].get_path())
    for point in points:
        at = (point.seconds, point.error)
        label = axes.annotate(point.name, at, (0, 0), textcoords="offset points", fontsize=fontsize)
        # The fewest things covered, then the nearest place.
        costs = []
        for index, offset in enumerate(_LABEL_PLACES):
            box = _move(label, offset)
            outside = axes.bbox.count_contains(box.corners()) < len(box.corners())
            crossed = front.intersects_bbox(box, filled=False)
            costs.append((outside + crossed + box.count_overlaps(taken), index))
        taken.append(_move(label, _LABEL_PLACES[min(costs)[1]]))


def _move(label: Annotation, offset: tuple[float, float]) -> Bbox:
    """Put a label at an offset from its point; the box that it then covers, in pixels."""
    across, up = offset
    label.set_position(offset)
    label.set_horizontalalignment("left" if across > 0 else "right" if across else "center")
    label.set_verticalalignment("bottom" if up > 0 else "top" if up else "center")
    box: Bbox = label.get_window_extent()
    return box
