"""Reports of evaluations: a table for the terminal, CSV and JSON files."""

from __future__ import annotations

import csv
import json
from collections.abc import Mapping, Sequence
from io import StringIO
from pathlib import Path
from typing import Any

from rich import box
from rich.table import Table

from mobilestereonet.atomic import write_text
from mobilestereonet.metrics import MaskScores, StereoScores

_MASK_WORDS = {
    "all": "all of them",
    "noc": "noc (not occluded)",
    "occ": "occ (occluded)",
    "fg": "fg (foreground)",
    "bg": "bg (background)",
}


def legend(scores: StereoScores) -> str:
    """What the rows and columns of `scores_table` mean, and which pixels were scored."""
    given = [_MASK_WORDS[mask] for mask in scores.listed_masks]
    text = (
        f"Pixels with ground truth 0 < d < {scores.max_disparity:g}; masks: {', '.join(given)}; a "
        "dash: the data does not know it. EPE: mean error; bad-t: share of errors above t px; D1: "
        "above 3 px and 5 %. Mean and median: over the images, of each image's own mean (mean: the "
        "paper's figure). Per pixel: mean over all pixels. GT: share of the frames' pixels that is "
        "scored. Empty: images without such a pixel. Skipped: "
    )
    if scores.min_share > 0:
        return text + (
            f"images where fewer than {100 * scores.min_share:g} % of the pixels with ground "
            "truth are in that range."
        )
    return text + "images that the authors' rule leaves out, none without it."


def scores_table(scores: StereoScores, title: str, with_legend: bool = True) -> Table:
    """Table with one column per figure, and rows of mean, median and pixel mean for each mask.

    Args:
        scores: What to show.
        title: Its title.
        with_legend: With the `legend` below it.
    """
    table = Table(
        title=title,
        caption=legend(scores) if with_legend else None,
        caption_justify="left",
        box=box.SIMPLE_HEAD,
        padding=(0, 1, 0, 0),
    )
    table.add_column("mask")
    table.add_column("")
    figures = list(scores.masks["all"].per_image)
    for name in (*map(_title, figures), "images", "pixels", "GT\n%"):
        table.add_column(name, justify="right")
    hidden = [
        name for name in ("empty", "skipped") if any(vars(m)[name] for m in scores.masks.values())
    ]
    for name in hidden:
        table.add_column(name, justify="right")
    for mask in scores.listed_masks:
        own = scores.masks.get(mask)
        if own is None:
            table.add_row(mask, *[""], *["-"] * (len(figures) + 3 + len(hidden)))
            continue
        counts = [f"{own.images:,}", f"{own.pixels:,}", _cell(own.gt_density, 1)]
        counts += [f"{vars(own)[name]:,}" for name in hidden]
        for statistic, values in _statistics(own):
            cells = [_cell(value, 3 if name == "epe" else 2) for name, value in values.items()]
            table.add_row(mask, statistic, *cells, *counts)
            mask, counts = "", []
        table.add_section()
    return table


def _statistics(scores: MaskScores) -> list[tuple[str, Mapping[str, float | None]]]:
    return [("mean", scores.per_image), ("median", scores.median), ("per pixel", scores.per_pixel)]


def _title(figure: str) -> str:
    """Figure above its unit."""
    names = {"epe": "EPE\npx", "d1": "D1\n%"}
    return names.get(figure, f"{figure.replace('bad', 'bad-')}\n%")


def _cell(value: float | None, digits: int) -> str:
    return "-" if value is None else f"{value:.{digits}f}"


def write_rows(rows: Sequence[Mapping[str, Any]], path: Path) -> None:
    """Write rows as CSV: the columns of all of them, an empty cell where a value is None.

    Args:
        rows: Their columns may differ.
        path: File to write.
    """
    text = StringIO(newline="")
    writer = csv.DictWriter(text, list(dict.fromkeys(name for row in rows for name in row)))
    writer.writeheader()
    writer.writerows(rows)
    write_text(path, text.getvalue())


def write_json(records: Sequence[Mapping[str, Any]], path: Path) -> None:
    """Write records as a JSON list."""
    write_text(path, json.dumps(records, indent=2, allow_nan=False) + "\n")
