"""Nodes of an installed ROS: rospy or rclpy carries the bytes, everything else is shared with DDS.

Of ROS 1 no message package needs to be built or installed beside it.
"""

from __future__ import annotations

import atexit
import importlib
import os
import sys
import threading
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from rosbags.typesys.msg import normalize_msgtype

from kinecast.errors import OptionError
from kinecast.ros.messages import Distribution, messages_of
from kinecast.ros.transport import CLOSING, Callback, Transport

DEBIAN = Path("/usr/lib/python3/dist-packages")  # of Debian's and Ubuntu's system's packages, rospy among them
NODE = "kinecast"
QUEUE1, QUEUE2 = 50, 10  # messages that wait for a slow subscriber; the oldest of more are dropped


class Ros1Transport(Transport):
    """A ROS 1 node of its own name, one for this process until it ends; an OptionError without rospy or master."""

    def __init__(self) -> None:
        super().__init__(messages_of(Distribution.NOETIC))
        self._rospy = _import_rospy()
        rosgraph = importlib.import_module("rosgraph")
        if not rosgraph.is_master_online():
            raise OptionError(f"ros1: no master answers at {rosgraph.get_master_uri()}; start roscore")
        if not self._rospy.core.is_initialized():
            self._rospy.init_node(
                NODE, anonymous=True, disable_rosout=True, disable_signals=True, log_level=self._rospy.ERROR
            )
            atexit.register(self._rospy.signal_shutdown, "ended")
        self._registered: list[Any] = []

    def subscribe(self, topic: str, type_: str, callback: Callback) -> None:
        class_, options = self._message_class(type_), {"queue_size": QUEUE1, "tcp_nodelay": True}
        subscriber = self._rospy.Subscriber(topic, class_, lambda message: callback(topic, message._buff), **options)
        self._registered.append(subscriber)

    def create_publisher(self, topic: str, type_: str) -> Callable[[bytes], None]:
        class_ = self._message_class(type_)
        publisher = self._rospy.Publisher(topic, class_, queue_size=QUEUE1, tcp_nodelay=True)
        self._registered.append(publisher)
        return lambda content: publisher.publish(class_().deserialize(content))

    def now(self) -> float:
        """The ROS clock [s]; simulated where the parameter /use_sim_time says so."""
        return float(self._rospy.get_time())

    def close(self) -> None:
        for each in self._registered:
            each.unregister()

    def _message_class(self, type_: str) -> Any:
        """A message class for rospy that leaves bytes as they are."""
        text, md5 = self.messages.store.generate_msgdef(normalize_msgtype(type_))
        return type("Bytes", (self._rospy.AnyMsg,), {"_type": type_, "_md5sum": md5, "_full_text": text})


def _import_rospy() -> Any:
    """rospy: of the ROS that is sourced, else of the system's packages, which then stand last on the path.

    It listens on the loopback only, where the master is on this machine and nothing else was said.
    """
    master = urlsplit(os.environ.get("ROS_MASTER_URI", "http://localhost:11311")).hostname or ""
    if master in ("localhost", "127.0.0.1", "::1") and not {"ROS_IP", "ROS_HOSTNAME"} & os.environ.keys():
        os.environ["ROS_HOSTNAME"] = "localhost"
    if find_spec("rospy") is None and (DEBIAN / "rospy").is_dir():
        sys.path.append(str(DEBIAN))
        importlib.invalidate_caches()
    try:
        return importlib.import_module("rospy")
    except ImportError as error:
        raise OptionError(
            f"ros1: no rospy here ({error}): source ROS 1's setup.bash, or on Debian apt-get install python3-rospy"
        ) from None


class Ros2Transport(Transport):
    """A ROS 2 node in a context of its own; an OptionError without rclpy, or in a distribution that is not known.

    It speaks the definitions of the distribution that is sourced; packages of other messages than ROS 2's own
    (kinecast_msgs, moveit_msgs, zed_msgs) must be built or installed there.
    """

    def __init__(self) -> None:
        try:
            self._rclpy = importlib.import_module("rclpy")
        except ImportError as error:
            raise OptionError(
                f"ros2: no rclpy here ({error}): source ROS 2's setup.bash, or use dds:, which needs no ROS"
            ) from None
        if (distro := os.environ.get("ROS_DISTRO", "")) not in ("humble", "jazzy"):
            raise OptionError(f"ros2: ROS_DISTRO is {distro!r}, expected humble or jazzy")
        super().__init__(messages_of(Distribution(distro)))
        self._context = self._rclpy.Context()
        self._rclpy.init(context=self._context)
        self._node = self._rclpy.create_node(NODE, context=self._context)
        self._qos = importlib.import_module("rclpy.qos")
        self._executor = importlib.import_module("rclpy.executors").SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._thread = threading.Thread(target=self._executor.spin, name=NODE, daemon=True)
        self._thread.start()

    def subscribe(self, topic: str, type_: str, callback: Callback) -> None:
        qos = self._qos.qos_profile_sensor_data
        if topic == "/tf_static":
            qos = self._qos.QoSProfile(depth=100, durability=self._qos.DurabilityPolicy.TRANSIENT_LOCAL)
        class_ = _message_class(type_)
        self._node.create_subscription(class_, topic, lambda content: callback(topic, bytes(content)), qos, raw=True)

    def create_publisher(self, topic: str, type_: str) -> Callable[[bytes], None]:
        publish: Callable[[bytes], None] = self._node.create_publisher(_message_class(type_), topic, QUEUE2).publish
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
