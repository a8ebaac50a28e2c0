"""Modules that stand in for ROS 2: they hand a node one pair, and keep what it publishes."""

import sys
from dataclasses import fields
from types import ModuleType, SimpleNamespace


class Message:
    """Base of messages that have the fields of their definition, and no other one."""

    def __setattr__(self, name, value):
        assert name in self.names, f"{self.kind} has no field {name}"
        object.__setattr__(self, name, value)


def message_class(kind):
    from rosbags.typesys import Stores, get_typestore

    definition = get_typestore(Stores.ROS2_HUMBLE).types[kind]
    names = {field.name for field in fields(definition)}
    nothing = dict.fromkeys(names)
    return type(kind.rpartition("/")[2], (Message,), {"names": names, "kind": kind, **nothing})


def to_rosbags(types, message):
    """A node's message as one of rosbags, which its serialiser then checks."""
    import numpy as np

    if isinstance(message, Message):
        values = {name: to_rosbags(types, getattr(message, name)) for name in message.names}
        return types.types[message.kind](**values)
    if isinstance(message, list):
        if all(isinstance(entry, float) for entry in message):  # float64[], float64[9]
            return np.array(message)
        return [to_rosbags(types, entry) for entry in message]
    return np.frombuffer(message, np.uint8) if hasattr(message, "typecode") else message


def install(monkeypatch, pair, parameters):
    """Put the modules in place; gives what the node publishes, by topic."""
    published, callbacks = {}, []

    def spin(node):
        for callback in callbacks:
            callback(*pair)

    node = SimpleNamespace(
        declare_parameter=lambda name, default: SimpleNamespace(
            value=parameters.get(name, default)
        ),
        create_publisher=lambda kind, topic, depth: SimpleNamespace(
            publish=lambda message: published.__setitem__(topic, (kind, message))
        ),
        get_logger=lambda: SimpleNamespace(info=print, warning=print),
    )
    modules = {
        "rclpy": {"init": lambda: None, "ok": lambda: len(published) < 4, "spin": spin},
        "rclpy.node": {"Node": lambda name: node},
        "rclpy.qos": {"qos_profile_sensor_data": None},
        "message_filters": {
            "Subscriber": lambda node, kind, topic, qos_profile: topic,
            "ApproximateTimeSynchronizer": lambda subscribers, queue_size, slop: SimpleNamespace(
                registerCallback=callbacks.append
            ),
        },
        "sensor_msgs.msg": {},
        "stereo_msgs.msg": {},
    }
    kinds = ("Image", "CameraInfo", "PointCloud2", "PointField", "RegionOfInterest")
    for kind in kinds:
        modules["sensor_msgs.msg"][kind] = message_class(f"sensor_msgs/msg/{kind}")
    modules["stereo_msgs.msg"]["DisparityImage"] = message_class("stereo_msgs/msg/DisparityImage")
    for name, values in modules.items():
        module = ModuleType(name)
        vars(module).update(values)
        monkeypatch.setitem(sys.modules, name, module)
    return published
