"""Do errors stay within the standard deviation that the confidence gives? Shares of pixels.

    python benchmarks/deviation.py --model msnet2d [--root DIR] [--scenes 6]

Of the pixels with ground truth: the share whose error is within one and two standard deviations,
of all and of the most confident fifth, on procedural scenes that no fit saw and on the real pairs
under ``--root`` as `accuracy.py` finds them. A Laplace distribution has 76 and 94 % there.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from confidence_reliability import SCENE_SEED, real_pairs
from mobilestereonet.inference import StereoMatcher
from mobilestereonet.inference.deviation import disparity_deviation
from mobilestereonet.nets.model import trained_pixels
from mobilestereonet.scenes import ProceduralScenes, SceneConfig


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--model", default="msnet2d")
    parser.add_argument("--root", type=Path, help="folder of the data sets' folders")
    parser.add_argument("--scenes", type=int, default=6)
    parser.add_argument("--precision", default="bf16")
    arguments = parser.parse_args()

    matcher = StereoMatcher.from_pretrained(arguments.model, precision=arguments.precision)
    scenes = ProceduralScenes(SceneConfig(seed=SCENE_SEED, length=arguments.scenes))
    for title, samples in (("procedural", scenes), ("real", real_pairs(arguments.root))):
        errors, deviations = [], []
        for sample in samples:
            found = matcher.infer(sample.left[None], sample.right[None])
            known = trained_pixels(sample.disparity, sample.valid, matcher.max_disparity)
            errors.append((found.disparity[0] - sample.disparity)[known].abs().numpy())
            deviations.append(disparity_deviation(found.confidence[0][known].numpy()))
        error, deviation = np.concatenate(errors), np.concatenate(deviations)
        sure = deviation <= np.quantile(deviation, 0.2)
        for name, kept in (("all", np.full_like(sure, True)), ("most confident fifth", sure)):
            shares = [float(np.mean(error[kept] < times * deviation[kept])) for times in (1, 2)]
            print(
                f"{arguments.model}, {title}, {name}: {len(errors)} pairs, median deviation "
                f"{np.median(deviation[kept]):.2f} px, median error {np.median(error[kept]):.2f} "
                f"px, within one {shares[0]:.1%}, within two {shares[1]:.1%}",
                flush=True,
            )


if __name__ == "__main__":
    main()
