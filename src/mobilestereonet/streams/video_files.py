"""Video files: reading frame by frame, with broken frames reported, and writing."""

from __future__ import annotations

import warnings
from collections import deque
from collections.abc import Generator, Iterable, Iterator, Sequence
from fractions import Fraction
from operator import itemgetter
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from mobilestereonet.atomic import write_atomically
from mobilestereonet.data.images import Picture
from mobilestereonet.errors import InputError, needs_extra
from mobilestereonet.streams.pairing import pair_by_time, tolerance_of
from mobilestereonet.streams.stream import StereoFrame, Stream, check_sizes, make_frame

VIDEO_FORMATS = (".mp4", ".mkv", ".mov")

_CLOCK = 90_000
"""Ticks per second of written videos: usual frame rates divide it."""

_MAX_START_DIFFERENCE_S = 0.5
"""Difference of two videos' first time stamps up to which both are of one clock."""


def _pyav() -> Any:
    with needs_extra("video", "image sequences and cameras are matched to --frames without it"):
        import av
    return av


class VideoFile:
    """Video file as a sequence of pictures.

    Attributes:
        path: The file.
        size: Width and height in px, as shown.
        stamps: Times at which its frames are shown, in ticks, in order.
    """

    def __init__(self, path: str | Path) -> None:
        """Go through the file once, decoding its first frame alone.

        Raises:
            FileNotFoundError: If there is no such file.
            InputError: If it is no video, holds no frame, or does not tell when they are shown.
        """
        self.path = Path(path)
        self._av = _pyav()
        if not self.path.is_file():
            raise FileNotFoundError(f"{path}: no such file")
        try:
            with self._av.open(str(path)) as container:
                stream = next(iter(container.streams.video), None)
                if stream is None:
                    raise InputError(f"{path}: there are no pictures in it, only sound or data")
                self.tick = stream.time_base
                stamps = [
                    packet.pts
                    for packet in container.demux(stream)
                    if packet.size and not packet.is_discard
                ]
                told = float((stream.duration or 0) * self.tick)
                width, height = stream.codec_context.width, stream.codec_context.height
            self.size = (height, width) if self._turns() % 2 else (width, height)
        except self._av.error.FFmpegError as error:
            raise InputError(
                f"{path}: not a video that can be read ({error.strerror}); is it damaged, or was "
                "its recording cut off?"
            ) from None
        if not stamps or None in stamps or 0 in self.size:
            missing = "time stamps: put it into an .mp4 or .mkv" if stamps else "frames"
            raise InputError(f"{path}: a video without {missing}")
        self.stamps: list[int] = sorted(stamps)
        lasts = self.seconds(self.stamps[-1])
        if told > lasts + 1:
            warnings.warn(
                f"{path}: its frames end at {lasts:.1f} s of {told:.1f} s: the rest cannot be read",
                stacklevel=2,
            )

    def _turns(self) -> int:
        """Quarter turns of the first frame that can be decoded."""
        with self._av.open(str(self.path)) as container:
            for packet in container.demux(video=0):
                try:
                    for frame in packet.decode():
                        return _quarter_turns(frame)
                except self._av.error.FFmpegError:
                    continue
        return 0

    def seconds(self, stamp: int) -> float:
        """Time of a frame in s, from the first one on."""
        return float((stamp - self.stamps[0]) * self.tick)

    def __iter__(self) -> Iterator[tuple[float, Picture | None]]:
        """Iterate over time in s and picture, (H, W, 3) uint8 RGB, which is None if damaged."""
        # Frames come out later than they go in, and in another order. The time stamps tell which
        # ones never come.
        due = deque(self.stamps)
        with self._av.open(str(self.path)) as container:
            for packet in container.demux(video=0):
                try:
                    frames = packet.decode()
                except self._av.error.FFmpegError:
                    continue
                for frame in frames:
                    while due and due[0] < frame.pts:
                        yield self.seconds(due.popleft()), None
                    if due:
                        picture = None if frame.is_corrupt else _upright(frame)
                        yield self.seconds(due.popleft()), picture
        for stamp in due:
            yield self.seconds(stamp), None


def _quarter_turns(frame: Any) -> int:
    """Anticlockwise quarter turns after which a frame is shown, as its file asks."""
    return int(round(frame.rotation / 90) % 4)


def _upright(frame: Any) -> Picture:
    """Decode a video frame with its rotation applied, (H, W, 3) uint8 RGB."""
    stored = frame.to_ndarray(format="rgb24")
    return np.ascontiguousarray(np.rot90(stored, _quarter_turns(frame)))


