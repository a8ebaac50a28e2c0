"""Matching of a stream: a video of coloured disparities, and the maps of its frames."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path
from threading import Event

from mobilestereonet.data.images import Picture
from mobilestereonet.errors import InputError
from mobilestereonet.inference import StereoMatcher, StereoResult
from mobilestereonet.plots import side_by_side
from mobilestereonet.streams.batch import FrameResult, Sink, match_frames
from mobilestereonet.streams.colours import SmoothedRange
from mobilestereonet.streams.maps import MapFiles
from mobilestereonet.streams.overlap import prefetch
from mobilestereonet.streams.stream import StereoFrame, Stream
from mobilestereonet.streams.video_files import write_video


@dataclass
class VideoStats:
    """Frame counts of a stream by what became of the frames.

    Attributes:
        matched: Frames that were matched, now or by an earlier run.
        broken: Frames that could not be read or matched, and were skipped.
        dropped: Frames that a live source gave while another one was being matched.
    """

    matched: int = 0
    broken: int = 0
    dropped: int = 0


def match_video(
    stream: Stream,
    matcher: StereoMatcher,
    *,
    video: Path | None = None,
    frames: MapFiles | None = None,
    sinks: Sequence[Sink] = (),
    resume: bool = False,
    beside: bool = False,
    stop: Event | None = None,
    report: Callable[[StereoFrame], None] = lambda frame: None,
) -> VideoStats:
    """Match a stream; reading, matching and writing overlap.

    Args:
        stream: The frames.
        matcher: The matcher.
        video: Video of the disparity's colours to write; it appears once it is complete.
        frames: Files of each frame's maps, if they are wanted.
        sinks: What else gets each frame with its result, such as a bag.
        resume: Take the maps that are in ``frames`` already for those of this stream and matcher;
            match the other frames only, and make what is missing of the matched ones' maps.
        beside: The video has the left view beside the colours.
        stop: Ends the stream early once it is set; the video is then a shorter one.
        report: Called for each finished frame; broken ones have a ``problem``.

    Raises:
        InputError: If no frame could be matched, or the stream and the arguments contradict each
            other.
        OSError: If a file cannot be written.
    """
    if resume and (frames is None or "disparity.png" not in frames.kinds or stream.live):
        raise InputError("to resume takes the frames' disparities as files, and no live camera")
    stats = VideoStats()
    problem = "there is none"

    def finished(results: Iterable[FrameResult]) -> Iterator[tuple[float, StereoResult]]:
        nonlocal problem
        for frame, result in results:
            calibration = frame.calibration or stream.calibration
            stats.dropped += frame.index - stats.matched - stats.broken - stats.dropped
            if result is None:
                problem = frame.problem
                stats.broken += 1
            else:
                if frames is not None:
                    before = resume and frames.matched(frame.name)
                    frames.save(frame.name, result, calibration, keep=before)
                for sink in sinks:
                    sink(frame, result, calibration)
                stats.matched += 1
                yield frame.seconds, result
            report(frame)
            if stop is not None and stop.is_set():
                return

    # What a live camera shows now is to be matched, not what was read ahead.
    source = stream.frames if stream.live else prefetch(stream.frames)
    results = prefetch(match_frames(source, matcher, frames if resume else None))
    with closing(source), closing(results):
        shown = finished(results if video is None else _one_size(results))
        # Nothing is made for a stream that gives nothing.
        first = next(shown, None)
        if first is None:
            raise InputError(f"no frame could be matched: {problem}")
        shown = chain([first], shown)
        if video is None:
            deque(shown, maxlen=0)
        else:
            write_video(video, _pictures(shown, beside))
    return stats


def _one_size(results: Iterable[FrameResult]) -> Iterator[FrameResult]:
    """Replace results of another size than the first one's, which fit into no video, by None."""
    size: tuple[int, ...] | None = None
    for frame, result in results:
        size = size or (result.disparity.shape if result is not None else None)
        if result is not None and result.disparity.shape != size:
            problem = f"height and width are {result.disparity.shape}, but the first frame's {size}"
            yield replace(frame, problem=problem), None
        else:
            yield frame, result


def _pictures(
    results: Iterable[tuple[float, StereoResult]], beside: bool
) -> Iterator[tuple[float, Picture]]:
    colours = SmoothedRange()
    for seconds, result in results:
        picture = colours.colour(seconds, result)
        yield seconds, side_by_side([result.left, picture]) if beside else picture
