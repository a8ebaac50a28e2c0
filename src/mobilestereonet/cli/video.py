"""``msnet video``."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import asdict, replace
from pathlib import Path
from threading import Event
from typing import TYPE_CHECKING, Annotated

import typer

from mobilestereonet.cli.calibration import CalibrationOptions
from mobilestereonet.cli.early import VIDEO_ENDINGS, ends_in
from mobilestereonet.cli.engine import MatcherOptions
from mobilestereonet.cli.filters import FilterOptions
from mobilestereonet.cli.options import PairBy
from mobilestereonet.cli.sinks import SinkOptions, TopicOptions
from mobilestereonet.cli.views import ViewFlags
from mobilestereonet.errors import InputError

if TYPE_CHECKING:
    from mobilestereonet.inference import StereoMatcher
    from mobilestereonet.streams import Stream


def video(
    left: Annotated[
        str,
        typer.Argument(
            help="Side-by-side video, or the left view's: a file; a camera's number, device or "
            "address; a folder or a pattern of images. A bag: .mcap, .bag, .db3 or its folder. "
            "realsense: or oak:."
        ),
    ],
    right: Annotated[str | None, typer.Argument(help="The right view's, likewise.")] = None,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            help="Video of colours to write: .mp4, .mkv or .mov.",
            callback=ends_in(VIDEO_ENDINGS, "videos are"),
        ),
    ] = None,
    frames: Annotated[
        Path | None,
        typer.Option(
            help="Folder for each frame's disparity (16-bit PNG, x 256) and, with a calibration, "
            "depth (16-bit PNG, mm)."
        ),
    ] = None,
    resume: Annotated[
        bool,
        typer.Option(
            "--resume",
            help="Keep the maps that --frames holds already, whichever network they are of.",
        ),
    ] = False,
    beside: Annotated[
        bool, typer.Option("--beside", help="Show the left view beside the colours.")
    ] = False,
    fps: Annotated[
        float, typer.Option(min=0.01, help="Frames per second of an image sequence.")
    ] = 10.0,
    hz: Annotated[
        float | None,
        typer.Option(
            "--hz",
            min=0.01,
            help="Frames per second to keep up with: chooses the quality, and a smaller size if "
            "need be, by a measurement on the first frame.",
        ),
    ] = None,
    *,
    pair_by: PairBy = None,
    views: ViewFlags,
    topics: TopicOptions,
    sinks: SinkOptions,
    options: MatcherOptions,
    filters: FilterOptions,
    cameras: CalibrationOptions,
) -> None:
    """Match a video, a camera, a bag or an image sequence. Ctrl-C ends it; what there is stays."""
    if output is None and frames is None and not sinks.given:
        raise InputError("nothing to write: give --output VIDEO, --frames FOLDER, --bag or --rerun")
    if output is None and beside:
        raise InputError("--beside needs --output VIDEO, whose pictures it widens")
    if frames is None and resume:
        raise InputError("--resume needs --frames FOLDER, where the frames' maps are kept")
    if frames is None and not sinks.given and cameras.given and not cameras.rig:
        raise InputError("depth needs --frames FOLDER, --bag or --rerun: a video does not show it")
    filters.require(frames is not None or bool(sinks.given))
    if resume and (filters.min_confidence > 0 or filters.left_right):
        raise InputError(
            "--resume takes disparities from files, which have no confidence and no right view: "
            "leave out --min-confidence and --left-right, or start anew"
        )
    if hz is not None and (options.quality or options.scale or not options.is_default):
        raise InputError(
            f"--hz {hz:g} chooses the network: leave out --quality, --model, --weights and --scale"
        )

    import time

    from mobilestereonet.atomic import check_outputs, make_folder, note_inputs
    from mobilestereonet.cli.progress import progress_bar, report_skipped
    from mobilestereonet.interruption import sigint_sets_event
    from mobilestereonet.streams import (
        MapFiles,
        StereoFrame,
        look_at_stream,
        match_video,
        open_stream,
    )
    from mobilestereonet.streams.video_files import check_video_file

    if cameras.known:
        raise InputError("--known is for `msnet predict`, which prints --focal and --baseline")
    rectifier = cameras.read()
    if output is not None:
        check_video_file(output)
    note_inputs(*(source.removeprefix("file://") for source in (left, right or left)))
    check_outputs(*([] if output is None else [output]), *sinks.files)
    stream = open_stream(left, right, fps, pair_by=pair_by, **asdict(topics))
    findings, stream = look_at_stream(stream, views.views, rectifier, shift=options.shift)
    deep = rectifier is not None or stream.calibration is not None
    views.report(findings, metric=deep and (frames is not None or bool(sinks.given)))
    if hz is None:
        matcher = filters.open_matcher(options)
    else:
        matcher, stream = _matcher_for_rate(hz, stream, options, filters)
    kinds = ("disparity.png", "depth.png") if deep else ("disparity.png",)
    for folder in (frames, output and output.parent):
        if folder is not None:
            make_folder(folder)
    started = time.perf_counter()
    stop = Event()
    with ExitStack() as stack, progress_bar("frames") as progress, sigint_sets_event(stop):
        task = progress.add_task("matching", total=stream.total)

        def report(frame: StereoFrame) -> None:
            progress.advance(task)
            if frame.problem:
                report_skipped(progress, f"frame {frame.name}", frame.problem)

        stats = match_video(
            stream,
            matcher,
            video=output,
            frames=None if frames is None else MapFiles(frames, kinds),
            sinks=sinks.open(stack, matcher, stream.topics),
            resume=resume,
            beside=beside,
            stop=stop,
            report=report,
        )
    rate = stats.matched / (time.perf_counter() - started)
    written = " and ".join(str(path) for path in (output, *sinks.given, frames) if path)
    print(f"{written}: {stats.matched} frames, {rate:.2f} per second, {matcher.summary}")
    if stats.broken:
        print(f"{stats.broken} broken frame{'s' * (stats.broken > 1)} skipped")
    if stats.dropped:
        print(f"{stats.dropped} frames of the camera dropped: it is faster than matching")
    if stop.is_set():
        print("stopped" + ("" if stream.live or frames is None else "; --resume goes on from here"))


def _matcher_for_rate(
    hz: float, stream: Stream, options: MatcherOptions, filters: FilterOptions
) -> tuple[StereoMatcher, Stream]:
    """The best quality level that keeps up with a rate, which it says, and the whole stream."""
    from mobilestereonet.inference.rate import choose_quality
    from mobilestereonet.streams.stream import first_pair

    frame, stream = first_pair(stream)
    if frame is None or frame.pair is None:
        raise InputError(f"no frame can be read: {frame.problem if frame else 'there is none'}")
    pair = frame.pair

    def open_level(name: str, scale: float | None) -> StereoMatcher:
        return filters.open_matcher(replace(options, quality=name), scale=scale)

    matcher, seconds = choose_quality(pair, hz, open_level)
    slow = "" if seconds <= 1 / hz else f", the fastest here: too slow for {hz:g}"
    print(f"{matcher.summary}: {1 / seconds:.1f} frames per second{slow}", flush=True)
    return matcher, stream
