"""A ROS 2 node where a ROS 2 is sourced: rclpy carries the bytes. Everything else is shared with ROS 1 and DDS."""

from __future__ import annotations

import importlib
import os
import threading
from collections.abc import Callable
from typing import Any

from kinecast.errors import OptionError
from kinecast.ros.messages import Distribution, messages_of
from kinecast.ros.transport import CLOSING, Callback, Transport

NODE = "kinecast"
QUEUE = 10


class Ros2Transport(Transport):
    """A node in a context of its own.

    It speaks the definitions of the distribution that is sourced; packages of other messages than ROS 2's own
    (kinecast_msgs, moveit_msgs, zed_msgs) must be built or installed there.

    Raises:
        OptionError: no rclpy here, or a distribution that is none of `Distribution`'s.
    """

    def __init__(self) -> None:
        try:
            self._rclpy = importlib.import_module("rclpy")
        except ImportError as error:
            raise OptionError(
                f"ros2: no rclpy here ({error}): source ROS 2's setup.bash, or use dds:, which needs no ROS"
            ) from None
        name = os.environ.get("ROS_DISTRO", "")
        known = {each.value: each for each in Distribution if each.generation == 2}
        if name not in known:
            raise OptionError(f"ros2: ROS_DISTRO is {name!r}, expected {' or '.join(known)}")
        super().__init__(messages_of(known[name]))
        self._context = self._rclpy.Context()
        self._rclpy.init(context=self._context)
        self._node = self._rclpy.create_node(NODE, context=self._context)
        self._qos = importlib.import_module("rclpy.qos")
        self._executor = importlib.import_module("rclpy.executors").SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._thread = threading.Thread(target=self._executor.spin, name=NODE, daemon=True)
        self._thread.start()

    def subscribe(self, topic: str, type_: str, callback: Callback) -> None:
        def take(content: Any) -> None:
            callback(topic, bytes(content))

        qos = self._qos.qos_profile_sensor_data
        if topic == "/tf_static":
            qos = self._qos.QoSProfile(depth=100, durability=self._qos.DurabilityPolicy.TRANSIENT_LOCAL)
        self._node.create_subscription(_message_class(type_), topic, take, qos, raw=True)

    def create_publisher(self, topic: str, type_: str) -> Callable[[bytes], None]:
        publish: Callable[[bytes], None] = self._node.create_publisher(_message_class(type_), topic, QUEUE).publish
        return publish

    def now(self) -> float:
        return float(self._node.get_clock().now().nanoseconds) / 1e9

    def close(self) -> None:
        self._executor.shutdown()
        self._node.destroy_node()
        self._rclpy.shutdown(context=self._context)
        self._thread.join(CLOSING)


def _message_class(type_: str) -> Any:
    """The class of a message's package."""
    package, _, name = type_.partition("/")
    try:
        return getattr(importlib.import_module(f"{package}.msg"), name)
    except (ImportError, AttributeError):
        raise OptionError(f"ros2: {type_} is not built here; leave it out of outputs=, or build {package}") from None
