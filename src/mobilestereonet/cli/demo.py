"""``msnet demo``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from mobilestereonet.cli.engine import Device, Model, Precision, Refine, Runtime, Threads, Weights


def demo(
    output: Annotated[Path, typer.Option("--output", "-o", help="Folder to write to.")] = Path(
        "demo"
    ),
    model: Model = None,
    weights: Weights = None,
    runtime: Runtime = "torch",
    precision: Precision = "auto",
    threads: Threads = None,
    device: Device = "auto",
    refine: Refine = None,
) -> None:
    """Match the real Motorcycle pair that scikit-image brings along, and score the result.

    The pair and its calibration are written, too, to try other commands on.
    """
    import torch

    from mobilestereonet.atomic import make_folder
    from mobilestereonet.cli.engine import engine_options
    from mobilestereonet.data.calibration import write_calibration
    from mobilestereonet.data.files import write_png
    from mobilestereonet.data.images import to_picture
    from mobilestereonet.data.motorcycle import CALIBRATION, motorcycle
    from mobilestereonet.data.sample import collate
    from mobilestereonet.inference import StereoMatcher
    from mobilestereonet.metrics import StereoMetrics

    sample = motorcycle()
    matcher = StereoMatcher.from_pretrained(
        model,
        weights=weights,
        **engine_options(model, runtime, precision, threads, device, refine),
    )
    make_folder(output)
    result = matcher(sample.left, sample.right)
    files = result.save(output, sample.name)
    pair = [output / name for name in ("left.png", "right.png", "calib.txt")]
    write_png(pair[0], to_picture(sample.left))
    write_png(pair[1], to_picture(sample.right))
    height, width = result.disparity.shape
    write_calibration(pair[2], CALIBRATION, (width, height))
    metrics = StereoMetrics()
    metrics.update(torch.from_numpy(result.disparity)[None], collate([sample]))
    scores = metrics.compute()

    print(
        "Middlebury's Motorcycle, {width}x{height}, {model} on {runtime} {precision}".format(
            **result.facts
        )
    )
    print("EPE {epe:.3f} px, D1 {d1:.2f} %, px-3 {px-3:.2f} %".format(**scores.figures()))
    print(f"over {scores.masks['all'].pixels} pixels with ground truth 0 < d < 192")
    print(f"Time {result.facts['seconds']:.2f} s, the first run's")
    print(f"Picture {files['picture']}, left view beside the disparity (blue far, red near)")
    print(f"Disparity {', '.join(str(files[kind]) for kind in ('png', 'pfm', 'npy'))}")
    print(f"Pair {', '.join(map(str, pair))}")
