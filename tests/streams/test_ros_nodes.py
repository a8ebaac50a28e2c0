"""The ROS nodes of the examples: with ROS 1 where Debian's packages are, ROS 2 with a stand-in."""

import os
import runpy
import socket
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import ros2_stand_in
from noise_pairs import centre, make_pair
from ros_bags import BASELINE_M, START_NS, BagWriter, projection

from extras import need_extra

EXAMPLES = Path(__file__).parents[2] / "examples"
CLIENT = Path(__file__).with_name("ros1_client.py")
DEBIAN = "/usr/lib/python3/dist-packages"


def test_ros2_messages_fit_their_definitions(monkeypatch, tmp_path):
    need_extra("rosbags")
    from rosbags.typesys import Stores, get_typestore

    types = get_typestore(Stores.ROS2_HUMBLE)
    writer = BagWriter(tmp_path / "new.mcap")
    header = writer.header(START_NS, "left_camera")
    left, right = make_pair(12)
    images = [
        SimpleNamespace(
            header=header,
            encoding="rgb8",
            height=48,
            width=160,
            step=480,
            is_bigendian=0,
            data=view.tobytes(),
        )
        for view in (left, right)
    ]
    window = SimpleNamespace(x_offset=0, y_offset=0, width=0, height=0)
    cameras = [
        SimpleNamespace(
            p=projection(side * BASELINE_M).ravel(),
            k=projection()[:, :3].ravel(),
            d=[],
            r=np.eye(3).ravel(),
            distortion_model="plumb_bob",
            width=160,
            height=48,
            binning_x=0,
            binning_y=0,
            roi=window,
        )
        for side in (0, 1)
    ]
    published = ros2_stand_in.install(monkeypatch, (*images, *cameras), {"model": "sgbm"})
    runpy.run_path(str(EXAMPLES / "ros2_node.py"), run_name="__main__")
    assert set(published) == {"disparity", "depth", "points2", "camera_info"}
    for kind, message in published.values():
        assert isinstance(message, kind)
        assert message.header is header
        assert len(types.serialize_cdr(ros2_stand_in.to_rosbags(types, message), kind.kind)) > 300
    image = published["disparity"][1].image
    disparity = np.frombuffer(image.data, np.float32).reshape(48, 160)
    assert np.median(centre(disparity)) == pytest.approx(12, abs=0.1)


@pytest.fixture
def ros_master():
    """A ROS 1 master of its own; gives the environment of nodes."""
    if not all((Path(DEBIAN) / name).is_dir() for name in ("rospy", "rosmaster", "stereo_msgs")):
        pytest.skip("Debian's ros-core, python3-rospy and python3-stereo-msgs are not installed")
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    environment = {
        **os.environ,
        "ROS_MASTER_URI": f"http://127.0.0.1:{port}",
        "ROS_IP": "127.0.0.1",
        "ROS_NAMESPACE": "stereo",
    }
    code = f"import sys; sys.path.append({DEBIAN!r}); import rosmaster; rosmaster.rosmaster_main()"
    command = [sys.executable, "-c", code, "--core", "-p", str(port)]
    with subprocess.Popen(command, env=environment, stdout=subprocess.DEVNULL) as master:
        yield environment
        master.terminate()


@pytest.mark.slow
def test_ros1_node_answers_in_ros(ros_master, tmp_path):
    np.save(tmp_path / "views.npy", make_pair(14))
    node = f"import sys, runpy; sys.path.append({DEBIAN!r}); sys.argv[0] = 'ros1_node.py'; "
    node += f"runpy.run_path({str(EXAMPLES / 'ros1_node.py')!r}, run_name='__main__')"
    environment = {**ros_master, "ROS_LOG_DIR": str(tmp_path)}
    command = [sys.executable, "-c", node, "_model:=sgbm"]
    with subprocess.Popen(command, env=environment) as running:
        time.sleep(1)
        client = [sys.executable, str(CLIENT), str(tmp_path / "views.npy")]
        told = subprocess.run(client, env=environment, capture_output=True, text=True, timeout=60)
        running.terminate()
    assert told.returncode == 0, told.stderr
    disparity, focal, baseline, depth, *facts = told.stdout.split()
    assert float(disparity) == pytest.approx(14, abs=0.1)
    assert (float(focal), float(baseline)) == pytest.approx((100, 0.2))
    assert float(depth) == pytest.approx(100 * 0.2 / 14, rel=0.01)
    assert facts == ["True", "True"]
