"""Live captures: cameras and network addresses that OpenCV opens."""

from __future__ import annotations

import time
import warnings
from collections.abc import Generator, Sequence
from contextlib import suppress
from itertools import count
from pathlib import Path
from typing import Any

import cv2

from mobilestereonet.errors import InputError
from mobilestereonet.streams.overlap import latest_only
from mobilestereonet.streams.stream import StereoFrame, Stream, check_sizes, make_frame


def is_capture(source: str) -> bool:
    """Whether a source is a camera (a number or a device) or an address, not a file."""
    if "://" in source:
        return True
    path = Path(source)  # a folder may be called 00, as KITTI's are
    return path.is_char_device() if path.exists() else _is_number(source)


def _is_number(source: str) -> bool:
    return source.isascii() and source.isdecimal()


def open_captures(sources: Sequence[str], layout: str | None = None) -> Stream:
    """Open a stereo camera, or two cameras.

    A live capture does not wait: if matching is slower, frames are dropped. What is read from
    a file (``file://...``) waits.

    Args:
        sources: One capture with both views, or two: numbers of cameras, devices or addresses.
        layout: How both views lie in one capture, see `load_pair`.

    Raises:
        InputError: If one cannot be opened; if two differ in size; if one alone cannot be halved.
    """
    live = not all(source.startswith("file://") for source in sources)
    captures = [_open(source) for source in sources]
    check_sizes(sources, [_size(capture) for capture in captures], layout)
    frames = _frames(sources, captures, live, layout)
    return Stream(latest_only(frames) if live else frames, None, live)


def _open(source: str) -> Any:
    logging = cv2.utils.logging
    level = logging.getLogLevel()
    logging.setLogLevel(logging.LOG_LEVEL_ERROR)  # the backends that do not know the source warn
    capture = None
    with suppress(cv2.error, OverflowError, UnicodeError):  # a number or a name beyond its reach
        capture = cv2.VideoCapture(int(source) if _is_number(source) else source)
    logging.setLogLevel(level)
    if capture is None or not capture.isOpened():
        raise InputError(
            f"{source}: OpenCV cannot open this capture; is the camera connected and free, or the "
            "address right?"
        )
    return capture


def _size(capture: Any) -> tuple[int, int]:
    return int(capture.get(cv2.CAP_PROP_FRAME_WIDTH)), int(capture.get(cv2.CAP_PROP_FRAME_HEIGHT))


def _keep_in_step(captures: Sequence[Any], dropped: list[int]) -> list[int]:
    """Skip pictures of the recording that is behind; gives the number of one that ended."""
    fastest = max(capture.get(cv2.CAP_PROP_FPS) for capture in captures)
    tolerance = 500 / fastest if fastest > 0 else float("inf")  # half an interval, in ms
    while True:
        moments = [capture.get(cv2.CAP_PROP_POS_MSEC) for capture in captures]
        if max(moments) - min(moments) <= tolerance:
            return []
        late = moments.index(min(moments))
        dropped[late] += 1
        if not captures[late].grab():
            return [late]


def _frames(
    sources: Sequence[str], captures: Sequence[Any], live: bool, layout: str | None
) -> Generator[StereoFrame]:
    started = time.monotonic()
    dropped = [0 for _ in captures]
    try:
        for index in count():
            # Both take their picture before one is decoded: they should show one moment.
            ended = [
                source
                for source, capture in zip(sources, captures, strict=True)
                if not capture.grab()
            ]
            if not live and not ended:
                ended = [sources[late] for late in _keep_in_step(captures, dropped)]
            if ended:
                if live:
                    warnings.warn(
                        f"{' and '.join(ended)}: gave no more pictures after {index} frames; was "
                        "the camera unplugged or the connection lost?",
                        stacklevel=2,
                    )
                if any(dropped):
                    warnings.warn(
                        f"{dropped[0]} frames of {sources[0]} and {dropped[1]} of {sources[1]} "
                        "have no partner at their time: they were left out",
                        stacklevel=2,
                    )
                return
            shown = captures[0].get(cv2.CAP_PROP_POS_MSEC) / 1000
            seconds = time.monotonic() - started if live else shown
            taken = [capture.retrieve() for capture in captures]
            pictures = [
                cv2.cvtColor(image, cv2.COLOR_BGR2RGB) if whole else None for whole, image in taken
            ]
            yield make_frame(index, seconds, pictures, layout)
    finally:
        for capture in captures:
            capture.release()
