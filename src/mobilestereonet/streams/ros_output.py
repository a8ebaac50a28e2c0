"""Results as ROS messages: disparity, depth, points and confidence.

Messages of ROS 1, of ROS 2 and of bags differ in their classes, not in their fields: the caller
gives the function that makes them, see `MessageMaker`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from mobilestereonet.data.disparity_files import KITTI_SCALE
from mobilestereonet.data.sample import Calibration
from mobilestereonet.inference import PointCloud, StereoResult

Image = NDArray[Any]

DISPARITY_STEP_PX = 1 / KITTI_SCALE
"""Step of disparity that messages tell, in px: that of KITTI's files. The networks have none."""


class MessageMaker(Protocol):
    """Makes a message of a type such as "sensor_msgs/msg/Image" from its fields, in lower case."""

    def __call__(self, kind: str, /, **fields: Any) -> Any:
        """Make a message. Arrays of bytes are (N,) uint8, those of numbers float64."""
        ...


RESULT_TOPICS = {
    "disparity": "stereo_msgs/msg/DisparityImage",
    "depth": "sensor_msgs/msg/Image",
    "points2": "sensor_msgs/msg/PointCloud2",
    "confidence": "sensor_msgs/msg/Image",
    "camera_info": "sensor_msgs/msg/CameraInfo",
}
"""Topics of results, in the namespace of the camera, and the types of their messages."""


def message_class(kind: str) -> Any:
    """The class of a message type in an installed ROS, such as "sensor_msgs/msg/Image"."""
    package, name = kind.split("/msg/")
    return getattr(import_module(f"{package}.msg"), name)


def message_maker(pack: Callable[[bytes], Any] = bytes) -> MessageMaker:
    """`MessageMaker` of an installed ROS, for nodes.

    Args:
        pack: Makes the value of a field ``uint8[]``: ``bytes`` in ROS 1, in ROS 2
            ``lambda data: array.array("B", data)``.
    """

    def make(kind: str, /, **fields: Any) -> Any:
        message = message_class(kind)()
        for field, value in fields.items():
            name = field if hasattr(message, field) else field.upper()  # t in ROS 2, T in ROS 1
            if isinstance(value, np.ndarray):
                value = pack(value.tobytes()) if value.dtype == np.uint8 else value.tolist()
            setattr(message, name, value)
        return message

    return make


_ENCODINGS = {
    (2, np.dtype(np.uint8)): "mono8",
    (2, np.dtype(np.uint16)): "mono16",
    (3, np.dtype(np.uint8)): "rgb8",
    (3, np.dtype(np.uint16)): "rgb16",
    (2, np.dtype(np.float32)): "32FC1",
}
"""Encodings of sensor_msgs by the dimensions and the dtype of an array."""


def image_message(make: MessageMaker, header: Any, values: Image) -> Any:
    """A ``sensor_msgs/Image`` of an array, little-endian.

    Args:
        make: Makes one message.
        header: A ``std_msgs/Header``.
        values: (H, W) uint8, uint16 or float32, or (H, W, 3) RGB, uint8 or uint16.
    """
    height, width = values.shape[:2]
    data = np.frombuffer(values.astype(values.dtype.newbyteorder("<")).tobytes(), np.uint8)
    return make(
        "sensor_msgs/msg/Image",
        header=header,
        height=height,
        width=width,
        encoding=_ENCODINGS[values.ndim, values.dtype],
        is_bigendian=0,
        step=values.nbytes // height,
        data=data,
    )


def camera_info(
    make: MessageMaker,
    header: Any,
    calibration: Calibration,
    size: tuple[int, int],
    *,
    right: bool,
) -> Any:
    """A ``sensor_msgs/CameraInfo`` of a rectified view.

    Args:
        make: Makes one message.
        header: A ``std_msgs/Header``.
        calibration: Geometry of the rectified pair.
        size: Width and height of the views, in px.
        right: Whether it is the right view's, whose projection has the baseline.
    """
    focal, focal_y = calibration.focal_lengths
    column, row = calibration.principal_point(*size)
    column += calibration.doffs if right else 0.0
    camera = np.array([[focal, 0, column], [0, focal_y, row], [0, 0, 1]], np.float64)
    offset = np.array([-focal * calibration.baseline if right else 0.0, 0, 0])
    return make(
        "sensor_msgs/msg/CameraInfo",
        header=header,
        height=size[1],
        width=size[0],
        distortion_model="plumb_bob",
        d=np.zeros(5),
        k=camera.ravel(),
        r=np.eye(3).ravel(),
        p=np.column_stack((camera, offset)).ravel(),
        binning_x=0,
        binning_y=0,
        roi=_window(make, 0, 0),  # all of the picture
    )


