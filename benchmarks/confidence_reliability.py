"""Is the confidence the probability that it says? Reliability of embedded networks, as JSON.

    python benchmarks/confidence_reliability.py --root DIR [--scenes 24] [--json FILE]

Counted on procedural scenes that no fit saw, and on the real pairs under ``--root`` as
`accuracy.py` finds them, with the network's own confidence and with the fitted one.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from accuracy import SYNTHETIC, real_and_synthetic
from mobilestereonet.data.sample import StereoSample
from mobilestereonet.evaluation import confidences, reliability
from mobilestereonet.inference import StereoMatcher
from mobilestereonet.nets import ConfidenceFit
from mobilestereonet.scenes import ProceduralScenes, SceneConfig
from mobilestereonet.weights import embedded_models, load_model
from mobilestereonet.weights.files import write_json

SCENE_SEED = 3_000_029
"""Seed of the scenes: `msnet fit-confidence` uses another."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--root", type=Path, help="folder of the data sets' folders")
    parser.add_argument("--scenes", type=int, default=24)
    parser.add_argument("--precision", default="bf16")
    parser.add_argument("--json", type=Path, default=Path("reliability.json"))
    arguments = parser.parse_args()

    scenes = SceneConfig(seed=SCENE_SEED, length=arguments.scenes)
    sets = {
        "procedural scenes": ProceduralScenes(scenes),
        "real pairs": real_pairs(arguments.root),
    }
    record: dict[str, Any] = {title: {} for title in sets}
    for title, samples in sets.items():
        kept = list(samples)
        for model in embedded_models():
            net = load_model(model)
            fit, net.confidence_fit = net.confidence_fit, None
            matcher = StereoMatcher(net, precision=arguments.precision, confidence=True)
            record[title][model] = reliabilities(*confidences(matcher, kept), fit)
            figures = {name: row["error"] for name, row in record[title][model].items()}
            print(f"{title}, {model}: calibration error {figures}")
    write_json(arguments.json, record)


def real_pairs(root: Path | None) -> Iterable[StereoSample]:
    """The real pairs alone, with the Motorcycle that is always there."""
    for name, samples in real_and_synthetic(root):
        if name not in SYNTHETIC:
            yield from samples


def reliabilities(
    raw: NDArray[np.float32], correct: NDArray[np.bool_], fit: ConfidenceFit
) -> dict[str, Any]:
    """Calibration error and table of the network's own confidence, and of the fitted one."""
    found = {
        "own": reliability(raw, correct),
        "fitted": reliability(fit(torch.from_numpy(raw)).numpy(), correct),
    }
    return {
        name: {"error": round(curve.error, 4), "table": curve.table()}
        for name, curve in found.items()
    }


if __name__ == "__main__":
    main()
