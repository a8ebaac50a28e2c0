"""Accuracy and time of every embedded network and of StereoSGBM, over all and over visible pixels.

    python benchmarks/accuracy.py [ROW ...] [--root DIR] [--scenes 100] [--weights FILE ...]
        [--precision bf16] [--repeats 3] [--csv FILE] [--json FILE] [--picture FILE]

A row is a name or a weights file, then settings of the matcher after commas: "msnet2d",
"msnet2d,refine=false", "run/weights.safetensors,precision=fp32"; or settings alone. Without rows:
`default_rows`.

scikit-image's Motorcycle and procedural scenes need nothing; ``--root`` holds any of the public
data sets, each in a folder of its name and in the layout in which it ships (kitti2015, sceneflow,
middeval3, eth3d, middlebury2003, middlebury2005, ...). ``--csv`` writes one line per row and pair,
which `pareto.py` draws. The picture shows the Motorcycle and the first procedural scenes, all rows
side by side.

Times: the rows take turns on every pair, so that a load on the machine meets them alike, and each
is compared with the first row on the same pair. The seconds shown are the median of these ratios
times the first row's seconds. Procedural scenes are not timed.
"""

from __future__ import annotations

import argparse
import statistics
import warnings
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from rich.console import Console
from rich.table import Table

from mobilestereonet.data import data_sets, open_data_set, write_png
from mobilestereonet.data.images import Picture, to_picture
from mobilestereonet.data.motorcycle import motorcycle
from mobilestereonet.data.sample import StereoSample, collate
from mobilestereonet.evaluation import evaluate
from mobilestereonet.evaluation.matching import timed_match
from mobilestereonet.evaluation.report import write_json, write_rows
from mobilestereonet.inference import StereoMatcher
from mobilestereonet.plots import colour_disparity, side_by_side
from mobilestereonet.scenes import ProceduralScenes, SceneConfig
from mobilestereonet.settings import parse_assignments
from mobilestereonet.weights import embedded_models

Records = list[dict[str, Any]]
"""One record per row and pair: the columns of `Evaluation.pair_rows`."""

COLUMNS = {
    "EPE\nall": "epe_all",
    "EPE\nnoc": "epe_noc",
    "bad-1\nall": "bad1_all",
    "bad-1\nnoc": "bad1_noc",
    "bad-2\nall": "bad2_all",
    "bad-2\nnoc": "bad2_noc",
    "D1\nall": "d1_all",
    "D1\nnoc": "d1_noc",
}
"""Titles of the tables' columns, and the records' columns below them."""

SYNTHETIC = ("sceneflow", "sintel", "vkitti2", "procedural")
OPTIONS = {"sceneflow": {"split": "test", "render": "cleanpass"}}
"""Options of the scanners where their defaults do not fit."""

PICTURE_WIDTH = 300
"""Width of a panel, in px."""

SCENE_SEED = 2_000_003
"""Seed of the procedural scenes: neither training nor validation during training uses it."""


def real_and_synthetic(root: Path | None) -> Iterable[tuple[str, Iterable[StereoSample]]]:
    """Every data set that lies under ``root``, after the Motorcycle that is always there."""
    yield "skimage", [replace(motorcycle(), name="motorcycle")]
    for name in data_sets() if root else ():
        folder = root / name
        if folder.is_dir():
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # partial copies are welcome here
                yield name, open_data_set(name, folder, **OPTIONS.get(name, {}))


def scenes(count: int) -> Iterable[StereoSample]:
    """Procedural scenes at full range, of all kinds."""
    return ProceduralScenes(SceneConfig(seed=SCENE_SEED, length=count))


def default_rows() -> list[str]:
    """Rows that are measured if none is named: the first one is what times are compared with."""
    # The ladder of quality levels belongs here, as f"quality={level}": a row of settings alone.
    return [*embedded_models(), "sgbm"]


def open_row(row: str, precision: str) -> tuple[str, StereoMatcher]:
    """Name of a row, and its matcher: `StereoMatcher.from_pretrained` with the row's settings.

    A file is named without its folder and ending.
    """
    parts = row.split(",")
    settings = parse_assignments([part for part in parts if "=" in part])
    source = next((part for part in parts if "=" not in part), "")
    if source:
        settings["source"] = source
    if source != "sgbm":
        settings.setdefault("precision", precision)
    name = row.replace(source, Path(source).stem) if Path(source).is_file() else row
    return name, StereoMatcher.from_pretrained(**settings)


def matchers(
    weights: Iterable[Path], precision: str = "fp32", rows: Sequence[str] = ()
) -> dict[str, StereoMatcher]:
    """Matchers of the rows, or of `default_rows`, and of further weights files, by their names."""
    found: dict[str, StereoMatcher] = {}
    for row in [*(rows or default_rows()), *map(str, weights)]:
        name, matcher = open_row(row, precision)
        if name in found:
            raise SystemExit(f"{row}: {name} is the name of another row: rename the file")
        found[name] = matcher
    return found


def measure(
    sets: Iterable[tuple[str, Iterable[StereoSample]]],
    models: dict[str, StereoMatcher],
    repeats: int,
) -> Records:
    """Score every matcher on every pair, and time it where the set is not procedural."""
    records = []
    for name, samples in sets:
        for sample in samples:
            own = {}
            for model, matcher in models.items():
                result = evaluate(matcher.disparity, [sample], model=model, data_name=name)
                (own[model],) = result.pair_rows()
            rounds = range(0 if name == "procedural" else repeats)
            seconds = [
                {model: timed(matcher, sample) for model, matcher in models.items()} for _ in rounds
            ]
            for model, record in own.items():
                times = [found[model] for found in seconds]
                records.append(record | {"seconds": statistics.median(times) if times else None})
    return records


