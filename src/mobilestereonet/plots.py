"""Visualisation: disparity colours, KITTI's error map, panels, training curves.

Every picture is an RGB array of shape (H, W, 3), uint8.
"""

from __future__ import annotations

import csv
import math
from collections import defaultdict
from collections.abc import Iterable, Sequence
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from mobilestereonet.atomic import write_atomically
from mobilestereonet.data.images import Picture, to_picture
from mobilestereonet.data.sample import StereoSample
from mobilestereonet.errors import InputError, needs_extra
from mobilestereonet.text import decode, shorten

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MapLike = Tensor | NDArray[Any]
_Curve = tuple[list[float], list[float]]

# The development kit of KITTI 2015 gives each doubling of the error the next of ten colours, from
# 1/16 of the threshold on; the sixth begins at the threshold. They are ColorBrewer's RdYlBu.
_ERROR_STEPS = 2.0 ** np.arange(-4, 5)
_ERROR_COLOURS = np.array(
    [
        (49, 54, 149),
        (69, 117, 180),
        (116, 173, 209),
        (171, 217, 233),
        (224, 243, 248),
        (254, 224, 144),
        (253, 174, 97),
        (244, 109, 67),
        (215, 48, 39),
        (165, 0, 38),
    ],
    dtype=np.uint8,
)
_PANEL_GAP_PX = 4
_MAX_COLUMNS = 1000
"""Columns of a run's log: more of them are none."""
_TITLE_HEIGHT_PX = 24


def colour_disparity(
    disparity: MapLike, maximum: float | None = None, valid: MapLike | None = None
) -> Picture:
    """Colour a disparity map: blue is far, red is near, black is unknown.

    Args:
        disparity: (H, W), in px.
        maximum: Disparity of the last colour; by default the 99th percentile of the map, so that
            a few wild values do not take the range away from the rest.
        valid: (H, W), False where the disparity is unknown. Values that are not finite are, too.

    Returns:
        (H, W, 3) uint8.
    """
    values = _array(disparity).astype(np.float32)
    known = np.isfinite(values)
    if valid is not None:
        known &= _array(valid).astype(bool)
    values = np.where(known, values, 0)
    if maximum is None:
        maximum = float(np.percentile(values[known], 99)) if known.any() else 1.0
    levels = np.clip(256 * values / max(maximum, 1e-6), 0, 255)
    # The same table as matplotlib's turbo, without waiting for its import.
    colours = cv2.applyColorMap(levels.astype(np.uint8), cv2.COLORMAP_TURBO)[..., ::-1]
    return np.where(known[..., None], colours, 0).astype(np.uint8)


