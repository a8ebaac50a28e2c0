"""Pairs of images, one after the other."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import TypeAlias

from mobilestereonet.errors import InputError
from mobilestereonet.inference.matcher import StereoMatcher
from mobilestereonet.inference.result import StereoResult
from mobilestereonet.streams.maps import MapFiles
from mobilestereonet.streams.overlap import ahead
from mobilestereonet.streams.pairs import Pair, read_pairs
from mobilestereonet.streams.stream import StereoFrame

Matched: TypeAlias = tuple[StereoFrame, StereoResult | None]
"""A frame and its result; None, with the frame's ``problem``, where there is none."""


@dataclass(frozen=True)
class Outcome:
    """What became of a pair.

    Attributes:
        name: Its name.
        problem: Why it has no map; empty if all went well.
    """

    name: str
    problem: str = ""


def match_pairs(
    pairs: Iterable[Pair], matcher: StereoMatcher, files: MapFiles
) -> Iterator[Outcome]:
    """Match pairs and write their maps; reading, matching and writing overlap.

    Args:
        pairs: Where their views lie.
        matcher: What matches them.
        files: Where their maps go.

    Yields:
        What became of each pair, once its files are written. A pair that cannot be read or
        matched does not stop the others, nor does one whose calibration is of another size.

    Raises:
        InputError: If depth is asked for and a pair has no calibration.
        OSError: If a file cannot be written.
    """
    frames: Iterable[StereoFrame] = ahead(read_pairs(pairs))
    if files.needs_calibration:
        frames = _of_their_calibration(frames)
    for frame, result in ahead(matched(frames, matcher)):
        if result is not None:
            files.save(frame.name, result, frame.calibration)
        yield Outcome(frame.name, frame.problem)


def _of_their_calibration(frames: Iterable[StereoFrame]) -> Iterator[StereoFrame]:
    """The frames; a calibration of another size is their problem."""
    for frame in frames:
        try:
            if frame.views is not None and frame.calibration is not None:
                height, width = frame.views[0].shape[-2:]
                frame.calibration.require_size(width, height)
            yield frame
        except InputError as error:
            yield replace(frame, views=None, problem=str(error))


def matched(
    frames: Iterable[StereoFrame], matcher: StereoMatcher, finished: MapFiles | None = None
) -> Iterator[Matched]:
    """Match the frames that could be read.

    Args:
        frames: The frames.
        matcher: What matches them.
        finished: Maps of an earlier run: frames whose disparity is there are not matched again.

    Yields:
        Each frame, also those without a result.
    """
    for frame in frames:
        if frame.views is None:
            yield frame, None
        elif finished is not None and finished.matched(frame.name):
            yield frame, finished.load(frame.name, frame.views[0])
        else:
            try:
                yield frame, matcher(*frame.views)
            except InputError as error:
                yield replace(frame, views=None, problem=str(error)), None