def timed(matcher: StereoMatcher, sample: StereoSample) -> float:
    """Seconds of one call."""
    return timed_match(matcher.disparity, collate([sample]))[1]


def picture(samples: Iterable[StereoSample], models: dict[str, StereoMatcher]) -> Picture:
    """One row per pair: left view, ground truth, and the disparity of every model."""
    rows = []
    for sample in samples:
        nearest = float(sample.disparity.max())
        panels = {
            "left": to_picture(sample.left),
            "ground truth": colour_disparity(sample.disparity, nearest, sample.valid),
        }
        for name, matcher in models.items():
            (disparity,) = matcher.disparity(sample.left[None], sample.right[None])
            panels[name] = colour_disparity(disparity, nearest)
        height, width = sample.left.shape[-2:]
        size = PICTURE_WIDTH, round(PICTURE_WIDTH * height / width)
        small = [cv2.resize(panel, size, interpolation=cv2.INTER_AREA) for panel in panels.values()]
        rows.append(side_by_side(small, list(panels)))
    return np.concatenate(rows)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("rows", nargs="*", metavar="ROW", help="name or file[,setting=value ...]")
    parser.add_argument("--root", type=Path, help="folder of the data sets' folders")
    parser.add_argument("--scenes", type=int, default=100, help="procedural scenes")
    parser.add_argument("--weights", type=Path, nargs="*", default=[], help="further weights files")
    parser.add_argument("--precision", default="fp32", help="the networks': fp32, bf16, auto")
    parser.add_argument("--repeats", type=int, default=3, help="timed calls per row and pair")
    parser.add_argument("--picture", type=Path, help="file for a picture (.png)")
    parser.add_argument("--csv", type=Path, help="file for the figures, one line per row and pair")
    parser.add_argument("--json", type=Path, help="file for the same figures")
    arguments = parser.parse_args()

    sets = list(real_and_synthetic(arguments.root))
    if arguments.scenes:
        sets.append(("procedural", scenes(arguments.scenes)))
    found = matchers(arguments.weights, arguments.precision, arguments.rows)
    if arguments.picture:
        write_png(arguments.picture, picture([motorcycle(), *scenes(3)], found))
    records = measure(sets, found, arguments.repeats)
    console = Console(width=120)
    console.print(pair_table(records, arguments.precision))
    console.print(summary_table(records))
    if arguments.csv:
        write_rows(records, arguments.csv)
    if arguments.json:
        write_json(records, arguments.json)


def pair_table(records: Records, precision: str) -> Table:
    """One line per pair and row; procedural scenes are one pair, with their means."""
    title = f"Networks in {precision}; EPE in px, the others in %; noc: non-occluded pixels"
    result = Table("pair", "row", title=title)
    for title in (*COLUMNS, "seconds"):
        result.add_column(title, justify="right")
    groups: dict[str, dict[str, Records]] = {}
    for record in records:
        scenes = record["data"] == "procedural"
        pair = "procedural scenes" if scenes else f"{record['data']} {record['pair']}"
        groups.setdefault(pair, {}).setdefault(record["model"], []).append(record)
    for pair, models in groups.items():
        for model, own in models.items():
            cells = [cell(mean(own, column)) for column in (*COLUMNS.values(), "seconds")]
            result.add_row(pair, model, *cells)
        result.add_section()
    return result


def summary_table(records: Records) -> Table:
    """One line per row: figures over the real pairs, their medians and means."""
    real = [record for record in records if record["data"] not in SYNTHETIC]
    by_model = rows_of(real)
    own = next(iter(by_model.values()))
    visible = sum(record["d1_noc"] is not None for record in own)
    title = f"Over {len(own)} real pairs; noc: over the {visible} whose occlusion is known"
    result = Table("row", "", title=title)
    for column in (*COLUMNS, "seconds", f"times {next(iter(by_model))}"):
        result.add_column(column, justify="right")
    for model, (seconds, ratio) in times(real).items():
        own = by_model[model]
        for name, over in (("median", median), ("mean", mean)):
            figures = [cell(over(own, column)) for column in COLUMNS.values()]
            shown = [cell(seconds), cell(ratio)] if over is median else []
            result.add_row(model if shown else "", name, *figures, *shown)
        result.add_section()
    return result


def rows_of(records: Records) -> dict[str, Records]:
    """Records by their row."""
    found: dict[str, Records] = {}
    for record in records:
        found.setdefault(record["model"], []).append(record)
    return found


def times(records: Records) -> dict[str, tuple[float | None, float | None]]:
    """Seconds per pair of each row, and how many times the first row's; None where not timed."""
    by_model = rows_of(records)
    first = next(iter(by_model.values()))
    if any(record["seconds"] is None for record in records):
        return dict.fromkeys(by_model, (None, None))
    seconds = statistics.median(record["seconds"] for record in first)
    return {
        model: (seconds * ratio, ratio)
        for model, own in by_model.items()
        for ratio in [
            statistics.median(a["seconds"] / b["seconds"] for a, b in zip(own, first, strict=True))
        ]
    }


def mean(records: Records, column: str) -> float | None:
    """Mean of what is known of a column."""
    known = [record[column] for record in records if record[column] is not None]
    return statistics.mean(known) if known else None


def median(records: Records, column: str) -> float | None:
    """Median of what is known of a column."""
    known = [record[column] for record in records if record[column] is not None]
    return statistics.median(known) if known else None


def cell(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f}"


if __name__ == "__main__":
    main()
