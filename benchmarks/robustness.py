"""How much D1 suffers when pairs get worse: noise, blur, low light, JPEG and others.

    python benchmarks/robustness.py [--root DIR] [--weights FILE ...] [--precision bf16]
        [--json FILE]

StereoSGBM and every embedded network on the real pairs of `accuracy.py`, as they are and corrupted.
The median over the pairs counts. Noise has a fixed seed, so that everyone gets the same views.
"""

from __future__ import annotations

import argparse
import json
import statistics
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import torch
import torch.nn.functional as F
from rich.console import Console
from rich.table import Table
from torch import Tensor

from accuracy import SYNTHETIC, matchers, real_and_synthetic
from mobilestereonet.data.images import to_picture
from mobilestereonet.data.sample import StereoSample
from mobilestereonet.evaluation import evaluate

SEED = 20_261_123


def of_pictures(change: Callable[[np.ndarray], np.ndarray]) -> Callable[..., StereoSample]:
    """Spoil both views alike, as 8-bit pictures (H, W, 3)."""
    return lambda sample: with_views(
        sample, *(change(to_picture(view)) for view in (sample.left, sample.right))
    )


def of_right(change: Callable[[Tensor], Tensor]) -> Callable[..., StereoSample]:
    """Spoil the right view, (3, H, W) in 0..1, alone."""
    return lambda sample: with_views(
        sample, to_picture(sample.left), to_picture(change(sample.right).clamp(0, 1))
    )


def with_views(sample: StereoSample, *pictures: np.ndarray) -> StereoSample:
    left, right = (torch.from_numpy(p.copy()).permute(2, 0, 1).float() / 255 for p in pictures)
    return replace(sample, left=left, right=right)


def noisy(sample: StereoSample) -> StereoSample:
    generator = torch.Generator().manual_seed(SEED)
    views = [
        view + 10 / 255 * torch.randn(view.shape, generator=generator)
        for view in (sample.left, sample.right)
    ]
    return with_views(sample, *(to_picture(view.clamp(0, 1)) for view in views))


def jpeg(picture: np.ndarray) -> np.ndarray:
    _, data = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, 30])
    return cv2.imdecode(data, cv2.IMREAD_COLOR)


def low_light(sample: StereoSample) -> StereoSample:
    """A tenth of the light, its photon and read noise, then made bright again."""
    generator = torch.Generator().manual_seed(SEED)
    electrons = 1000 * 0.1
    views = []
    for view in (sample.left, sample.right):
        caught = torch.poisson(view**2.2 * electrons, generator=generator)
        caught += 2 * torch.randn(view.shape, generator=generator)
        views.append((caught / electrons).clamp(0, 1) ** (1 / 2.2))
    return with_views(sample, *map(to_picture, views))


def grey(picture: np.ndarray) -> np.ndarray:
    return cv2.cvtColor(cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY), cv2.COLOR_GRAY2RGB)


def half_size(sample: StereoSample) -> StereoSample:
    """Views and ground truth at half the size; the disparity halves."""
    height, width = (side // 2 for side in sample.left.shape[-2:])
    left, right = (
        F.interpolate(view[None], (height, width), mode="area")[0]
        for view in (sample.left, sample.right)
    )
    disparity, valid = (
        map_[1 : 2 * height : 2, 1 : 2 * width : 2] for map_ in (sample.disparity, sample.valid)
    )
    return StereoSample(left, right, disparity / 2, valid, name=sample.name)


CONDITIONS: dict[str, Callable[[StereoSample], StereoSample]] = {
    "as it is": lambda sample: sample,
    "noise, 10 of 255": noisy,
    "blur, 1.5 px": of_pictures(lambda picture: cv2.GaussianBlur(picture, (0, 0), 1.5)),
    "low light": low_light,
    "JPEG, quality 30": of_pictures(jpeg),
    "right view twice as bright": of_right(lambda view: (view**2.2 * 2).clamp(0, 1) ** (1 / 2.2)),
    "right view 1 px lower": of_right(lambda view: torch.cat((view[:, :1], view[:, :-1]), dim=1)),
    "grey": of_pictures(grey),
    "half size": half_size,
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--root", type=Path, help="folder of the data sets' folders")
    parser.add_argument("--weights", type=Path, nargs="*", default=[], help="further weights files")
    parser.add_argument("--precision", default="fp32", help="what the networks compute in")
    parser.add_argument("--json", type=Path, help="file for the figures")
    arguments = parser.parse_args()
    sets = real_and_synthetic(arguments.root)
    pairs = [pair for name, pairs in sets if name not in SYNTHETIC for pair in pairs]

    all_matchers = matchers(arguments.weights, arguments.precision)
    figures = {
        condition: {
            model: [score(matcher, spoil(pair)) for pair in pairs]
            for model, matcher in all_matchers.items()
        }
        for condition, spoil in CONDITIONS.items()
    }
    models = list(figures["as it is"])
    table = Table("condition", *models, title=f"Median D1 in % over {len(pairs)} real pairs")
    for condition, found in figures.items():
        table.add_row(condition, *(f"{statistics.median(found[model]):.2f}" for model in models))
    Console(width=100).print(table)
    if arguments.json:
        arguments.json.write_text(json.dumps(figures, indent=2) + "\n")


def score(matcher, pair: StereoSample) -> float:
    result = evaluate(matcher.disparity, [pair], model=matcher.model, data_name=pair.name)
    return result.scores.masks["all"].per_image["d1"]


if __name__ == "__main__":
    main()