def open_videos(paths: Sequence[str | Path], layout: str | None = None) -> Stream:
    """Open a video with both views, or the videos of the left and the right camera.

    Frames of two videos are paired by their time stamps: rates may differ, and frames be lost. A
    warning says how many have no partner.

    Args:
        paths: One or two files.
        layout: How both views lie in one video, see `load_pair`.

    Raises:
        FileNotFoundError: If a file does not exist.
        InputError: If one is no video; if two differ in size or have no moment in common; if one
            alone cannot be halved.
    """
    videos = [VideoFile(path) for path in paths]
    check_sizes([str(video.path) for video in videos], [video.size for video in videos], layout)
    if len(videos) == 1:
        return Stream(_frames(videos[0], layout), len(videos[0].stamps))
    left, right = videos
    started = [float(video.stamps[0] * video.tick) for video in videos]
    late = started[1] - started[0]
    # Recordings that were started apart have clocks of their own.
    late = late if abs(late) < _MAX_START_DIFFERENCE_S else 0.0
    times = [[video.seconds(stamp) for stamp in video.stamps] for video in videos]
    times[1] = [seconds + late for seconds in times[1]]
    tolerance = tolerance_of(*times)
    firsts, seconds = (list(enumerate(own)) for own in times)
    dropped: list[tuple[int, float]] = []
    paired = pair_by_time(firsts, seconds, itemgetter(1), tolerance, dropped)
    pairs = [(first, second) for (first, _), (second, _) in paired]
    if not pairs:
        raise InputError(
            f"{left.path} and {right.path}: no two frames were taken within {tolerance:.3f} s of "
            "each other: are they of one recording?"
        )
    if dropped:
        lost = [len(own) - len(pairs) for own in times]
        warnings.warn(
            f"{lost[0]} of {len(times[0])} frames of {left.path} and {lost[1]} of {len(times[1])} "
            f"of {right.path} have no partner within {1000 * tolerance:.0f} ms: they are left out",
            stacklevel=3,
        )
    return Stream(_paired_frames(left, right, pairs), len(pairs))


def _frames(video: VideoFile, layout: str | None) -> Generator[StereoFrame]:
    for index, (seconds, picture) in enumerate(video):
        yield make_frame(index, seconds, [picture], layout)


def _paired_frames(
    left: VideoFile, right: VideoFile, pairs: Sequence[tuple[int, int]]
) -> Generator[StereoFrame]:
    """Frames of two videos by their numbers, which increase."""
    firsts, seconds = enumerate(left), enumerate(right)
    for index, numbers in enumerate(pairs):
        moments = [
            next(moment for number, moment in frames if number == wanted)
            for frames, wanted in zip((firsts, seconds), numbers, strict=True)
        ]
        yield make_frame(index, moments[0][0], [picture for _, picture in moments])


def check_video_file(path: str | Path) -> Path:
    """Check that a video can be written in the format that a path's ending names.

    Raises:
        InputError: If it can't, or PyAV is not installed.
    """
    path = Path(path)
    if path.suffix.lower() not in VIDEO_FORMATS:
        raise InputError(f"{path}: videos are written as {', '.join(VIDEO_FORMATS)}")
    _pyav()
    return path


def write_video(path: str | Path, pictures: Iterable[tuple[float, Picture]]) -> None:
    """Write an H.264 video atomically.

    Args:
        path: The file to write; its ending is one of `VIDEO_FORMATS`.
        pictures: When each one is shown, in seconds, and the picture, (H, W, 3) uint8 RGB, all of
            one size. An odd height or width gets a border of one pixel, as the format wants.

    Raises:
        InputError: If there is no picture, or the ending is another one.
    """
    path = check_video_file(path)
    write_atomically(path, lambda temporary: _encode(temporary, pictures, path))


def _encode(temporary: Path, pictures: Iterable[tuple[float, Picture]], path: Path) -> None:
    av = _pyav()
    stream, last = None, -1
    with av.open(str(temporary), "w") as container:
        for seconds, picture in pictures:
            height, width = picture.shape[:2]
            framed = cv2.copyMakeBorder(picture, 0, height % 2, 0, width % 2, cv2.BORDER_REPLICATE)
            if stream is None:
                stream = container.add_stream("libx264", options={"crf": "18"})
                stream.width, stream.height = width + width % 2, height + height % 2
                stream.pix_fmt = "yuv420p"
                stream.codec_context.time_base = Fraction(1, _CLOCK)
            frame = av.VideoFrame.from_ndarray(framed, format="rgb24")
            # Two frames of a camera may come at once, but none can be shown before the other.
            last = max(last + 1, round(seconds * _CLOCK))
            frame.pts, frame.time_base = last, Fraction(1, _CLOCK)
            container.mux(stream.encode(frame))
        if stream is None:
            raise InputError(f"{path}: there is no frame to write")
        container.mux(stream.encode())