def _window(make: MessageMaker, width: int, height: int) -> Any:
    """A ``sensor_msgs/RegionOfInterest`` that begins in the upper left corner."""
    return make(
        "sensor_msgs/msg/RegionOfInterest",
        x_offset=0,
        y_offset=0,
        height=height,
        width=width,
        do_rectify=False,
    )


@dataclass(frozen=True)
class ResultMessages:
    """Makes the messages of results.

    Args:
        make: Makes one message.
        max_disparity: Disparities below it were searched, in px.
        max_depth: Farther points are left out, in metres.
    """

    make: MessageMaker
    max_disparity: int
    max_depth: float = float("inf")

    def all(
        self, header: Any, result: StereoResult, calibration: Calibration | None
    ) -> dict[str, Any]:
        """The messages that a result and its calibration allow, by the last part of their topic.

        Args:
            header: A ``std_msgs/Header``: the left picture's stamp and frame.
            result: The result.
            calibration: Its geometry; without one there is a disparity, but no depth.

        Raises:
            InputError: If the calibration is known to be of another size.
        """
        messages = {"disparity": self.disparity(header, result, calibration)}
        if calibration is not None:
            messages["depth"] = self.depth(header, result, calibration)
            messages["points2"] = self.points(header, result, calibration)
            messages["camera_info"] = self.camera_info(header, result, calibration)
        if result.confidence is not None:
            grey = np.rint(255 * result.confidence).astype(np.uint8)
            messages["confidence"] = image_message(self.make, header, grey)
        return messages

    def disparity(self, header: Any, result: StereoResult, calibration: Calibration | None) -> Any:
        """A ``stereo_msgs/DisparityImage``, for which depth is ``f * T / disparity``.

        As its definition wants it, the principal points' difference is in the disparities, and
        what is unknown lies below ``min_disparity``. Without a calibration ``f`` and ``T`` are 0.
        """
        height, width = result.disparity.shape
        doffs = 0.0 if calibration is None else calibration.doffs
        if calibration is not None:
            calibration.require_size(width, height)
        start = 0 if result.info is None else result.info.shift
        lowest = max(start + doffs, 0.0)
        shifted = result.disparity + np.float32(doffs)
        known = result.valid & (shifted >= lowest)
        values = np.where(known, shifted, np.float32(lowest - 1)).astype(np.float32)
        window = _window(self.make, width, height)
        return self.make(
            "stereo_msgs/msg/DisparityImage",
            header=header,
            image=image_message(self.make, header, values),
            f=0.0 if calibration is None else calibration.focal,
            t=0.0 if calibration is None else calibration.baseline,
            valid_window=window,
            min_disparity=lowest,
            max_disparity=self.max_disparity - 1 + doffs,
            delta_d=DISPARITY_STEP_PX,
        )

    def camera_info(
        self, header: Any, result: StereoResult, calibration: Calibration, *, right: bool = False
    ) -> Any:
        """A rectified view's `camera_info`; the left one's is that of disparity and depth, too."""
        height, width = result.disparity.shape
        return camera_info(self.make, header, calibration, (width, height), right=right)

    def depth(self, header: Any, result: StereoResult, calibration: Calibration) -> Any:
        """Depth as REP 118 has it: 32FC1 in metres, NaN where it is not known."""
        depth = result.depth(calibration)
        values = np.where(depth > 0, depth, np.float32(np.nan))
        return image_message(self.make, header, values)

    def points(self, header: Any, result: StereoResult, calibration: Calibration) -> Any:
        """A ``sensor_msgs/PointCloud2`` with x, y, z and rgb, without points at depth edges."""
        cloud = result.points(calibration, max_depth=self.max_depth)
        fields = [
            self.make(
                "sensor_msgs/msg/PointField", name=name, offset=4 * index, datatype=7, count=1
            )
            for index, name in enumerate(("x", "y", "z", "rgb"))  # 7: FLOAT32
        ]
        data = _packed(cloud)
        return self.make(
            "sensor_msgs/msg/PointCloud2",
            header=header,
            height=1,
            width=len(cloud.points),
            fields=fields,
            is_bigendian=False,
            point_step=16,
            row_step=data.size,
            data=data,
            is_dense=True,
        )


def _packed(cloud: PointCloud) -> NDArray[np.uint8]:
    """Points as x, y, z and a colour 0x00RRGGBB, 16 bytes each."""
    packed = np.zeros((len(cloud.points), 16), np.uint8)
    packed[:, :12] = cloud.points.astype("<f4").view(np.uint8).reshape(-1, 12)
    packed[:, 12:15] = cloud.colours[:, ::-1]
    return packed.reshape(-1)
