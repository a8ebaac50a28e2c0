"""Accuracy of every embedded network, of the default one without refinement, and of StereoSGBM.

    python benchmarks/accuracy.py [--root DIR] [--scenes 100] [--weights FILE ...]
        [--precision bf16] [--picture FILE]

scikit-image's Motorcycle and procedural scenes need nothing; ``--root`` holds any of the public
data sets, each in a folder of its name and in the layout in which it ships (kitti2015, sceneflow,
middeval3, eth3d, middlebury2003, middlebury2005, ...). The picture shows the Motorcycle and the
first procedural scenes, all models side by side.
"""

from __future__ import annotations

import argparse
import json
import statistics
import warnings
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from rich.console import Console
from rich.table import Table

from mobilestereonet.data import data_sets, open_data_set, write_png
from mobilestereonet.data.images import Picture, to_picture
from mobilestereonet.data.motorcycle import motorcycle
from mobilestereonet.data.sample import StereoSample
from mobilestereonet.evaluation import evaluate
from mobilestereonet.inference import StereoMatcher
from mobilestereonet.plots import colour_disparity, side_by_side
from mobilestereonet.scenes import ProceduralScenes, SceneConfig
from mobilestereonet.weights import embedded_models

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


def matchers(weights: Iterable[Path], precision: str = "fp32") -> dict[str, StereoMatcher]:
    """Every embedded network, networks of weights files, and StereoSGBM, by their names."""
    found = {
        name: StereoMatcher.from_pretrained(name, precision=precision) for name in embedded_models()
    }
    for path in weights:
        if path.stem in found:
            raise SystemExit(f"{path}: {path.stem} is the name of another model: rename the file")
        found[path.stem] = StereoMatcher.from_pretrained(path, precision=precision)
    return found | {"sgbm": StereoMatcher.from_pretrained("sgbm")}


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
    parser.add_argument("--root", type=Path, help="folder of the data sets' folders")
    parser.add_argument("--scenes", type=int, default=100, help="procedural scenes")
    parser.add_argument("--weights", type=Path, nargs="*", default=[], help="further weights files")
    parser.add_argument("--precision", default="fp32", help="the networks': fp32, bf16")
    parser.add_argument("--picture", type=Path, help="file for a picture (.png)")
    parser.add_argument("--json", type=Path, help="file for the figures")
    arguments = parser.parse_args()

    sets = list(real_and_synthetic(arguments.root))
    if arguments.scenes:
        sets.append(("procedural", scenes(arguments.scenes)))

    records = []
    found = matchers(arguments.weights, arguments.precision)
    if arguments.picture:
        write_png(arguments.picture, picture([motorcycle(), *scenes(3)], found))
    found["msnet2d --no-refine"] = StereoMatcher(found["msnet2d"].engine, name="msnet2d")
    for model, matcher in found.items():
        for name, samples in sets:
            groups = [(name, samples)]
            if name != "procedural":
                groups = [(f"{name} {sample.name}", [sample]) for sample in samples]
            for title, group in groups:
                result = evaluate(matcher.disparity, group, model=model, data_name=title)
                figures = result.scores.masks["all"].per_image
                record = {"model": model, "set": name, "pair": title, **figures}
                records.append(record | {"seconds": result.seconds_per_image})
    Console(width=110).print(table(records, arguments.precision))
    for model in found:
        print(summary(model, [record for record in records if record["model"] == model]))
    if arguments.json:
        arguments.json.write_text(json.dumps(records, indent=2) + "\n")


def table(records: list[dict], precision: str) -> Table:
    title = f"Networks in {precision}; EPE in px, the others in %, time in s"
    result = Table("pair", "model", title=title)
    for column in ("EPE", "D1", "px-1", "px-2", "px-3", "seconds"):
        result.add_column(column, justify="right")
    pair = None
    for record in sorted(records, key=lambda record: record["pair"]):
        if pair not in (None, record["pair"]):
            result.add_section()
        pair = record["pair"]
        figures = [record[key] for key in ("epe", "d1", "px-1", "px-2", "px-3", "seconds")]
        result.add_row(pair, record["model"], *(f"{figure:.2f}" for figure in figures))
    return result


def summary(model: str, records: list[dict]) -> str:
    real = [r for r in records if r["set"] not in SYNTHETIC]
    return (
        f"{model}: {len(real)} real pairs, median D1 "
        f"{statistics.median(r['d1'] for r in real):.2f} %, "
        f"mean EPE {statistics.mean(r['epe'] for r in real):.2f} px"
    )


if __name__ == "__main__":
    main()
