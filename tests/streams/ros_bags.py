"""Bags of pairs whose disparity is known, written with rosbags."""

import cv2
import numpy as np
from noise_pairs import HEIGHT, WIDTH, make_pair

FOCAL_PX, BASELINE_M = 100.0, 0.2
START_NS = 1_700_000_000 * 10**9
VIEWS = ("/stereo/left/image_rect", "/stereo/right/image_rect")
FORMATS = ("run.mcap", "run", "run.bag")
"""A file of ROS 2, a folder of ROS 2 with an SQLite database, a file of ROS 1."""


class BagWriter:
    """Writes messages to a bag of the format that a path's ending tells."""

    def __init__(self, path):
        from rosbags import rosbag1, rosbag2
        from rosbags.typesys import Stores, get_typestore

        self.path, self.connections = path, {}
        self.of_ros1 = path.suffix == ".bag"
        self.types = get_typestore(Stores.ROS1_NOETIC if self.of_ros1 else Stores.ROS2_HUMBLE)
        if self.of_ros1:
            self.writer = rosbag1.Writer(path)
        else:
            plugins = rosbag2.StoragePlugin
            storage = plugins.MCAP if path.suffix else plugins.SQLITE3
            folder = path.with_suffix("")
            self.writer = rosbag2.Writer(folder, version=9, storage_plugin=storage)

    def __enter__(self):
        self.writer.open()
        return self

    def __exit__(self, *error):
        self.writer.__exit__(*error)
        if self.path.suffix == ".mcap":  # a file by itself, without its folder
            (self.path.with_suffix("") / self.path.name).replace(self.path)

    def make(self, kind, **fields):
        return self.types.types[kind](**fields)

    def header(self, stamp, frame_id):
        seq = {"seq": 0} if self.of_ros1 else {}
        time = self.make("builtin_interfaces/msg/Time", sec=stamp // 10**9, nanosec=stamp % 10**9)
        return self.make("std_msgs/msg/Header", stamp=time, frame_id=frame_id, **seq)

    def write(self, topic, stamp, kind, **fields):
        if topic not in self.connections:
            self.connections[topic] = self.writer.add_connection(topic, kind, typestore=self.types)
        message = self.make(kind, **fields)
        types = self.types
        data = (types.serialize_ros1 if self.of_ros1 else types.serialize_cdr)(message, kind)
        self.writer.write(self.connections[topic], stamp, data)

    def image(self, topic, stamp, picture, encoding="rgb8"):
        if topic.endswith("/compressed"):
            _, data = cv2.imencode(".png", picture[..., ::-1])
            kind, fields = (
                "sensor_msgs/msg/CompressedImage",
                {"format": "rgb8; png compressed bgr8"},
            )
        else:
            height, width = picture.shape[:2]
            kind, data = "sensor_msgs/msg/Image", np.frombuffer(picture.tobytes(), np.uint8)
            fields = {"height": height, "width": width, "encoding": encoding, "is_bigendian": 0}
            fields["step"] = data.size // height
        header = self.header(stamp, f"{topic.split('/')[2]}_camera")
        self.write(topic, stamp + 5, kind, header=header, data=data.reshape(-1), **fields)

    def camera_info(self, topic, stamp, projection, distortion=(0, 0, 0, 0, 0)):
        window = self.make(
            "sensor_msgs/msg/RegionOfInterest",
            x_offset=0,
            y_offset=0,
            height=0,
            width=0,
            do_rectify=False,
        )
        names = "DKRP" if self.of_ros1 else "dkrp"
        matrices = (
            np.float64(distortion),
            np.ravel(projection[:, :3]),
            np.eye(3).ravel(),
            projection.ravel(),
        )
        self.write(
            topic,
            stamp,
            "sensor_msgs/msg/CameraInfo",
            header=self.header(stamp, "camera"),
            height=HEIGHT,
            width=WIDTH,
            distortion_model="plumb_bob",
            binning_x=0,
            binning_y=0,
            roi=window,
            **dict(zip(names, matrices, strict=True)),
        )


def projection(baseline=0.0):
    f = FOCAL_PX
    return np.array([[f, 0, WIDTH / 2, -f * baseline], [0, f, HEIGHT / 2, 0], [0, 0, 1, 0]])


def write_bag(path, views=VIEWS, frames=4, skipped=(), calibrated=True, distortion=None):
    """A bag with `frames` pairs at 10 Hz, pair i of disparity 10 + i; the right view 2 ms later.

    Args:
        skipped: (view, frame): images that are left out.
        distortion: Coefficients of the lenses; the images become those of such cameras.
    """
    lens = np.float64(distortion or [0] * 5)
    with BagWriter(path) as bag:
        for view, topic in enumerate(views):
            if calibrated:
                parent = topic.removesuffix("/compressed").rpartition("/")[0]
                bag.camera_info(
                    f"{parent}/camera_info", START_NS, projection(view * BASELINE_M), lens
                )
        for frame in range(frames):
            for view, picture in enumerate(make_pair(10 + frame, frame)):
                if distortion:
                    picture = distorted(picture, lens)
                if (view, frame) not in skipped:
                    stamp = START_NS + frame * 10**8 + view * 2 * 10**6
                    bag.image(views[view], stamp, picture)
    return path


def distorted(picture, lens):
    """What a camera with such a lens sees of a rectified picture."""
    camera = projection()[:, :3]
    pixels = np.float32(np.mgrid[:HEIGHT, :WIDTH][::-1].reshape(2, -1).T)
    straight = cv2.undistortPoints(pixels[:, None], camera, lens, P=camera)
    maps = straight.reshape(HEIGHT, WIDTH, 2).astype(np.float32)
    return cv2.remap(picture, maps, None, cv2.INTER_LINEAR)
