"""`StereoBag`: bags of ROS 1 and ROS 2 with two topics of images, paired by their stamps."""

from __future__ import annotations

import re
import warnings
from collections.abc import Generator, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mobilestereonet.data.images import Array
from mobilestereonet.data.rig import Rig
from mobilestereonet.data.sample import Calibration
from mobilestereonet.errors import InputError, needs_extra
from mobilestereonet.streams.pairing import pair_nearest
from mobilestereonet.streams.ros_input import (
    VIDEO_PACKETS,
    check_encoding,
    picture_of,
    raw_part,
    rectified_part,
    rig_of,
)

TOLERANCE_S = 0.01
"""Largest difference between the stamps of a pair, in s."""

_IMAGES = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage")
_CAMERA_INFO = "sensor_msgs/msg/CameraInfo"
_TRANSPORT = "compressed"  # the last part of a compressed image's topic

_RECTIFIED = re.compile(r"(^|[/_])rect(ified)?([/_]|$)")


@dataclass(frozen=True)
class BagPair:
    """Both pictures of a moment in a bag.

    Attributes:
        index: Its number, from 0.
        seconds: Time since the first one, in s.
        stamps: When the left and the right picture were taken, in ns; None for one that is missing.
        frame_ids: Names of the cameras' coordinate frames; empty for one that is missing.
        pictures: The pictures, see `picture_of`; None where there is a problem.
        problem: Why there are none.
    """

    index: int
    seconds: float
    stamps: tuple[int | None, ...]
    frame_ids: tuple[str, ...]
    pictures: tuple[Array, Array] | None
    problem: str = ""


@dataclass(frozen=True)
class StereoBag:
    """A bag of ROS of which two topics are the views of a stereo camera.

    Attributes:
        path: The bag.
        topics: Topics of the left and of the right images.
        tolerance: Largest difference between the stamps of a pair, in s.
        total: Number of pairs, if no image is without a partner.
        rig: What the topics ``camera_info`` beside the images tell; None if there are none.
        camera_infos: All topics of camera_info in it.
    """

    path: Path
    topics: tuple[str, str]
    tolerance: float
    total: int
    rig: Rig | None
    camera_infos: tuple[str, ...] = ()

    @classmethod
    def open(
        cls,
        path: str | Path,
        left: str | None = None,
        right: str | None = None,
        tolerance: float = TOLERANCE_S,
    ) -> StereoBag:
        """Open a bag; for arguments and errors see `open_bag`."""
        path = Path(path)
        if not path.exists():
            raise FileNotFoundError(f"{path}: no such bag")
        with _open_reader(path) as reader:
            topics = {name: (info.msgtype, info.msgcount) for name, info in reader.topics.items()}
            views = _image_topics(path, topics, left, right)
            for view in views:
                _check_images(path, reader, view)
            infos = [_camera_info(path, reader, topics, view) for view in views]
        total = min(topics[view][1] for view in views)
        known = tuple(name for name, (kind, _) in topics.items() if kind == _CAMERA_INFO)
        return cls(path, views, tolerance, total, _rig(path, views, infos), known)

    @property
    def raw_rig(self) -> Rig | None:
        """The rig of the images as they are; None if they are rectified, or nothing is known."""
        if self.rig is None or are_rectified(self.path, self.topics):
            return None
        raw = raw_part(self.rig)
        return None if raw is None else Rig((raw,), "camera_info")

    @property
    def calibration(self) -> Calibration | None:
        """Calibration of the images once they are rectified."""
        return None if self.rig is None else rectified_part(self.rig)

    def pairs(self) -> Generator[BagPair]:
        """The pairs in the order of their stamps; images without a partner have a problem.

        Raises:
            InputError: If the bag is damaged.
        """
        with _open_reader(self.path) as reader:
            images = _images(self.path, reader, self.topics)
            pairs = pair_nearest(images, lambda image: image.stamp, round(self.tolerance * 1e9))
            start, seconds = None, 0.0
            for index, pair in enumerate(pairs):
                first = next(view for view in pair if view is not None)
                start = first.stamp if start is None else start
                seconds = max(seconds, (first.stamp - start) / 1e9)  # a bag may start again
                yield BagPair(
                    index,
                    seconds,
                    tuple(None if view is None else view.stamp for view in pair),
                    tuple("" if view is None else view.message.header.frame_id for view in pair),
                    *self._pictures(pair),
                )

    def _pictures(
        self, pair: tuple[_Stamped | None, _Stamped | None]
    ) -> tuple[tuple[Array, Array] | None, str]:
        """Both pictures of a pair, or the problem."""
        left, right = pair
        if left is not None and right is not None:
            try:
                return (picture_of(left.message), picture_of(right.message)), ""
            except InputError as error:
                return None, str(error)
        first = next(view for view in pair if view is not None)
        present, missing = self.topics if right is None else self.topics[::-1]
        problem = f"{present} at {first.stamp / 1e9:.6f} s: {missing} has no image within "
        return None, problem + f"{self.tolerance:g} s of it"


