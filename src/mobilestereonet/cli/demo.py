"""``msnet demo``."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from mobilestereonet.cli.engine import MatcherOptions

_FASTER = "fast"


def demo(
    output: Annotated[Path, typer.Option("--output", "-o", help="Folder to write to.")] = Path(
        "demo"
    ),
    *,
    options: MatcherOptions,
) -> None:
    """Match a real pair that comes along, and score the result.

    It is Middlebury's Motorcycle, which scikit-image brings. The pair, its calibration and ground
    truth are written, too, to try other commands on.
    Without --model, --weights and --quality the level "fast" is timed as well.
    """
    import torch

    from mobilestereonet.atomic import check_outputs, make_folder
    from mobilestereonet.data.calibration import write_calibration
    from mobilestereonet.data.files import write_pfm, write_png
    from mobilestereonet.data.motorcycle import CALIBRATION, motorcycle
    from mobilestereonet.data.sample import collate
    from mobilestereonet.errors import InputError
    from mobilestereonet.inference import RunInfo, StereoMatcher, StereoResult, load_pair
    from mobilestereonet.inference.map_files import MAP_FILES
    from mobilestereonet.metrics import StereoMetrics, StereoScores

    sample = motorcycle()
    paths = [output / name for name in ("left.png", "right.png", "calib.txt", "truth.pfm")]
    maps = [output / f"{sample.name}_{name}" for name in MAP_FILES.values()]
    check_outputs(*paths, *maps)
    if not any(path.exists() for path in maps):  # then they are of no earlier demo
        for path in filter(Path.exists, paths):
            raise InputError(f"{path} is there already, and stays: choose another folder")
    pair = load_pair(sample.left, sample.right)
    matcher = options.open_matcher()
    make_folder(output)

    def match(matcher: StereoMatcher) -> tuple[StereoResult, RunInfo, StereoScores]:
        result = matcher.match(pair)
        assert result.info is not None  # the matcher's results have one
        metrics = StereoMetrics()
        metrics.update(torch.from_numpy(result.disparity)[None], collate([sample]))
        return result, result.info, metrics.compute()

    result, info, scores = match(matcher)
    files = result.save(output, sample.name)
    write_png(paths[0], pair.left_image)
    write_png(paths[1], pair.right_image)
    write_calibration(paths[2], CALIBRATION, (pair.width, pair.height))
    assert sample.disparity is not None and sample.valid is not None  # it has ground truth
    write_pfm(paths[3], torch.where(sample.valid, sample.disparity, torch.inf).numpy())

    print(f"Middlebury's Motorcycle, {info}")
    print("EPE {epe:.3f} px, D1 {d1:.2f} %, bad-3 {bad3:.2f} %".format(**scores.figures()))
    print(f"over {scores.masks['all'].pixels} pixels with ground truth 0 < d < 192")
    print(f"Time {info.seconds:.2f} s (first run, warm-up included)")
    if options.is_default and options.quality is None:
        _, faster, others = match(replace(options, quality=_FASTER).open_matcher())
        figures = "EPE {epe:.3f} px, D1 {d1:.2f} %".format(**others.figures())
        print(f"With --quality {_FASTER}: {faster.seconds:.2f} s, {figures}")
        if faster.seconds >= info.seconds:
            print("other programs use the cores: the times mean little; try --threads 1")
    print(f"Picture {files['picture']}, left view beside the disparity (blue far, red near)")
    print(f"Disparity {', '.join(str(files[kind]) for kind in ('png', 'pfm', 'npy'))}")
    print(f"Pair and ground truth {', '.join(map(str, paths))}")
