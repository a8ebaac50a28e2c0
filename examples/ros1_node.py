#!/usr/bin/env python3
"""ROS 1 node: rectified pairs in; disparity, depth, points and confidence out.

    ROS_NAMESPACE=stereo python examples/ros1_node.py _quality:=fast

It subscribes to left/image_rect, right/image_rect, left/camera_info and right/camera_info, and
publishes disparity, depth, points2, confidence and camera_info, all in its namespace; remap them
(left/image_rect:=/cam0/image_rect). Pairs that come while another one is matched are dropped.

Parameters: ~quality (fast, balanced or best) or ~model (what StereoMatcher.from_pretrained takes),
~device, ~tolerance (of the stamps of a pair, in s), ~max_depth (of the points, in metres).
"""

from collections import deque

import message_filters
import rospy
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
    rospy.init_node("mobilestereonet")
    matcher = StereoMatcher.from_pretrained(
        rospy.get_param("~model", None),
        quality=rospy.get_param("~quality", None),
        device=rospy.get_param("~device", "auto"),
    )
    matcher.confidence = matcher.engine.has_confidence
    max_depth = rospy.get_param("~max_depth", float("inf"))
    messages = ResultMessages(message_maker(), matcher.max_disparity, max_depth)
    publishers = {
        name: rospy.Publisher(name, message_class(kind), queue_size=1)
        for name, kind in RESULT_TOPICS.items()
    }
    newest = deque(maxlen=1)
    subscribers = [
        message_filters.Subscriber(f"{side}/{name}", kind)
        for name, kind in (("image_rect", Image), ("camera_info", CameraInfo))
        for side in ("left", "right")
    ]
    pairs = message_filters.ApproximateTimeSynchronizer(
        subscribers, queue_size=10, slop=rospy.get_param("~tolerance", 0.01)
    )
    pairs.registerCallback(lambda *pair: newest.append(pair))
    rospy.loginfo(f"mobilestereonet: {matcher.summary}")
    while not rospy.is_shutdown():
        if not newest:
            rospy.sleep(0.002)
            continue
        left, right, *cameras = newest.pop()
        try:
            result = matcher(picture_of(left), picture_of(right), look=False)
            answers = messages.all(left.header, result, calibration_of(*cameras))
        except InputError as error:
            rospy.logwarn_throttle(5, f"mobilestereonet: a pair is skipped: {error}")
            continue
        for name, message in answers.items():
            publishers[name].publish(message)


if __name__ == "__main__":
    main()