def are_rectified(path: Path, topics: Sequence[str]) -> bool:
    """Whether the names of both topics say that their images are rectified (``image_rect``).

    Raises:
        InputError: If one does and the other one does not.
    """
    rectified = [topic for topic in topics if _RECTIFIED.search(topic)]
    if len(rectified) == 1:
        raise InputError(
            f"{path}: by the topics' names, {rectified[0]} alone of {' and '.join(topics)} is "
            "rectified: name two topics with rectified images, or two with raw ones"
        )
    return bool(rectified)


@contextmanager
def _open_reader(path: Path) -> Iterator[Any]:
    with needs_extra("bags"):
        from rosbags.highlevel import AnyReader, AnyReaderError
        from rosbags.typesys import Stores, get_typestore
    try:
        with ExitStack() as stack:
            try:
                # Bags of ROS 2 before Iron do not hold the definitions of their messages.
                types = get_typestore(Stores.LATEST)
                reader = stack.enter_context(AnyReader([path], default_typestore=types))
            except Exception as error:  # whatever a parser makes of any bytes
                raise InputError(f"{path}: not a bag that can be read: {error}") from error
            yield reader
    except (AnyReaderError, FileNotFoundError, AssertionError, IndexError, EOFError) as error:
        raise InputError(f"{path}: not a bag that can be read: {error}") from error


def _image_topics(
    path: Path, topics: dict[str, tuple[str | None, int]], left: str | None, right: str | None
) -> tuple[str, str]:
    """Check the names of the topics of both views."""
    images = sorted(
        f"{topic} ({count} of {str(kind).rpartition('/')[2]})"
        for topic, (kind, count) in topics.items()
        if kind in _IMAGES
    )
    listed = f"images in it: {', '.join(images)}" if images else "there are no images in it"
    if left is None or right is None:
        raise InputError(f"{path}: name both views, --left TOPIC and --right TOPIC; {listed}")
    if left == right:
        raise InputError(f"{path}: {left} is both the left and the right view; {listed}")
    for topic in (left, right):
        kind = topics.get(topic, ("", 0))[0]
        if kind in VIDEO_PACKETS:
            raise InputError(f"{path}: {topic} holds {VIDEO_PACKETS[kind]}")
        if kind not in _IMAGES:
            raise InputError(f"{path}: no images on the topic {topic}; {listed}")
    return left, right


def _check_images(path: Path, reader: Any, topic: str) -> None:
    """Refuse a topic whose first image says that it is of a kind that cannot be read."""
    message = _first_message(path, reader, topic)
    try:
        if message is not None:
            check_encoding(message)
    except InputError as error:
        raise InputError(f"{path}: {topic}: {error}") from None


def _first_message(path: Path, reader: Any, topic: str) -> Any:
    return next((message for _, _, message in _messages(path, reader, (topic,))), None)


def _messages(path: Path, reader: Any, topics: Sequence[str]) -> Iterator[tuple[str, int, Any]]:
    """Topics, times of recording and messages in the bag's order.

    Raises:
        InputError: If the bag is damaged.
    """
    connections = [each for each in reader.connections if each.topic in topics]
    try:
        for connection, recorded, data in reader.messages(connections):
            yield connection.topic, recorded, reader.deserialize(data, connection.msgtype)
    except Exception as error:  # whatever a parser makes of any bytes
        raise InputError(
            f"{path}: the bag is damaged: {error}: copy it again, or repair it (rosbag reindex, "
            "mcap recover)"
        ) from error


def _camera_info(
    path: Path, reader: Any, topics: dict[str, tuple[str | None, int]], image: str
) -> Any:
    """The first calibration of a view's camera; None if the bag has none."""
    parts = image.split("/")
    if parts[-1] == _TRANSPORT:
        parts.pop()
    topic = "/".join([*parts[:-1], "camera_info"])
    if topics.get(topic, ("", 0))[0] != _CAMERA_INFO:
        return None
    return _first_message(path, reader, topic)


def _rig(path: Path, views: tuple[str, str], infos: list[Any]) -> Rig | None:
    """The rig that two cameras' messages give; a warning says why it is none."""
    if None in infos:
        return None
    try:
        return rig_of(*infos)
    except InputError as error:
        advice = "give --focal and --baseline, or a --rig FILE"
        with suppress(InputError):
            rig_of(*reversed(infos))
            advice = f"by it {views[1]} is the left view: exchange --left and --right"
        warnings.warn(
            f"{path}: no depth from the camera_info of {views[0]} and {views[1]}: {error}; "
            f"{advice}",
            stacklevel=3,
        )
        return None


@dataclass(frozen=True)
class _Stamped:
    """An image message with its stamp in ns."""

    stamp: int
    message: Any


def _images(path: Path, reader: Any, views: tuple[str, str]) -> Iterator[tuple[int, _Stamped]]:
    """Images of both topics in the bag's order: 0 or 1 for left or right, and the message."""
    for topic, recorded, message in _messages(path, reader, views):
        stamp = message.header.stamp
        nanoseconds = stamp.sec * 10**9 + stamp.nanosec
        # A driver that sets no stamp leaves the time at which it was recorded.
        yield views.index(topic), _Stamped(nanoseconds or recorded, message)
