"""Results of any source, one after the other, for a loop of the caller."""

from __future__ import annotations

import warnings
from collections.abc import Generator
from contextlib import closing
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any, TypeAlias

from mobilestereonet.errors import InputError
from mobilestereonet.inference import Rectifier, StereoMatcher, StereoResult
from mobilestereonet.inference.first_look import ViewOptions, warn_of
from mobilestereonet.streams.batch import match_frames
from mobilestereonet.streams.look import look_at_stream
from mobilestereonet.streams.open import open_stream
from mobilestereonet.streams.overlap import prefetch
from mobilestereonet.streams.stream import StereoFrame, Stream, as_live

Source: TypeAlias = "str | Path | Stream"


@dataclass(frozen=True, eq=False, repr=False)
class StreamResult(StereoResult):
    """`StereoResult` of a stream, with the frame that it is of.

    Attributes:
        frame: Its number, name, time, stamp and views.
    """

    frame: StereoFrame = field(kw_only=True)


def match_stream(
    matcher: StereoMatcher,
    source: Source,
    *,
    rectifier: Rectifier | None = None,
    drop: bool = False,
    **options: Any,
) -> Generator[StreamResult]:
    """Match the frames of a source; reading and matching overlap. See `StereoMatcher.stream`.

    Args:
        matcher: The matcher.
        source: What `open_stream` takes first, or what it gave.
        rectifier: Rectifies the frames, or has their calibration.
        drop: Whether the newest frame wins, see `as_live`.
        **options: Other arguments of `open_stream`; none where the source is what it gave.

    Yields:
        The result of each frame that can be matched.

    Raises:
        FileNotFoundError: If a file or a folder does not exist.
        InputError: If the source cannot be opened, or is open and there are options, does not
            show two views, or tells that its pictures are rectified while the rectifier is of raw
            ones.
    """
    if isinstance(source, Stream):
        if options:
            raise InputError(
                f"the source is open already, too late for {', '.join(sorted(options))}: give "
                "them to open_stream"
            )
    else:
        if "left" in options:
            raise InputError(
                "stream(source, right=...): the source is the left view, leave left out"
            )
        raw = rectifier is not None and rectifier.rectifies
        source = open_stream(str(source), rectify=not raw, **options)
    views = ViewOptions(layout=options.get("layout"))
    findings, stream = look_at_stream(source, views, rectifier, shift=matcher.shift)
    warn_of(findings)
    stream = as_live(stream) if drop else stream
    frames = stream.frames if stream.live else prefetch(stream.frames)
    with closing(frames):
        for frame, result in match_frames(frames, matcher):
            if result is None:
                warnings.warn(f"frame {frame.name} is left out: {frame.problem}", stacklevel=2)
            else:
                known = frame.calibration or stream.calibration
                yield _of_frame(result, replace(frame, calibration=known))


def _of_frame(result: StereoResult, frame: StereoFrame) -> StreamResult:
    values = {each.name: getattr(result, each.name) for each in fields(result)}
    return StreamResult(**{**values, "calibration": frame.calibration}, frame=frame)
