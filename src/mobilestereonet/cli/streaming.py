"""What the commands that match a stream share: its source, its matcher, and the loop."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from threading import Event
from typing import TYPE_CHECKING, Annotated, TypeAlias

import typer

from mobilestereonet.cli.calibration import WAYS_TO_METRES, CalibrationOptions
from mobilestereonet.cli.early import BAG_ENDINGS
from mobilestereonet.cli.engine import MatcherOptions
from mobilestereonet.cli.filters import FilterOptions
from mobilestereonet.cli.options import PairBy
from mobilestereonet.cli.sinks import SinkOptions, TopicOptions
from mobilestereonet.cli.views import ViewFlags
from mobilestereonet.errors import InputError

if TYPE_CHECKING:
    from mobilestereonet.inference import StereoMatcher
    from mobilestereonet.streams import MapFiles, Stream, VideoStats
    from mobilestereonet.streams.batch import Sink

LeftSource: TypeAlias = Annotated[
    str,
    typer.Argument(
        help="Side-by-side video, or the left view's: a file; a camera's number, device or "
        "address; a folder or a pattern of images (alone also of MPO files). A bag: .mcap, .bag, "
        ".db3 or its folder. realsense:, oak: or zed:."
    ),
]
RightSource: TypeAlias = Annotated[str | None, typer.Argument(help="The right view's, likewise.")]


@dataclass(frozen=True)
class StreamOptions:
    """Options that say how frames come, and how many are to be matched per second."""

    fps: Annotated[
        float,
        typer.Option(metavar="<hz>", min=0.01, help="Frames per second of an image sequence."),
    ] = 10.0
    hz: Annotated[
        float | None,
        typer.Option(
            "--hz",
            metavar="<hz>",
            min=0.01,
            help="Frames per second to keep up with: chooses the quality, and a smaller size if "
            "need be, by a measurement on the first frame.",
        ),
    ] = None
    pair_by: PairBy = None


@dataclass(frozen=True)
class MatchedStream:
    """A stream and what matches it.

    Attributes:
        stream: The frames, put right.
        matcher: The matcher.
        deep: Whether the frames have a calibration.
    """

    stream: Stream
    matcher: StereoMatcher
    deep: bool

    @classmethod
    def open(
        cls,
        left: str,
        right: str | None,
        *,
        source: StreamOptions,
        topics: TopicOptions,
        views: ViewFlags,
        options: MatcherOptions,
        filters: FilterOptions,
        cameras: CalibrationOptions,
        outputs: Sequence[Path],
        metric: bool,
        confidence: bool = False,
    ) -> MatchedStream:
        """Open a source and its matcher; says what the first look finds.

        Args:
            left: The source.
            right: That of the right view, if it has one of its own.
            source: How frames come.
            topics: Where a bag has its views.
            views: How the views lie.
            options: Network and engine.
            filters: Which pixels have a depth.
            cameras: Geometry of the cameras.
            outputs: All files that are going to be written.
            metric: Whether depth is asked for where there is a calibration.
            confidence: Whether results have a confidence.

        Raises:
            FileNotFoundError: If a source does not exist.
            InputError: If the options contradict each other, a file cannot be written, or the
                source or the matcher cannot be opened.
        """
        hz = source.hz
        if hz is not None and (options.quality or options.scale or not options.is_default):
            raise InputError(
                f"--hz {hz:g} chooses the network: leave out --quality, --model, --weights and "
                "--scale"
            )
        if cameras.known:
            raise InputError("--known is for `msnet predict`, which prints --focal and --baseline")

        from mobilestereonet.atomic import check_outputs, note_inputs
        from mobilestereonet.streams import look_at_stream, open_stream

        rectifier = cameras.read()
        note_inputs(*(path.removeprefix("file://") for path in (left, right or left)))
        check_outputs(*outputs)
        raw = rectifier is not None and rectifier.rectifies
        stream = open_stream(
            left,
            right,
            source.fps,
            pair_by=source.pair_by,
            rectify=not raw,
            layout=views.layout,
            **asdict(topics),
        )
        findings, stream = look_at_stream(stream, views.views, rectifier, shift=options.shift)
        deep = rectifier is not None or stream.calibration is not None
        views.report(findings, metric=deep and metric)
        if not deep:
            if filters.max_depth < float("inf"):
                raise InputError("--max-depth needs --rig FILE, or --focal and --baseline")
            if stream.topics or any(path.suffix in BAG_ENDINGS for path in outputs):
                told = "no calibration, so disparities and no depth: that needs"
                print(f"msnet: {left}: {told} {WAYS_TO_METRES}", file=sys.stderr)
        if hz is None:
            return cls(stream, filters.open_matcher(options, confidence=confidence), deep)
        matcher, stream = _matcher_for_rate(hz, stream, options, filters)
        matcher.confidence |= confidence
        return cls(stream, matcher, deep)

    def open_sinks(self, sinks: SinkOptions, stack: ExitStack) -> list[Sink]:
        """Open what the results go to; see `SinkOptions.open`."""
        return sinks.open(stack, self.matcher, self.stream.topics, self.stream.camera_infos)

    def run(
        self,
        stop: Event,
        sinks: Sequence[Sink],
        *,
        video: Path | None = None,
        frames: MapFiles | None = None,
        resume: bool = False,
        beside: bool = False,
    ) -> str:
        """Match the frames; Ctrl-C ends it. Gives frames, rate and matcher in words.

        Args:
            stop: Ends it early once it is set.
            sinks: Each gets the results.
            video: See `match_video`, and so for those that follow.
            frames: Likewise.
            resume: Likewise.
            beside: Likewise.
        """
        import time

        from mobilestereonet.cli.progress import progress_bar, report_skipped
        from mobilestereonet.interruption import sigint_sets_event
        from mobilestereonet.streams import StereoFrame, match_video

        started = time.perf_counter()
        with progress_bar("frames") as progress, sigint_sets_event(stop):
            task = progress.add_task("matching", total=self.stream.total)

            def report(frame: StereoFrame) -> None:
                progress.advance(task)
                if frame.problem:
                    report_skipped(progress, f"frame {frame.name}", frame.problem)

            stats = match_video(
                self.stream,
                self.matcher,
                video=video,
                frames=frames,
                sinks=sinks,
                resume=resume,
                beside=beside,
                stop=stop,
                report=report,
            )
        rate = stats.matched / (time.perf_counter() - started)
        frames_told = f"{stats.matched} frames, {rate:.2f} per second, {self.matcher.summary}"
        return "\n".join([frames_told, *_losses(stats)])


def _losses(stats: VideoStats) -> list[str]:
    told = []
    if stats.broken:
        told.append(f"{stats.broken} broken frame{'s' * (stats.broken > 1)} skipped")
    if stats.dropped:
        told.append(f"{stats.dropped} frames dropped: they come faster than they are matched")
    return told


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
