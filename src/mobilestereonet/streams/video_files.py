"""Video files: reading frame by frame, with broken frames reported, and writing."""

from __future__ import annotations

import warnings
from collections import deque
from collections.abc import Generator, Iterable, Iterator, Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import cv2

from mobilestereonet.atomic import write_atomically
from mobilestereonet.data.images import Picture
from mobilestereonet.errors import InputError, needs_extra
from mobilestereonet.streams.stream import StereoFrame, Stream, check_sizes, make_frame

VIDEO_FORMATS = (".mp4", ".mkv", ".mov")

_CLOCK = 90_000
"""Ticks per second of written videos: usual frame rates divide it."""


def _pyav() -> Any:
    with needs_extra("video", "image sequences and cameras are matched to --frames without it"):
        import av
    return av


class VideoFile:
    """Video file as a sequence of pictures.

    Attributes:
        path: The file.
        size: Width and height in px.
        stamps: Times at which its frames are shown, in ticks, in order.
    """

    def __init__(self, path: str | Path) -> None:
        """Go through the file once, without decoding it.

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
                self.size = stream.codec_context.width, stream.codec_context.height
                self.tick = stream.time_base
                stamps = [
                    packet.pts
                    for packet in container.demux(stream)
                    if packet.size and not packet.is_discard
                ]
                told = float((stream.duration or 0) * self.tick)
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
                        whole = not frame.is_corrupt
                        picture = frame.to_ndarray(format="rgb24") if whole else None
                        yield self.seconds(due.popleft()), picture
        for stamp in due:
            yield self.seconds(stamp), None


def open_videos(paths: Sequence[str | Path]) -> Stream:
    """Open a side-by-side video, or the videos of the left and the right camera.

    Args:
        paths: One or two files.

    Raises:
        FileNotFoundError: If a file does not exist.
        InputError: If one is no video; if two differ in size or number of frames; if one alone
            has an odd width.
    """
    videos = [VideoFile(path) for path in paths]
    check_sizes([str(video.path) for video in videos], [video.size for video in videos])
    counts = [len(video.stamps) for video in videos]
    if len(set(counts)) > 1:
        raise InputError(
            f"the two videos must have one number of frames: {videos[0].path} has {counts[0]}, "
            f"{videos[1].path} has {counts[1]}"
        )
    return Stream(_frames(videos), counts[0])


def _frames(videos: Sequence[VideoFile]) -> Generator[StereoFrame]:
    for index, moments in enumerate(zip(*videos, strict=True)):
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
