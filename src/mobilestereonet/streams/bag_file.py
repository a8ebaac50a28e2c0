"""Writing of results to a bag of ROS 1 or ROS 2."""

from __future__ import annotations

import posixpath
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import Any

from mobilestereonet.atomic import GrowingFile, check_outputs
from mobilestereonet.data.sample import Calibration
from mobilestereonet.errors import InputError, needs_extra
from mobilestereonet.inference import StereoResult
from mobilestereonet.streams.ros_output import RESULT_TOPICS, ResultMessages
from mobilestereonet.streams.stream import StereoFrame

BAG_ENDINGS = (".mcap", ".bag")
"""Bags that can be written: of ROS 2 and of ROS 1."""

FRAME_ID = "left_camera_optical_frame"
"""Coordinate frame of results whose source has none: x to the right, y down, z forward."""


class BagFile:
    """Writer of a ROS bag of stereo results, a context manager; the file appears when complete.

    Each result gives ``disparity`` (stereo_msgs/DisparityImage) and, with a calibration, ``depth``
    (sensor_msgs/Image, 32FC1 in metres) and ``points2`` (sensor_msgs/PointCloud2), and with a
    confidence ``confidence`` (sensor_msgs/Image, mono8), see `ResultMessages`. Stamps and frames
    are those of the left images.

    Args:
        path: The file to write, ``.mcap`` (ROS 2) or ``.bag`` (ROS 1).
        max_disparity: Disparities below it were searched, in px.
        topics: The source's topics of the left and the right view: the results' begin with what
            these have in common, or with ``/stereo``.
        max_depth: Farther points are left out, in metres.

    Raises:
        InputError: If the ending is another one, the path is a folder, or rosbags is not
            installed.
    """

    def __init__(
        self,
        path: str | Path,
        max_disparity: int,
        *,
        topics: Sequence[str] = (),
        max_depth: float = float("inf"),
    ) -> None:
        self.path = Path(path)
        if self.path.suffix.lower() not in BAG_ENDINGS:
            raise InputError(f"{path}: bags are written as {' or '.join(BAG_ENDINGS)}")
        check_outputs(self.path)
        with needs_extra("bags"):
            from rosbags.typesys import Stores, get_typestore
        self._of_ros1 = self.path.suffix.lower() == ".bag"
        self._types = get_typestore(Stores.ROS1_NOETIC if self._of_ros1 else Stores.ROS2_HUMBLE)
        self._messages = ResultMessages(self._make, max_disparity, max_depth)
        common = posixpath.commonpath(topics) if topics else ""
        self.namespace = common if common.strip("/") else "/stereo"
        self._writer: Any = None
        self._connections: dict[str, Any] = {}

    def write(
        self, frame: StereoFrame, result: StereoResult, calibration: Calibration | None
    ) -> None:
        """Write a frame's result.

        Raises:
            InputError: If the calibration is known to be of another size.
            OSError: If the file cannot be written.
        """
        stamp = round(frame.seconds * 1e9) if frame.stamp is None else frame.stamp
        time = self._make("builtin_interfaces/msg/Time", sec=stamp // 10**9, nanosec=stamp % 10**9)
        sequence = {"seq": frame.index} if self._of_ros1 else {}
        header = self._make(
            "std_msgs/msg/Header", stamp=time, frame_id=frame.frame_id or FRAME_ID, **sequence
        )
        messages = self._messages.all(header, result, calibration)
        if self._writer is None:
            self._open()
        serialise = self._types.serialize_ros1 if self._of_ros1 else self._types.serialize_cdr
        for name, message in messages.items():
            kind = RESULT_TOPICS[name]
            if name not in self._connections:
                self._connections[name] = self._writer.add_connection(
                    posixpath.join(self.namespace, name), kind, typestore=self._types
                )
            self._writer.write(self._connections[name], stamp, serialise(message, kind))

    def __enter__(self) -> BagFile:
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

    def _make(self, kind: str, /, **fields: Any) -> Any:
        """A message of rosbags; see `MessageMaker`."""
        message = self._types.types[kind]
        if kind.endswith("DisparityImage") and self._of_ros1:
            fields["T"] = fields.pop("t")
        return message(**fields)
