"""A client of the ROS 1 node: publishes a pair until it is answered, and prints the answer."""

import sys
from functools import partial

sys.path.append("/usr/lib/python3/dist-packages")  # after this environment's own packages

import numpy as np
import rospy
from sensor_msgs.msg import CameraInfo, Image, PointCloud2
from stereo_msgs.msg import DisparityImage

SIDES = ("left", "right")
RESULTS = {"disparity": DisparityImage, "depth": Image, "points2": PointCloud2}


def messages(side, view, stamp):
    image, info = Image(), CameraInfo()
    for message in (image, info):
        message.header.stamp, message.header.frame_id = stamp, "optical"
        message.height, message.width = view.shape[:2]
    image.encoding, image.step = "bgr8", 3 * view.shape[1]
    image.data = view[..., ::-1].tobytes()
    info.P = [100, 0, 80, -20 * (side == "right"), 0, 100, 24, 0, 0, 0, 1, 0]
    return {"image_rect": image, "camera_info": info}


def main():
    rospy.init_node("client")
    got = {}
    for name, kind in RESULTS.items():
        rospy.Subscriber(f"/stereo/{name}", kind, partial(got.__setitem__, name))
    publishers = {
        (side, name): rospy.Publisher(f"/stereo/{side}/{name}", kind, queue_size=1)
        for side in SIDES
        for name, kind in (("image_rect", Image), ("camera_info", CameraInfo))
    }
    views = np.load(sys.argv[1])
    for _ in range(200):
        stamp = rospy.Time.now()
        for side, view in zip(SIDES, views, strict=True):
            for name, message in messages(side, view, stamp).items():
                publishers[side, name].publish(message)
        rospy.sleep(0.1)
        if len(got) == len(RESULTS):
            break
    middle = slice(10, -10), slice(80, -20)
    disparity = np.frombuffer(got["disparity"].image.data, "<f4").reshape(48, 160)[middle]
    depth = np.frombuffer(got["depth"].data, "<f4").reshape(48, 160)[middle]
    print(np.median(disparity), got["disparity"].f, got["disparity"].T, np.nanmedian(depth))
    print(got["points2"].width > 1000)
    print({message.header.frame_id for message in got.values()} == {"optical"})


if __name__ == "__main__":
    main()
