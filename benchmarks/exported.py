"""How exported files change the accuracy of a network, on the pairs of `accuracy.py`.

    python benchmarks/exported.py FILE [FILE ...] [--root DIR] [--weights FILE]

Each file, of any size, is run in its own runtime; torch in fp32 is what it is compared with.
"""

from __future__ import annotations

import argparse
import statistics
from pathlib import Path

import torch
from torch import Tensor

from accuracy import real_and_synthetic
from mobilestereonet.evaluation import evaluate
from mobilestereonet.export import FORMATS
from mobilestereonet.inference import StereoMatcher
from mobilestereonet.nets import SIZE_MULTIPLE
from mobilestereonet.nets.normalise import IMAGENET_MEAN, IMAGENET_STD


class File:
    """An exported file as an engine. Takes normalised views, so that padding is the mean colour."""

    normalised = True
    multiple = SIZE_MULTIPLE

    def __init__(self, path: Path) -> None:
        self.name = path.name
        self.run = next(f for f in FORMATS.values() if f.ending == path.suffix).open(path)

    def __call__(self, left: Tensor, right: Tensor) -> Tensor:
        mean, std = (
            torch.tensor(values)[:, None, None] for values in (IMAGENET_MEAN, IMAGENET_STD)
        )
        return self.run(left * std + mean, right * std + mean)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("files", type=Path, nargs="+", help="exported files of any size")
    parser.add_argument("--root", type=Path, help="folder of the data sets' folders")
    parser.add_argument("--weights", type=Path, help="weights of the files; default: msnet2d's")
    arguments = parser.parse_args()

    pairs = [pair for _, pairs in real_and_synthetic(arguments.root) for pair in pairs]
    engines = {"torch": StereoMatcher.from_pretrained(weights=arguments.weights, runtime="torch")}
    engines |= {str(path): StereoMatcher(File(path)) for path in arguments.files}
    figures = {
        name: [scores(matcher, name, pair) for pair in pairs] for name, matcher in engines.items()
    }
    for name, found in figures.items():
        print(f"\n{name}: EPE in px, D1 in %; change to torch")
        changes = [
            (epe - torch_epe, d1 - torch_d1)
            for (epe, d1), (torch_epe, torch_d1) in zip(found, figures["torch"], strict=True)
        ]
        for pair, (epe, d1), change in zip(pairs, found, changes, strict=True):
            print(f"  {pair.name:24} {epe:7.3f} {d1:7.2f}   {change[0]:+.3f} {change[1]:+.2f}")
        epe, d1 = (statistics.mean(column) for column in zip(*found, strict=True))
        change = [statistics.mean(column) for column in zip(*changes, strict=True)]
        print(f"  {'mean':24} {epe:7.3f} {d1:7.2f}   {change[0]:+.3f} {change[1]:+.2f}")


def scores(matcher: StereoMatcher, name: str, pair) -> tuple[float, float]:
    result = evaluate(matcher.disparity, [pair], model=name, data_name=pair.name)
    figures = result.scores.masks["all"].per_image
    return figures["epe"], figures["d1"]


if __name__ == "__main__":
    main()
