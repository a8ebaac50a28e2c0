"""The first look at a stream or at many pairs: at the first one that can be read."""

from __future__ import annotations

from collections.abc import Generator, Iterable, Sequence
from contextlib import closing
from dataclasses import replace
from typing import TypeGuard

from mobilestereonet.inference import Rectifier
from mobilestereonet.inference.arrangement import Arrangement
from mobilestereonet.inference.finding import Finding
from mobilestereonet.inference.first_look import ViewOptions, first_look
from mobilestereonet.streams.pairs import PairFiles, read_pairs
from mobilestereonet.streams.stream import StereoFrame, Stream, first_pair, rectify_frames


def look_at_stream(
    stream: Stream, options: ViewOptions | None = None, rectifier: Rectifier | None = None
) -> tuple[tuple[Finding, ...], Stream]:
    """What the first look finds at a stream, and the stream with all its frames put right.

    Args:
        stream: The stream.
        options: What the user says about the views.
        rectifier: Rectifies the frames, before they are looked at, and has their calibration.
    """
    if _is_raw(rectifier):
        stream = replace(stream, frames=rectify_frames(stream.frames, rectifier))
        rectifier = None
    frame, stream = first_pair(stream)
    arrangement, findings = _look(frame, options or ViewOptions())
    read = frame.pair.findings if frame is not None and frame.pair is not None else ()
    # What holds for all frames; each has those of its own reading and of its quick checks.
    lasting = [
        finding
        for finding in findings
        if finding not in read and finding.check not in ("content", "exposure")
    ]
    frames = prepared(stream.frames, rectifier, arrangement, lasting)
    return findings, replace(stream, frames=frames)


def look_at_pairs(
    pairs: Iterable[PairFiles],
    options: ViewOptions | None = None,
    rectifier: Rectifier | None = None,
) -> tuple[tuple[Finding, ...], Arrangement]:
    """What the first look finds at pairs of one camera, and what puts all of them right.

    Args:
        pairs: Their files.
        options: What the user says about the views.
        rectifier: Rectifies the pairs, before they are looked at.
    """
    frames = read_pairs(pairs)
    if _is_raw(rectifier):
        frames = rectify_frames(frames, rectifier)
    frame, stream = first_pair(Stream(frames, None))
    stream.frames.close()
    arrangement, findings = _look(frame, options or ViewOptions())
    return findings, arrangement


def prepared(
    frames: Generator[StereoFrame],
    rectifier: Rectifier | None,
    arrangement: Arrangement,
    findings: Sequence[Finding] = (),
) -> Generator[StereoFrame]:
    """Frames that are rectified, or have their calibration, and are put right.

    Args:
        frames: The frames, which are closed with the result.
        rectifier: Rectifies them before they are put right, or has the calibration of the views
            that are.
        arrangement: What puts them right.
        findings: What all their pairs have as findings, too.
    """
    if _is_raw(rectifier):
        return _arranged(rectify_frames(frames, rectifier), arrangement, findings)
    frames = _arranged(frames, arrangement, findings)
    return frames if rectifier is None else rectify_frames(frames, rectifier)


def _is_raw(rectifier: Rectifier | None) -> TypeGuard[Rectifier]:
    """Whether the pictures are to be rectified; until then nothing can be told of their rows."""
    return rectifier is not None and rectifier.rectifies


def _arranged(
    frames: Generator[StereoFrame], arrangement: Arrangement, findings: Sequence[Finding]
) -> Generator[StereoFrame]:
    with closing(frames):
        for frame in frames:
            pair = frame.pair
            if pair is not None:
                pair = replace(arrangement(pair), findings=(*pair.findings, *findings))
            yield replace(frame, pair=pair)


def _look(
    frame: StereoFrame | None, options: ViewOptions
) -> tuple[Arrangement, tuple[Finding, ...]]:
    if frame is None or frame.pair is None:
        return options.arrangement, ()
    return first_look(frame.pair, options)