def error_map(
    prediction: MapLike,
    truth: MapLike,
    valid: MapLike | None = None,
    occluded: MapLike | None = None,
) -> Picture:
    """Colour the error as KITTI does: cold colours are inliers, warm ones outliers of D1.

    The colour is min(error / 3 px, error / 5 % of the ground truth), on a logarithmic scale.

    Args:
        prediction: (H, W), in px.
        truth: Ground truth, (H, W), in px.
        valid: (H, W), False (black) where there is no ground truth; by default where it is 0.
        occluded: (H, W), drawn at half brightness where True.

    Returns:
        (H, W, 3) uint8.
    """
    true = _array(truth).astype(np.float32)
    known = true > 0 if valid is None else _array(valid).astype(bool)
    error = np.abs(_array(prediction).astype(np.float32) - true)
    relative = np.minimum(error / 3, error / np.maximum(0.05 * true, 1e-6))
    colours = _ERROR_COLOURS[np.digitize(relative, _ERROR_STEPS)]
    if occluded is not None:
        colours = np.where(_array(occluded).astype(bool)[..., None], colours // 2, colours)
    return np.where(known[..., None], colours, 0).astype(np.uint8)


def thicken(picture: Picture, known: MapLike) -> Picture:
    """Spread each known pixel over its unknown neighbours, so that sparse maps can be seen.

    Args:
        picture: (H, W, 3).
        known: (H, W), False where the picture shows nothing.

    Returns:
        (H, W, 3) uint8, black where neither a pixel nor one of its eight neighbours is known.
    """
    known = _array(known).astype(bool)
    # Each pixel gets the label of the nearest known one; each known pixel has a label of its own.
    distance, labels = cv2.distanceTransformWithLabels(
        (~known).astype(np.uint8), cv2.DIST_C, cv2.DIST_MASK_5, labelType=cv2.DIST_LABEL_PIXEL
    )
    colours = np.zeros((int(labels.max()) + 1, 3), np.uint8)
    colours[labels[known]] = picture[known]
    return np.where((distance <= 1)[..., None], colours[labels], 0).astype(np.uint8)


def side_by_side(panels: Sequence[Picture], titles: Sequence[str] | None = None) -> Picture:
    """Put pictures into one row on a white background.

    Args:
        panels: Pictures; lower ones are aligned at the top.
        titles: A line of text above each.

    Returns:
        (H, W, 3) uint8.
    """
    top = 0 if titles is None else _TITLE_HEIGHT_PX
    height = max(panel.shape[0] for panel in panels)
    columns = []
    for index, panel in enumerate(panels):
        right = 0 if index == len(panels) - 1 else _PANEL_GAP_PX
        border = (top, height - panel.shape[0], 0, right)
        column = cv2.copyMakeBorder(panel, *border, cv2.BORDER_CONSTANT, value=(255, 255, 255))
        if titles is not None:
            place, font = (4, top - 7), cv2.FONT_HERSHEY_SIMPLEX
            cv2.putText(column, titles[index], place, font, 0.5, (0, 0, 0), 1, cv2.LINE_AA)
        columns.append(column)
    return np.concatenate(columns, axis=1).astype(np.uint8)


def contact_sheet(samples: Iterable[StereoSample], width: int = 320) -> Picture:
    """Draw one row per sample: left, right, disparity, occlusion (grey if unknown).

    Args:
        samples: Single samples, not batches.
        width: Width of each panel in px.

    Returns:
        (H, W, 3) uint8.

    Raises:
        InputError: If there is no sample.
    """
    rows = [_contact_row(sample, width) for sample in samples]
    if not rows:
        raise InputError("a contact sheet needs at least one sample")
    return np.concatenate(rows, axis=0)


def _contact_row(sample: StereoSample, width: int) -> Picture:
    left, right = to_picture(sample.left), to_picture(sample.right)
    unknown = np.full_like(left, 128)
    disparity = occluded = unknown
    titles = [sample.name, "right", "no disparity", "no occlusion"]
    if sample.disparity is not None:
        disparity = colour_disparity(sample.disparity, valid=sample.valid)
        titles[2] = f"disparity, to {float(sample.disparity.max()):.0f} px"
    if sample.occluded is not None:
        occluded = np.where(_array(sample.occluded)[..., None], np.uint8(255), np.uint8(0))
        occluded = np.repeat(occluded, 3, axis=2)
        titles[3] = "occluded"
    size = (width, round(left.shape[0] * width / left.shape[1]))
    # Maps are not averaged: a mean of two disparity colours is a third disparity.
    ways = (cv2.INTER_AREA, cv2.INTER_AREA, cv2.INTER_NEAREST, cv2.INTER_NEAREST)
    panels = (left, right, disparity, occluded)
    return side_by_side(
        [
            cv2.resize(panel, size, interpolation=way).astype(np.uint8)
            for panel, way in zip(panels, ways, strict=True)
        ],
        titles,
    )


def plot_maps(
    maps: Sequence[tuple[str, NDArray[Any], dict[str, Any]]], figure: Figure | None = None
) -> Figure:
    """Draw pictures and maps beside each other; a map of one number per pixel has a colour bar.

    Args:
        maps: Title, array (H, W) or (H, W, 3), and options of Matplotlib's ``imshow``.
        figure: Figure to draw in; by default a new one.

    Raises:
        InputError: If Matplotlib is not installed.
    """
    with needs_extra("plots"):
        from matplotlib.figure import Figure
    height, width = maps[0][1].shape[:2]
    figure = Figure(layout="constrained") if figure is None else figure
    figure.set_size_inches(6 * len(maps), 6 * height / width + 0.4)
    panels = figure.subplots(1, len(maps), squeeze=False).ravel()
    for axes, (title, values, options) in zip(panels, maps, strict=True):
        shown = axes.imshow(values, **options)
        axes.set_title(title)
        axes.set_axis_off()
        if values.ndim == 2:
            figure.colorbar(shown, ax=axes, shrink=0.8)
    return figure


def plot_curves(logs: Sequence[Path], picture: Path) -> None:
    """Draw the curves of a training run, one panel for each kind of figure.

    ``train/loss`` and ``val/loss`` share the panel ``loss``, which has a logarithmic axis.

    Args:
        logs: The ``metrics.csv`` files of Lightning's CSVLogger, one for each start of the run.
            Where a resumed run did steps again, both curves are drawn.
        picture: PNG file to write.

    Raises:
        FileNotFoundError: If a log does not exist.
        InputError: If the logs have no curve.
    """
    # Imported here: pictures of disparities need no matplotlib, and its import is slow.
    with needs_extra("plots"):
        from matplotlib.figure import Figure
        from matplotlib.ticker import LogFormatter, MaxNLocator

    families: dict[str, dict[str, list[_Curve]]] = defaultdict(lambda: defaultdict(list))
    for log in logs:
        for column, curve in _curves(log).items():
            name = column.removesuffix("_step").removesuffix("_epoch")
            family = "lr" if name.startswith("lr") else name.rsplit("/", 1)[-1]
            families[family][column].append(curve)
    if not families:
        listed = ", ".join(str(log) for log in logs)
        raise InputError(f"{listed}: no curve in it; it needs a column step and numbers beside it")
    rows = math.ceil(len(families) / 2)
    figure = Figure(figsize=(13, 2.6 * rows), layout="constrained")
    panels = figure.subplots(rows, 2, sharex=True, squeeze=False).ravel()
    for axes, (family, columns) in zip(panels, sorted(families.items()), strict=False):
        for index, (column, starts) in enumerate(sorted(columns.items())):
            for start, (steps, values) in enumerate(starts):
                marker = "." if len(values) < 30 else ""
                label = None if start else column
                axes.plot(steps, values, f"C{index}", label=label, linewidth=1, marker=marker)
        axes.set_ylabel(family)
        if "loss" in family and all(y > 0 for line in axes.lines for y in line.get_ydata()):
            axes.set_yscale("log")
            axes.yaxis.set_major_formatter(LogFormatter())
            axes.yaxis.set_minor_formatter(LogFormatter())
        axes.set_xlabel("step")
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        axes.tick_params(labelbottom=True)
        axes.grid(alpha=0.3)
        axes.legend(fontsize="small")
    for axes in panels[len(families) :]:
        axes.remove()
    write_atomically(picture, lambda path: figure.savefig(path, format="png", dpi=120))


def _curves(log: Path) -> dict[str, _Curve]:
    """Columns of a CSV log that hold numbers: each one's steps and values.

    The logger writes a row per event and leaves the other columns empty.
    """
    if not log.is_file():  # a pipe would wait for ever
        raise InputError(f"{log}: not a file")
    curves: dict[str, _Curve] = defaultdict(lambda: ([], []))
    rows = csv.DictReader(StringIO(decode(log.read_bytes(), str(log)), newline=""))
    try:
        if len(rows.fieldnames or ()) > _MAX_COLUMNS:
            raise InputError(f"{log}: more than {_MAX_COLUMNS} columns are no log of a run")
        for row in rows:
            step = row.pop("step", None)
            for column, cell in row.items():
                if step and cell and column and column != "epoch":
                    at, value = _number(log, "step", step), _number(log, column, cell)
                    steps, values = curves[column.replace("$", r"\$")]  # no mathematics
                    steps.append(at)
                    values.append(value)
    except csv.Error as error:
        raise InputError(f"{log}: not a CSV log: {error}") from None
    return curves


def _number(log: Path, column: str, cell: str) -> float:
    try:
        return float(cell)
    except ValueError:
        raise InputError(f"{log}: {column} holds {shorten(repr(cell))}, no number") from None


def _array(values: MapLike) -> NDArray[Any]:
    return values.detach().cpu().numpy() if isinstance(values, Tensor) else values
