"""``msnet video``."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from threading import Event
from typing import Annotated

import typer

from mobilestereonet.atomic import unused_path
from mobilestereonet.cli.calibration import CalibrationOptions
from mobilestereonet.cli.early import VIDEO_ENDINGS, ends_in
from mobilestereonet.cli.engine import MatcherOptions
from mobilestereonet.cli.filters import FilterOptions
from mobilestereonet.cli.sinks import SinkOptions, TopicOptions
from mobilestereonet.cli.streaming import LeftSource, MatchedStream, RightSource, StreamOptions
from mobilestereonet.cli.views import ViewFlags
from mobilestereonet.errors import InputError


def video(
    left: LeftSource,
    right: RightSource = None,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            help="Video of colours to write: .mp4, .mkv or .mov. Default, if nothing else is asked "
            "for: disparity.mp4, numbered if that is there.",
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
            rich_help_panel="Output",
            help="Keep the maps that --frames holds already, whichever network they are of.",
        ),
    ] = False,
    beside: Annotated[
        bool, typer.Option("--beside", help="Show the left view beside the colours.")
    ] = False,
    *,
    source: StreamOptions,
    views: ViewFlags,
    topics: TopicOptions,
    sinks: SinkOptions,
    options: MatcherOptions,
    filters: FilterOptions,
    cameras: CalibrationOptions,
) -> None:
    """Match a video, a camera, a bag or an image sequence.

    Ctrl-C ends it; what there is stays.
    """
    if output is None and frames is None and not sinks.given:
        output = unused_path(Path("disparity.mp4"))
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

    from mobilestereonet.atomic import make_folder
    from mobilestereonet.streams import MapFiles
    from mobilestereonet.streams.open import refuse_stills
    from mobilestereonet.streams.video_files import check_video_file

    refuse_stills(*filter(None, (left, right)))
    if output is not None:
        check_video_file(output)
    opened = MatchedStream.open(
        left,
        right,
        source=source,
        topics=topics,
        views=views,
        options=options,
        filters=filters,
        cameras=cameras,
        outputs=[*([] if output is None else [output]), *sinks.files],
        metric=frames is not None or bool(sinks.given),
    )
    kinds = ("disparity.png", "depth.png") if opened.deep else ("disparity.png",)
    for folder in (frames, output and output.parent):
        if folder is not None:
            make_folder(folder)
    stop = Event()
    with ExitStack() as stack:
        told = opened.run(
            stop,
            opened.open_sinks(sinks, stack),
            video=output,
            frames=None if frames is None else MapFiles(frames, kinds),
            resume=resume,
            beside=beside,
        )
    written = " and ".join(str(path) for path in (output, *sinks.given, frames) if path)
    print(f"{written}: {told}")
    if stop.is_set():
        resumes = frames is not None and not opened.stream.live
        print("stopped" + ("; --resume goes on from here" if resumes else ""))
