"""Writing of results, or of rectified pairs, to a bag of ROS 1 or ROS 2."""

from __future__ import annotations

import posixpath
import warnings
from collections.abc import Sequence
from pathlib import Path

from mobilestereonet.data.images import Array
from mobilestereonet.data.sample import Calibration
from mobilestereonet.inference import StereoResult
from mobilestereonet.streams.bag_writer import BagWriter
from mobilestereonet.streams.ros_output import (
    RESULT_TOPICS,
    ResultMessages,
    camera_info,
    image_message,
)
from mobilestereonet.streams.stereo_bag import BagPair
from mobilestereonet.streams.stream import StereoFrame

FRAME_ID = "left_camera_optical_frame"
"""Coordinate frame of results whose source has none: x to the right, y down, z forward."""

RIGHT_FRAME_ID = "right_camera_optical_frame"


class BagFile(BagWriter):
    """Writer of a ROS bag of stereo results, a context manager; the file appears when complete.

    Each result gives ``disparity`` (stereo_msgs/DisparityImage) and, with a calibration, ``depth``
    (sensor_msgs/Image, 32FC1 in metres), ``points2`` (sensor_msgs/PointCloud2) and
    ``camera_info``, and with a confidence ``confidence`` (sensor_msgs/Image, mono8), see
    `ResultMessages`. Stamps and frames are those of the left images. ``left/camera_info`` and
    ``right/camera_info`` have the rectified views' geometry, with the stamps and frames of each.

    Args:
        path: The file to write, ``.mcap`` (ROS 2) or ``.bag`` (ROS 1).
        max_disparity: Disparities below it were searched, in px.
        topics: The source's topics of the left and the right view: the results' begin with what
            these have in common, or with ``/stereo``.
        taken: The source's topics of camera_info, which are not written again: both bags can then
            be played together.
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
        taken: Sequence[str] = (),
        max_depth: float = float("inf"),
    ) -> None:
        super().__init__(path)
        self._taken = frozenset(taken)
        self._messages = ResultMessages(self.make, max_disparity, max_depth)
        common = posixpath.commonpath(topics) if topics else ""
        self.namespace = common if common.strip("/") else "/stereo"
        own = posixpath.join(self.namespace, "camera_info")
        if own in self._taken:
            warnings.warn(
                f"{path}: without {own}, which is a topic of the source; the results' geometry is "
                "in the disparity's messages (f, T)",
                stacklevel=2,
            )

    def write(
        self, frame: StereoFrame, result: StereoResult, calibration: Calibration | None
    ) -> None:
        """Write a frame's result.

        Raises:
            InputError: If the calibration is known to be of another size.
            OSError: If the file cannot be written.
        """
        stamp = round(frame.seconds * 1e9) if frame.stamp is None else frame.stamp
        header = self.header(stamp, frame.frame_id or FRAME_ID, frame.index)
        messages = self._messages.all(header, result, calibration)
        if calibration is not None:
            right_stamp = stamp if frame.right_stamp is None else frame.right_stamp
            right_frame = frame.right_frame_id or RIGHT_FRAME_ID
            right_header = self.header(right_stamp, right_frame, frame.index)
            messages["left/camera_info"] = messages["camera_info"]
            messages["right/camera_info"] = self._messages.camera_info(
                right_header, result, calibration, right=True
            )
        for name, message in messages.items():
            topic = posixpath.join(self.namespace, name)
            if topic not in self._taken:
                self.send(topic, RESULT_TOPICS[posixpath.basename(name)], stamp, message)


class RectifiedBag(BagWriter):
    """Writer of a ROS bag of rectified pairs, a context manager; the file appears when complete.

    Of each camera it has ``image_rect`` (sensor_msgs/Image with the source's bits) and
    ``camera_info``, in the namespace of its source, with the source's stamps and frames.

    Args:
        path: The file to write, ``.mcap`` (ROS 2) or ``.bag`` (ROS 1).
        topics: The source's topics of the left and the right view.

    Raises:
        InputError: As `BagWriter`.
    """

    def __init__(self, path: str | Path, topics: Sequence[str]) -> None:
        super().__init__(path)
        images = [topic.removesuffix("/compressed") for topic in topics]
        parents = [posixpath.dirname(image) for image in images]
        #: Namespaces of the cameras; where the images share one, each topic is one.
        self.namespaces = parents if parents[0] != parents[1] else images

    def write(self, pair: BagPair, views: Sequence[Array], calibration: Calibration) -> None:
        """Write a rectified pair.

        Args:
            pair: The pair that it was.
            views: Its rectified views, (H, W) or (H, W, 3) RGB, uint8 or uint16.
            calibration: Its geometry.

        Raises:
            OSError: If the file cannot be written.
        """
        height, width = views[0].shape[:2]
        for right, view in enumerate(views):
            stamp = pair.stamps[right]
            assert stamp is not None  # a pair with pictures has both
            header = self.header(stamp, pair.frame_ids[right], pair.index)
            messages = {
                "camera_info": camera_info(
                    self.make, header, calibration, (width, height), right=bool(right)
                ),
                "image_rect": image_message(self.make, header, view),
            }
            for name, message in messages.items():
                topic = posixpath.join(self.namespaces[right], name)
                self.send(topic, message.__msgtype__, stamp, message)
