"""Matching of many pairs; reading, matching and writing overlap."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

from mobilestereonet.data.sample import Calibration
from mobilestereonet.errors import InputError
from mobilestereonet.inference import Rectifier, StereoMatcher, StereoResult
from mobilestereonet.inference.arrangement import AS_GIVEN, Arrangement
from mobilestereonet.streams.look import prepared
from mobilestereonet.streams.maps import MapFiles
from mobilestereonet.streams.overlap import prefetch
from mobilestereonet.streams.pairs import PairFiles, read_pairs
from mobilestereonet.streams.stream import StereoFrame

FrameResult: TypeAlias = tuple[StereoFrame, StereoResult | None]
"""A frame and its result, which is None where the frame has a ``problem``."""


Sink: TypeAlias = Callable[[StereoFrame, StereoResult, Calibration | None], object]
"""Takes each matched frame, its result and its calibration, such as `BagFile.write`."""


@dataclass(frozen=True)
class PairStatus:
    """Status of a pair after matching.

    Attributes:
        name: Name of the pair.
        problem: Why it has no map; empty if all went well.
    """

    name: str
    problem: str = ""


def match_pairs(
    pairs: Iterable[PairFiles],
    matcher: StereoMatcher,
    files: MapFiles,
    sinks: Sequence[Sink] = (),
    rectifier: Rectifier | None = None,
    arrangement: Arrangement = AS_GIVEN,
) -> Iterator[PairStatus]:
    """Match pairs and write their maps; reading, matching and writing overlap.

    Args:
        pairs: Files of their views.
        matcher: The matcher.
        files: Files of their maps.
        sinks: What else gets each pair with its result, such as a recording.
        rectifier: Rectifies all pairs, and has their calibration.
        arrangement: What puts all of them right, see `look_at_pairs`.

    Yields:
        The status of each pair, once its files are written. A pair that cannot be read or
        matched does not stop the others, nor does one whose calibration is of another size.

    Raises:
        InputError: If depth is asked for and a pair has no calibration.
        OSError: If a file cannot be written.
    """
    read = read_pairs(pairs, layout="top-bottom" if arrangement.top_bottom else None)
    frames: Iterable[StereoFrame] = prefetch(prepared(read, rectifier, arrangement))
    if files.needs_calibration:
        frames = _check_calibrations(frames)
    for frame, result in prefetch(match_frames(frames, matcher)):
        if result is not None:
            files.save(frame.name, result, frame.calibration, to_laser=frame.to_laser)
            for sink in sinks:
                sink(frame, result, frame.calibration)
        yield PairStatus(frame.name, frame.problem)


def _check_calibrations(frames: Iterable[StereoFrame]) -> Iterator[StereoFrame]:
    """Give the frames on; a calibration of another size becomes their problem."""
    for frame in frames:
        try:
            if frame.pair is not None and frame.calibration is not None:
                frame.calibration.require_size(frame.pair.width, frame.pair.height)
            yield frame
        except InputError as error:
            yield replace(frame, pair=None, problem=str(error))


def match_frames(
    frames: Iterable[StereoFrame], matcher: StereoMatcher, finished: MapFiles | None = None
) -> Iterator[FrameResult]:
    """Match the frames that could be read.

    Args:
        frames: The frames.
        matcher: The matcher.
        finished: Maps of an earlier run: frames whose disparity is there are not matched again.

    Yields:
        Each frame, also those without a result.
    """
    for frame in frames:
        if frame.pair is None:
            yield frame, None
        elif finished is not None and finished.matched(frame.name):
            yield frame, replace(finished.load(frame.name, frame.pair), filter=matcher.filter)
        else:
            try:
                yield frame, matcher.match(frame.pair)
            except InputError as error:
                yield replace(frame, pair=None, problem=str(error)), None
