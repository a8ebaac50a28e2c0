"""Visualisation: disparity colours, KITTI's error map, panels.

Every picture is an RGB array of shape (H, W, 3), uint8.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from mobilestereonet.data.images import Picture, to_picture
from mobilestereonet.data.sample import StereoSample
from mobilestereonet.errors import InputError, needs_extra

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MapLike = Tensor | NDArray[Any]

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
_NICE_DISTANCES_M = np.outer(10.0 ** np.arange(-2, 5), (1, 1.2, 1.5, 2, 2.5, 3, 4, 5, 6, 8)).ravel()
_PANEL_GAP_PX = 4
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


def depth_picture(depth: MapLike) -> Picture:
    """Colour depth as its disparity is, red near and blue far, beside a bar with marks in metres.

    Args:
        depth: (H, W) in metres, 0 where it is unknown (black).

    Returns:
        (H, W + the bar's width, 3) uint8.
    """
    metres = _array(depth).astype(np.float32)
    known = metres > 0
    inverse = np.where(known, 1 / np.where(known, metres, 1), 0)
    largest = float(np.percentile(inverse[known], 99)) if known.any() else 1.0
    height, size = len(metres), max(0.45, len(metres) / 1200)
    bar = np.full((height, round(170 * size), 3), 255, np.uint8)
    ramp = np.repeat(np.linspace(largest, 0, height)[:, None], round(30 * size), axis=1)
    bar[:, : ramp.shape[1]] = colour_disparity(ramp, largest)
    line_height, free = round(36 * size), height
    for distance in (_NICE_DISTANCES_M[1 / largest <= _NICE_DISTANCES_M])[::-1]:
        row = round((1 - 1 / (distance * largest)) * (height - 1))
        if line_height <= row <= free - line_height:
            place = ramp.shape[1] + 4, row + line_height // 4
            text = f"{distance:g} m"
            cv2.putText(bar, text, place, cv2.FONT_HERSHEY_SIMPLEX, size, (0, 0, 0), 1, cv2.LINE_AA)
            free = row
    return side_by_side([colour_disparity(inverse, largest, known), bar])


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


def _array(values: MapLike) -> NDArray[Any]:
    return values.detach().cpu().numpy() if isinstance(values, Tensor) else values
