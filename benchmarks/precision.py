"""What an engine, a precision or an exported file changes in a network's accuracy.

    python benchmarks/precision.py [ENGINE:PRECISION | FILE ...] [--root DIR]
        [--weights NAME | FILE]

Runs each on the pairs of `accuracy.py` and compares it with PyTorch in fp32. An exported file must
take any size, and runs in its own runtime. By default: all engines and precisions on the CPU.
"""

from __future__ import annotations

import argparse
import statistics
from pathlib import Path

import torch
from rich.console import Console
from rich.table import Table
from torch import Tensor

from accuracy import real_and_synthetic
from mobilestereonet.data.sample import StereoSample
from mobilestereonet.engines.choose import open_engine
from mobilestereonet.evaluation import evaluate
from mobilestereonet.export import FORMATS
from mobilestereonet.inference import StereoMatcher
from mobilestereonet.nets import StereoModel
from mobilestereonet.nets.model import RGB, Prediction
from mobilestereonet.weights import load_model

REFERENCE = "torch:fp32"
ENGINES = ("torch:bf16", "onnxruntime:fp32", "openvino:fp32", "openvino:bf16")


class File:
    """Exported file as an engine: it takes RGB and preprocesses it itself."""

    precision = "the file's"
    device = torch.device("cpu")
    threads = None
    preprocessing = RGB
    size_multiple = 32
    min_side = 1
    has_confidence = False

    def __init__(self, path: Path, max_disparity: int) -> None:
        self.name = path.name
        self.max_disparity = max_disparity
        self.run = next(f for f in FORMATS.values() if f.ending == path.suffix).open(path)

    def __call__(self, left: Tensor, right: Tensor, confidence: bool = False) -> Prediction:
        return Prediction(self.run(left, right).disparity)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("engines", nargs="*", default=ENGINES, help="engine:precision, or a file")
    parser.add_argument("--root", type=Path, help="folder of the data sets' folders")
    parser.add_argument("--weights", default="msnet2d", help="an embedded model or a file")
    parser.add_argument("--threads", type=int, default=2)
    arguments = parser.parse_args()
    torch.set_num_threads(arguments.threads)

    net = load_model(arguments.weights)
    pairs = [pair for _, pairs in real_and_synthetic(arguments.root) for pair in pairs]
    names = (REFERENCE, *arguments.engines)
    figures = {name: score(open_matcher(name, net, arguments.threads), pairs) for name in names}

    table = Table("engine", "pair", "EPE, px", "change", "D1, %", "change")
    for name, found in figures.items():
        table.add_section()
        changes = [
            tuple(a - b for a, b in zip(*both, strict=True))
            for both in zip(found, figures[REFERENCE], strict=True)
        ]
        rows = [*zip([pair.name for pair in pairs], found, changes, strict=True)]
        rows.append(("mean", mean(found), mean(changes)))
        for pair_name, (epe, d1), (epe_change, d1_change) in rows:
            table.add_row(
                name,
                pair_name,
                f"{epe:.3f}",
                f"{epe_change:+.3f}",
                f"{d1:.2f}",
                f"{d1_change:+.2f}",
            )
    Console(width=100).print(table)


def open_matcher(name: str, net: StereoModel, threads: int) -> StereoMatcher:
    if Path(name).suffix:
        return StereoMatcher(File(Path(name), net.max_disparity))
    engine, precision = name.split(":")
    return StereoMatcher(open_engine(engine, net, precision=precision, threads=threads))


def score(matcher: StereoMatcher, pairs: list[StereoSample]) -> list[tuple[float, float]]:
    """EPE in px and D1 in % of each pair."""
    found = []
    for pair in pairs:
        result = evaluate(matcher.disparity, [pair], model=matcher.model, data_name=pair.name)
        figures = result.scores.masks["all"].per_image
        found.append((figures["epe"], figures["d1"]))
    return found


def mean(columns: list[tuple[float, ...]]) -> tuple[float, ...]:
    return tuple(statistics.mean(column) for column in zip(*columns, strict=True))


if __name__ == "__main__":
    main()
