"""`Stream` and `StereoFrame`: what every source of frames gives."""

from __future__ import annotations

import time
from collections.abc import Callable, Generator, Sequence
from contextlib import closing
from dataclasses import dataclass, replace

from mobilestereonet.data.images import Picture
from mobilestereonet.data.sample import Calibration
from mobilestereonet.errors import InputError
from mobilestereonet.inference.pair import StereoPair, layout_of, load_pair
from mobilestereonet.inference.rectify import Rectifier
from mobilestereonet.streams.laser import Pose
from mobilestereonet.streams.overlap import latest_only

MAX_LOOKED_AT = 30
"""Frames among which one is looked for that shows something: a camera may start in the dark."""


@dataclass(frozen=True)
class StereoFrame:
    """One stereo frame of a stream.

    Attributes:
        index: Its number, from 0. A gap is a frame that a live capture dropped.
        name: What to call it in reports and file names; may hold slashes.
        seconds: Time at which it is shown, in s.
        pair: Both views; None if they cannot be read.
        problem: Why they cannot; empty if they can.
        calibration: Geometry of the pair, if the source knows it.
        stamp: When the left view was taken, in ns of the source's clock; None if it has none.
        frame_id: Name of the left camera's coordinate frame in ROS, if the source knows it.
        right_stamp: When the right view was taken, likewise.
        right_frame_id: Name of the right camera's frame, likewise.
        to_laser: From the left camera's frame to a laser scanner's, if the source knows it.
    """

    index: int
    name: str
    seconds: float
    pair: StereoPair | None
    problem: str = ""
    calibration: Calibration | None = None
    stamp: int | None = None
    frame_id: str = ""
    right_stamp: int | None = None
    right_frame_id: str = ""
    to_laser: Pose | None = None


@dataclass(frozen=True)
class Stream:
    """A source of frames.

    Attributes:
        frames: The frames; they can be gone through once. Closing them ends the source.
        total: How many there are; None if that is not known.
        live: Whether they do not wait, as those of a camera: they are other ones the next time.
        calibration: Geometry of all of them, if the source knows it.
        topics: Topics of the left and the right view in ROS; empty for other sources.
        camera_infos: Topics of all camera_info in the source; likewise.
    """

    frames: Generator[StereoFrame]
    total: int | None
    live: bool = False
    calibration: Calibration | None = None
    topics: tuple[str, ...] = ()
    camera_infos: tuple[str, ...] = ()


def as_live(stream: Stream) -> Stream:
    """A stream whose newest frame wins: a recording plays as fast as it was taken.

    Frames that come while another one is in use are dropped, as a camera's are; gaps in their
    ``index`` tell them.
    """
    if stream.live:
        return stream
    frames = latest_only(_in_real_time(stream.frames))
    return replace(stream, frames=frames, total=None, live=True)


def _in_real_time(frames: Generator[StereoFrame]) -> Generator[StereoFrame]:
    """Give the frames of a recording when a camera would have given them, and not before."""
    with closing(frames):
        started = None
        for frame in frames:
            started = time.monotonic() - frame.seconds if started is None else started
            time.sleep(max(0.0, started + frame.seconds - time.monotonic()))
            yield frame


def first_pair(
    stream: Stream, suits: Callable[[StereoFrame], bool] = lambda _: True
) -> tuple[StereoFrame | None, Stream]:
    """The first frame of a stream that can be read, and the stream with all of its frames.

    Of a stream without a frame that can be read, the last one; None of one without any.

    Args:
        stream: The stream.
        suits: Which frame is looked for, among the first `MAX_LOOKED_AT` that can be read; if none
            is found, it is the first of them.
    """
    seen: list[StereoFrame] = []
    readable: list[StereoFrame] = []
    first = None
    for frame in stream.frames:
        seen.append(frame)
        if frame.pair is None:
            continue
        readable.append(frame)
        if suits(frame):
            first = frame
        if first is not None or len(readable) == MAX_LOOKED_AT:
            break

    def again() -> Generator[StereoFrame]:
        with closing(stream.frames):
            yield from seen
            yield from stream.frames

    return first or next(iter(readable or seen[-1:]), None), replace(stream, frames=again())


def rectify_frames(frames: Generator[StereoFrame], rectifier: Rectifier) -> Generator[StereoFrame]:
    """Rectify the frames of a stream; one that does not fit the rig gets a problem.

    Args:
        frames: The frames, which are closed with the result.
        rectifier: Rectifies them, and has their calibration.
    """
    with closing(frames):
        for frame in frames:
            if frame.pair is not None:
                try:
                    pair = rectifier.pair(frame.pair)
                    frame = replace(frame, pair=pair, calibration=pair.calibration)
                except InputError as error:
                    frame = replace(frame, pair=None, problem=str(error))
            yield frame


def make_frame(
    index: int, seconds: float, pictures: Sequence[Picture | None], layout: str | None = None
) -> StereoFrame:
    """Make a frame of the pictures that one or two cameras took at a moment.

    One that cannot be used has a ``problem`` and stops nothing.

    Args:
        index: Its number.
        seconds: Time at which it is shown, in s.
        pictures: Both views, (H, W, 3) RGB or (H, W) grey, uint8 or uint16, or one picture with
            both; None where it cannot be read.
        layout: How both views lie in one picture, see `load_pair`.
    """
    whole = [picture for picture in pictures if picture is not None]
    pair, problem = None, ""
    if len(whole) < len(pictures):
        problem = "the picture is damaged"
    else:
        try:
            pair = load_pair(*whole, layout=layout)
        except InputError as error:  # the source changed its size on the way
            problem = str(error)
    return StereoFrame(index, f"{index:06d}", seconds, pair, problem)


def check_sizes(
    names: Sequence[str], sizes: Sequence[tuple[int, int]], layout: str | None = None
) -> None:
    """Refuse sources that cannot hold two views, before the first frame is read.

    Args:
        names: What messages call them.
        sizes: Width and height of the left and the right source, or of one that has both views.
        layout: How both views lie in one picture, see `load_pair`.

    Raises:
        InputError: If two differ in size, or one alone cannot be halved.
    """
    if len(sizes) == 1:
        layout_of(sizes[0], layout, names[0])
    if len(set(sizes)) > 1:
        facts = [f"{name} has {size[0]}x{size[1]}" for name, size in zip(names, sizes, strict=True)]
        raise InputError(f"the two views must have one size: {', '.join(facts)}")
