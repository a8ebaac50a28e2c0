"""The first look at a stream or at many pairs: at the first one that shows something."""

from __future__ import annotations

from collections.abc import Generator, Iterable, Sequence
from contextlib import closing
from dataclasses import dataclass, replace

from mobilestereonet.data.sample import Calibration
from mobilestereonet.errors import InputError
from mobilestereonet.inference import Rectifier
from mobilestereonet.inference.arrangement import Arrangement
from mobilestereonet.inference.finding import Finding
from mobilestereonet.inference.first_look import (
    ViewOptions,
    first_look,
    problems,
    require_two_views,
)
from mobilestereonet.streams.pairs import PairFiles, read_pairs
from mobilestereonet.streams.stream import StereoFrame, Stream, first_pair, rectify_frames


def look_at_stream(
    stream: Stream,
    options: ViewOptions | None = None,
    rectifier: Rectifier | None = None,
    *,
    shift: int = 0,
) -> tuple[tuple[Finding, ...], Stream]:
    """What the first look finds at a stream, and the stream with all its frames put right.

    Args:
        stream: The stream.
        options: What the user says about the views.
        rectifier: Rectifies the frames, or has their calibration.
        shift: Disparity from which on a network searches, in px.

    Raises:
        InputError: If the frames are rectified already, their calibration cannot follow what
            puts them right, or one source was given that does not show two views.
    """
    seen, stream = _look(stream, options, rectifier, shift)
    arrangement, findings = seen.arrangement, seen.findings
    try:
        require_two_views(findings, seen.name)
    except InputError:
        stream.frames.close()
        raise
    pair = None if seen.frame is None else seen.frame.pair
    # What holds for all frames; each has those of its own reading and of its quick checks.
    lasting = [
        finding
        for finding in findings
        if (pair is None or finding not in pair.findings)
        and finding.check not in ("content", "exposure")
    ]
    calibration = stream.calibration
    if calibration is not None and pair is not None and rectifier is None:
        calibration = arrangement(replace(pair, calibration=calibration)).calibration
    frames = prepared(stream.frames, rectifier, arrangement, lasting)
    return findings, replace(stream, frames=frames, calibration=calibration)


def look_at_pairs(
    pairs: Iterable[PairFiles],
    options: ViewOptions | None = None,
    rectifier: Rectifier | None = None,
    *,
    shift: int = 0,
) -> tuple[tuple[Finding, ...], Arrangement]:
    """What the first look finds at pairs of one camera, and what puts all of them right.

    Args:
        pairs: Their files.
        options: What the user says about the views.
        rectifier: Rectifies the pairs, or has their calibration.
        shift: Disparity from which on a network searches, in px.

    Raises:
        InputError: If the pairs are rectified already, or are of one file each that does not show
            two views.
    """
    layout = None if options is None else options.layout
    read = Stream(read_pairs(pairs, layout=layout), None)
    seen, stream = _look(read, options, rectifier, shift)
    stream.frames.close()
    require_two_views(seen.findings, seen.name)
    return seen.findings, seen.arrangement


def prepared(
    frames: Generator[StereoFrame],
    rectifier: Rectifier | None,
    arrangement: Arrangement,
    findings: Sequence[Finding] = (),
) -> Generator[StereoFrame]:
    """Frames that are put right, and rectified or given their calibration.

    Args:
        frames: The frames, which are closed with the result.
        rectifier: Rectifies them once they are arranged, or has the calibration of the views that
            then are; in place of the one that they know.
        arrangement: What puts them right.
        findings: What all their pairs have as findings, too.
    """
    frames = _arranged(frames, arrangement, findings, calibrated=rectifier is None)
    return frames if rectifier is None else rectify_frames(frames, rectifier)


def _arranged(
    frames: Generator[StereoFrame],
    arrangement: Arrangement,
    findings: Sequence[Finding],
    calibrated: bool,
) -> Generator[StereoFrame]:
    """Frames whose views and calibration are put right; one that cannot be gets a problem.

    Args:
        frames: The frames, which are closed with the result.
        arrangement: What puts them right.
        findings: What all their pairs have as findings, too.
        calibrated: Whether they keep their calibration.
    """
    with closing(frames):
        for frame in frames:
            known = frame.calibration if calibrated else None
            pair = frame.pair and replace(frame.pair, calibration=known)
            problem = frame.problem
            try:
                pair = pair and arrangement(pair)
            except InputError as error:
                pair, problem = None, str(error)
            if pair is not None:
                known = pair.calibration
                pair = replace(pair, calibration=None, findings=(*pair.findings, *findings))
            frame = replace(frame, pair=pair, problem=problem, calibration=known)
            yield _exchanged(frame) if arrangement.swapped else frame


def _exchanged(frame: StereoFrame) -> StereoFrame:
    """A frame whose views have been exchanged: what was said of the right one is of the left."""
    return replace(
        frame,
        stamp=frame.stamp if frame.right_stamp is None else frame.right_stamp,
        frame_id=frame.right_frame_id,
        right_stamp=frame.stamp,
        right_frame_id=frame.frame_id,
    )


@dataclass(frozen=True)
class _Seen:
    """What a look at a stream's frame found: nothing where none could be looked at."""

    frame: StereoFrame | None
    arrangement: Arrangement
    findings: tuple[Finding, ...] = ()

    @property
    def name(self) -> str:
        """What messages call it."""
        return "" if self.frame is None else self.frame.name

    @property
    def shows_something(self) -> bool:
        """Whether more can be told than that the views are empty, damaged or without texture."""
        wrong = {finding.check for finding in problems(self.findings)}
        unknown = {finding.check for finding in self.findings if finding.level == "unknown"}
        return "content" not in wrong and not ("layout" in wrong and "geometry" in unknown)


def _look(
    stream: Stream, options: ViewOptions | None, rectifier: Rectifier | None, shift: int
) -> tuple[_Seen, Stream]:
    """Look at frames until one shows something; and the stream with all of them."""
    options = options or ViewOptions()
    seen: list[_Seen] = []
    known: list[Calibration] = [] if stream.calibration is None else [stream.calibration]

    def look(frame: StereoFrame) -> bool:
        assert frame.pair is not None
        known.extend([frame.calibration] if frame.calibration else [])
        pair = replace(frame.pair, calibration=frame.calibration or stream.calibration)
        try:
            seen.append(_Seen(frame, *first_look(pair, options, rectifier, shift=shift)))
        except InputError:
            return False  # the frame's own problem
        return seen[-1].shows_something

    first, stream = first_pair(stream, look)
    if known and rectifier is not None and rectifier.rectifies:
        stream.frames.close()
        raise InputError(
            "the pictures are rectified already, as their source tells, and the rig is of raw "
            "ones: leave --rig out"
        )
    suitable = [each for each in seen if each.shows_something]
    return next(iter(suitable or seen), _Seen(first, options.arrangement)), stream
