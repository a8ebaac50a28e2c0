"""`match_stream`: results of any source, one after the other, for a loop of the caller."""

from __future__ import annotations

import warnings
from collections.abc import Generator
from contextlib import closing
from dataclasses import replace
from typing import Any

from mobilestereonet.data.sample import Calibration
from mobilestereonet.inference import StereoMatcher, StereoResult
from mobilestereonet.streams.batch import match_frames
from mobilestereonet.streams.look import look_at_stream
from mobilestereonet.streams.open import open_stream
from mobilestereonet.streams.overlap import latest_only, prefetch
from mobilestereonet.streams.stream import StereoFrame, Stream, in_real_time


def match_stream(
    source: str | Stream,
    matcher: StereoMatcher,
    *,
    calibration: Calibration | None = None,
    real_time: bool = False,
    **options: Any,
) -> Generator[tuple[StereoFrame, StereoResult]]:
    """Match the frames of a video, a camera, a bag or folders; reading and matching overlap.

        for frame, result in match_stream("run.mcap", matcher, left_topic=..., right_topic=...):
            depth = result.depth(frame.calibration)

    A frame that cannot be read or matched is left out with a warning. What the first look at the
    first frame puts right holds for all, and every result has its findings.

    Args:
        source: What `open_stream` takes first, or what it gave.
        matcher: The matcher.
        calibration: Geometry of the frames; by default that of the matcher's rig, or the one that
            the source knows.
        real_time: Play a recording as fast as it was taken and drop the frames that come while
            another one is matched, as a live camera always does. ``frame.index`` tells the gaps.
        **options: Other arguments of `open_stream`, such as ``right`` or ``left_topic``.

    Yields:
        Each frame, with its calibration if there is one, and its result.

    Raises:
        FileNotFoundError: If a file or a folder does not exist.
        InputError: If the source cannot be opened, or tells that its pictures are rectified while
            the matcher has a rig of raw ones.
    """
    stream = open_stream(source, **options) if isinstance(source, str) else source
    _, stream = look_at_stream(stream, rectifier=matcher.rectifier, shift=matcher.shift)
    if stream.live:
        frames = stream.frames
    elif real_time:
        frames = latest_only(in_real_time(stream.frames))
    else:
        frames = prefetch(stream.frames)
    with closing(frames):
        for frame, result in match_frames(frames, matcher):
            if result is None:
                warnings.warn(f"frame {frame.name} is left out: {frame.problem}", stacklevel=2)
            else:
                known = calibration or frame.calibration or stream.calibration
                yield replace(frame, calibration=known), result
