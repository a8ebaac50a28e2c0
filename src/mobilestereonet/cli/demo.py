"""``msnet demo``."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from mobilestereonet.cli.engine import MatcherOptions

if TYPE_CHECKING:
    from mobilestereonet.data.images import Picture
    from mobilestereonet.inference import StereoPair

_FASTER = "fast"

_VIDEO_FRAMES, _VIDEO_HZ = 40, 10
_VIDEO_SIZE = 480, 352
"""Width and height of the video's views, in px."""


def demo(
    output: Annotated[Path, typer.Option("--output", "-o", help="Folder to write to.")] = Path(
        "demo"
    ),
    video: Annotated[
        bool,
        typer.Option(
            "--video",
            help="Write side_by_side.mp4, too, and side_by_side.txt, its calibration: both views "
            "of a camera that pans over the pair.",
        ),
    ] = False,
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
    films = [output / f"side_by_side.{ending}" for ending in ("mp4", "txt")] if video else []
    if video:
        from mobilestereonet.streams.video_files import check_video_file, write_video

        check_video_file(films[0])
    maps = [output / f"{sample.name}_{name}" for name in MAP_FILES.values()]
    check_outputs(*paths, *films, *maps)
    if not any(path.exists() for path in maps):  # then they are of no earlier demo
        for path in filter(Path.exists, (*paths, *films)):
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
    if video:
        write_video(films[0], _panned(pair))
        # Of all that a crop changes nothing but the principal points, which depth does not need.
        write_calibration(
            films[1], replace(CALIBRATION, cx=None, cy=None, size=_VIDEO_SIZE), _VIDEO_SIZE
        )

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
    if video:
        print(f"Video and its calibration {', '.join(map(str, films))}")


def _panned(pair: StereoPair) -> Iterator[tuple[float, Picture]]:
    """Time in s and both views beside each other of each frame: a window goes round in the pair."""
    import numpy as np

    width, height = _VIDEO_SIZE
    for index in range(_VIDEO_FRAMES):
        turn = 2 * np.pi * index / _VIDEO_FRAMES
        x = round((pair.width - width) * (1 - np.cos(turn)) / 2)
        y = round((pair.height - height) * (1 - np.sin(turn)) / 2)
        views = (
            view[y : y + height, x : x + width] for view in (pair.left_image, pair.right_image)
        )
        yield index / _VIDEO_HZ, np.hstack(list(views))
