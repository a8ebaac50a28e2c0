"""Writing of messages to a bag of ROS 1 or ROS 2."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any

from mobilestereonet.atomic import GrowingFile, check_outputs
from mobilestereonet.errors import InputError, needs_extra

if TYPE_CHECKING:
    from typing_extensions import Self

BAG_ENDINGS = (".mcap", ".bag")
"""Bags that can be written: of ROS 2 and of ROS 1."""


class BagWriter:
    """Writer of a ROS bag, a context manager; the file appears when it is complete.

    Args:
        path: The file to write, ``.mcap`` (ROS 2) or ``.bag`` (ROS 1).

    Raises:
        InputError: If the ending is another one, the path is a folder, or rosbags is not
            installed.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        if self.path.suffix.lower() not in BAG_ENDINGS:
            raise InputError(f"{path}: bags are written as {' or '.join(BAG_ENDINGS)}")
        check_outputs(self.path)
        with needs_extra("bags"):
            from rosbags.typesys import Stores, get_typestore
        self._of_ros1 = self.path.suffix.lower() == ".bag"
        self._types = get_typestore(Stores.ROS1_NOETIC if self._of_ros1 else Stores.ROS2_HUMBLE)
        self._writer: Any = None
        self._connections: dict[str, Any] = {}

    def make(self, kind: str, /, **values: Any) -> Any:
        """A message of rosbags; see `MessageMaker`."""
        message = self._types.types[kind]
        known = {field.name for field in fields(message)}  # t in ROS 2, T in ROS 1
        return message(**{n if n in known else n.upper(): value for n, value in values.items()})

    def header(self, stamp: int, frame_id: str, number: int) -> Any:
        """A ``std_msgs/Header``.

        Args:
            stamp: When the message's content was taken, in ns.
            frame_id: Name of its coordinate frame.
            number: Its number, which ROS 1 keeps.
        """
        time = self.make("builtin_interfaces/msg/Time", sec=stamp // 10**9, nanosec=stamp % 10**9)
        sequence = {"seq": number} if self._of_ros1 else {}
        return self.make("std_msgs/msg/Header", stamp=time, frame_id=frame_id, **sequence)

    def send(self, topic: str, kind: str, stamp: int, message: Any) -> None:
        """Write a message.

        Args:
            topic: Its topic.
            kind: Its type, such as "sensor_msgs/msg/Image".
            stamp: When it was recorded, in ns.
            message: What `make` gave.

        Raises:
            OSError: If the file cannot be written.
        """
        if self._writer is None:
            self._open()
        if topic not in self._connections:
            connection = self._writer.add_connection(topic, kind, typestore=self._types)
            self._connections[topic] = connection
        types = self._types
        serialise = types.serialize_ros1 if self._of_ros1 else types.serialize_cdr
        self._writer.write(self._connections[topic], stamp, serialise(message, kind))

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._writer is None:
            return
        with self._growing:
            self._writer.__exit__(kind, error, trace)
            if kind is None:
                self._growing.appear(self._written)

    def _open(self) -> None:
        from rosbags import rosbag1, rosbag2

        self._growing = GrowingFile(self.path)
        path = self._growing.folder / self.path.name
        if self._of_ros1:
            self._written = path
            self._writer = rosbag1.Writer(path)
        else:  # a folder with the file and its metadata, which the file holds, too
            self._written = path.with_suffix("") / f"{path.stem}.mcap"
            mcap = rosbag2.StoragePlugin.MCAP
            self._writer = rosbag2.Writer(path.with_suffix(""), version=9, storage_plugin=mcap)
        self._writer.open()
