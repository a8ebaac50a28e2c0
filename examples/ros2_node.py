#!/usr/bin/env python3
"""ROS 2 node: rectified pairs in; disparity, depth, points and confidence out.

    python examples/ros2_node.py --ros-args -r __ns:=/stereo -p quality:=fast

It subscribes to left/image_rect, right/image_rect, left/camera_info and right/camera_info, and
publishes disparity, depth, points2, confidence and camera_info, all in its namespace; remap them
(-r left/image_rect:=/cam0/image_rect). Pairs that come while another one is matched are dropped.

Parameters: quality (fast, balanced or best) or model (what StereoMatcher.from_pretrained takes),
device, tolerance (of the stamps of a pair, in s), max_depth (of the points, in metres).

Not tested in ROS 2. A test runs it with a stand-in for rclpy and checks its messages against the
definitions of ROS 2 Humble. The ROS 1 node beside it was run.
"""

from array import array
from collections import deque
from threading import Thread
from time import sleep

import message_filters
import rclpy
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import CameraInfo, Image

from mobilestereonet import InputError, StereoMatcher
from mobilestereonet.streams.ros_input import calibration_of, picture_of
from mobilestereonet.streams.ros_output import (
    RESULT_TOPICS,
    ResultMessages,
    message_class,
    message_maker,
)


def main() -> None:
    """Match pairs until ROS shuts the node down."""
    rclpy.init()
    node = Node("mobilestereonet")

    def parameter(name, default):
        return node.declare_parameter(name, default).value

    matcher = StereoMatcher.from_pretrained(
        parameter("model", "") or None,
        quality=parameter("quality", "") or None,
        device=parameter("device", "auto"),
    )
    matcher.confidence = matcher.engine.has_confidence
    messages = ResultMessages(
        message_maker(lambda data: array("B", data)),
        matcher.max_disparity,
        parameter("max_depth", float("inf")),
    )
    publishers = {
        name: node.create_publisher(message_class(kind), name, 1)
        for name, kind in RESULT_TOPICS.items()
    }
    newest = deque(maxlen=1)
    subscribers = [
        message_filters.Subscriber(
            node, kind, f"{side}/{name}", qos_profile=qos_profile_sensor_data
        )
        for name, kind in (("image_rect", Image), ("camera_info", CameraInfo))
        for side in ("left", "right")
    ]
    pairs = message_filters.ApproximateTimeSynchronizer(
        subscribers, queue_size=10, slop=parameter("tolerance", 0.01)
    )
    pairs.registerCallback(lambda *pair: newest.append(pair))
    node.get_logger().info(f"mobilestereonet: {matcher.summary}")
    Thread(target=rclpy.spin, args=(node,), daemon=True).start()  # receives while this matches
    while rclpy.ok():
        if not newest:
            sleep(0.002)
            continue
        left, right, *cameras = newest.pop()
        try:
            result = matcher(picture_of(left), picture_of(right), look=False)
            answers = messages.all(left.header, result, calibration_of(*cameras))
        except InputError as error:
            node.get_logger().warning(f"mobilestereonet: a pair is skipped: {error}")
            continue
        for name, message in answers.items():
            publishers[name].publish(message)


if __name__ == "__main__":
    main()
