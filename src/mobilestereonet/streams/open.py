"""Opening of streams: videos, cameras, bags and image sequences."""

from __future__ import annotations

from pathlib import Path

import cv2

from mobilestereonet.errors import InputError
from mobilestereonet.streams.bags import is_bag, open_bag
from mobilestereonet.streams.captures import is_capture, open_captures
from mobilestereonet.streams.devices import is_device, open_device
from mobilestereonet.streams.pairs import (
    IMAGE_ENDINGS,
    joined_files,
    pair_folders,
    read_pairs,
)
from mobilestereonet.streams.stereo_bag import TOLERANCE_S
from mobilestereonet.streams.stream import Stream
from mobilestereonet.streams.video_files import open_videos


def open_stream(
    left: str,
    right: str | None = None,
    fps: float = 10.0,
    *,
    left_topic: str | None = None,
    right_topic: str | None = None,
    tolerance: float = TOLERANCE_S,
    pair_by: str | None = None,
    rectify: bool = True,
    layout: str | None = None,
) -> Stream:
    """Open a video, a camera, a bag or an image sequence.

    Args:
        left: A video file; the number of a camera, its device or an address; or, for an image
            sequence, a folder or a pattern. Without ``right`` it shows both views, or has MPO
            files. Or a bag, which has both views as topics; or ``realsense:``, ``oak:`` or
            ``zed:``, see `open_device`.
        right: The same of the right view.
        fps: Frames per second of an image sequence.
        left_topic: Topic of a bag's left images.
        right_topic: Topic of its right images.
        tolerance: Largest difference between the stamps of a pair of a bag, in s.
        pair_by: How an image sequence is paired, see `find_pairs`.
        rectify: Whether raw pictures of a bag are rectified by its camera_info, see `open_bag`.
        layout: How both views lie in one picture, see `load_pair`.

    Raises:
        FileNotFoundError: If a file or a folder does not exist.
        InputError: If it cannot be opened, or the two do not belong together.
    """
    sources = [left] if right is None else [left, right]
    if any(map(is_bag, sources)):
        if right is not None:
            raise InputError(f"{left} and {right}: a bag has both views, give it alone")
        return open_bag(left, left_topic, right_topic, tolerance, rectify=rectify)
    if is_device(left):
        if right is not None:
            raise InputError(f"{left} has both views: leave {right} out")
        return open_device(left)
    if left_topic is not None or right_topic is not None:
        raise InputError(f"{left}: topics are those of a bag (.mcap, .bag, .db3), not of this")
    refuse_stills(*sources)
    for kind, is_kind in (("captures", is_capture), ("video files", _is_file)):
        if any(map(is_kind, sources)):
            if not all(map(is_kind, sources)):
                raise InputError(f"{left} and {right}: only one of them is among {kind}")
            if kind == "captures":
                return open_captures(sources, layout)
            return open_videos(sources, layout)
    pairs = joined_files(left) if right is None else pair_folders(left, right, pair_by)
    return Stream(read_pairs(pairs, fps, layout=layout), len(pairs))


def refuse_stills(*sources: str) -> None:
    """Refuse files of single pictures, which are no stream.

    Raises:
        InputError: If one of the sources is such a file.
    """
    for source in filter(is_still, sources):
        raise InputError(
            f"{source}: a picture, not a video: `msnet predict` matches one pair, `msnet batch` "
            "folders or patterns of pictures, which are a sequence here, too"
        )


def is_still(source: str) -> bool:
    """Whether a source is the file of one picture (a GIF may be a video)."""
    path = Path(source)
    if not path.is_file() or path.suffix.lower() == ".gif":
        return False
    return path.suffix.lower() in IMAGE_ENDINGS or cv2.haveImageReader(source)


def _is_file(source: str) -> bool:
    return Path(source).is_file()
