"""``msnet batch``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from mobilestereonet.atomic import unused_path
from mobilestereonet.cli.calibration import WAYS_TO_METRES, CalibrationOptions
from mobilestereonet.cli.early import MAP_KINDS, one_of
from mobilestereonet.cli.engine import MatcherOptions
from mobilestereonet.cli.filters import FilterOptions
from mobilestereonet.cli.options import PairBy
from mobilestereonet.cli.sinks import SinkOptions
from mobilestereonet.cli.views import ViewFlags
from mobilestereonet.errors import InputError


def batch(
    left: Annotated[
        str,
        typer.Argument(
            help="Folder or pattern of left views; alone, of side-by-side or MPO pictures, or the "
            "folder of KITTI's odometry, SemanticKITTI (sequences/00/image_2 ...) or KITTI-360 "
            "(data_2d_raw ...)."
        ),
    ],
    right: Annotated[str | None, typer.Argument(help="The right views, likewise.")] = None,
    *,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            help="Folder to write to. Default: maps, numbered if that is there.",
            show_default=False,
        ),
    ] = None,
    write: Annotated[
        list[str] | None,
        typer.Option(
            help="Map to write: disparity.png (the default; 16 bit, x 256), .pfm or .npy; "
            "depth.png (16-bit mm), .npy or .tiff (m); points.bin, as KITTI's laser scanner has "
            "them; picture.png. Repeat for more.",
            callback=one_of(MAP_KINDS),
        ),
    ] = None,
    skip_existing: Annotated[
        bool, typer.Option("--skip-existing", help="Keep the pairs that have all their maps.")
    ] = False,
    ray: Annotated[
        str | None,
        typer.Option(
            metavar="ADDRESS",
            help="Match on a Ray cluster: its address, or local for one on this machine. What is "
            "finished is kept always.",
        ),
    ] = None,
    workers: Annotated[
        int, typer.Option(metavar="<n>", min=1, help="Processes on the cluster.")
    ] = 2,
    gpus: Annotated[float, typer.Option(metavar="<n>", min=0, help="GPUs of each of them.")] = 0,
    pair_by: PairBy = None,
    views: ViewFlags,
    sinks: SinkOptions,
    options: MatcherOptions,
    filters: FilterOptions,
    cameras: CalibrationOptions,
) -> None:
    """Match folders of pairs.

    --skip-existing goes on where it was stopped. Exit code 1: some pairs could not be matched.
    """
    if output is None:
        if skip_existing:
            raise InputError("--skip-existing needs --output FOLDER, which has the maps to keep")
        output = unused_path(Path("maps"))

    import sys
    from contextlib import ExitStack
    from dataclasses import replace
    from functools import partial

    from mobilestereonet.atomic import check_outputs, make_folder, note_inputs
    from mobilestereonet.cli.progress import progress_bar, report_skipped
    from mobilestereonet.streams import (
        MapFiles,
        find_pairs,
        look_at_pairs,
        match_on_ray,
        match_pairs,
    )

    if ray is not None and sinks.given:
        raise InputError(
            f"{sinks.given[0]} is one file for all pairs: it is not written with --ray"
        )
    # A cluster's processes have working folders of their own.
    files = MapFiles(output.absolute(), tuple(write or ["disparity.png"]))
    filters.require(files.needs_calibration or bool(sinks.given))
    if cameras.known:
        raise InputError("--known is for `msnet predict`, which prints --focal and --baseline")
    rectifier = cameras.read()
    pairs = find_pairs(left, right, pair_by)
    for pair in pairs:
        note_inputs(*pair.files)
    check_outputs(*(path for pair in pairs for path in files.paths(pair.name)), *sinks.files)
    if files.needs_calibration and not rectifier and any(p.calibration is None for p in pairs):
        raise InputError(f"depth needs {WAYS_TO_METRES}")
    cpus = options.threads or 1
    if ray is not None and options.model != "sgbm":
        options = replace(options, threads=cpus)  # a worker shares its machine
    options = replace(options, weights=options.weights and options.weights.absolute())
    if options.model is not None and Path(options.model).exists():
        options = replace(options, model=str(Path(options.model).absolute()))
    todo = files.unfinished(pairs) if skip_existing or ray else pairs
    findings, arrangement = look_at_pairs(todo, views.views, rectifier, shift=options.shift)
    known = rectifier is not None or any(pair.calibration for pair in pairs)
    views.report(findings, metric=files.needs_calibration or (known and bool(sinks.given)))
    make_folder(output)
    summary, stack = "", ExitStack()
    if ray is None:
        matcher = filters.open_matcher(options)
        summary = f" ({matcher.summary})"
        statuses = match_pairs(
            todo, matcher, files, sinks.open(stack, matcher), rectifier, arrangement
        )
    else:
        statuses = match_on_ray(
            todo,
            files,
            partial(filters.open_matcher, options),
            rectifier=rectifier,
            address=ray,
            workers=workers,
            cpus=cpus,
            gpus=gpus,
            arrangement=arrangement,
        )
    failed = 0
    with stack, progress_bar("pairs") as progress:
        for status in progress.track(statuses, total=len(todo), description="matching"):
            if status.problem:
                failed += 1
                report_skipped(progress, status.name, status.problem)
    matched, kept = len(todo) - failed, len(pairs) - len(todo)
    print(f"{output}: {matched} pairs matched, {kept} kept, {failed} failed{summary}")
    if failed:
        sys.exit(1)
