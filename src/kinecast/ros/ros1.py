"""A ROS 1 node: rospy carries the bytes, so that no message package needs to be built or installed beside it."""

from __future__ import annotations

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
from kinecast.ros.transport import Callback, Transport

DEBIAN = Path("/usr/lib/python3/dist-packages")
"""Where Debian and Ubuntu keep the system's Python packages, rospy among them."""
NODE = "kinecast"
QUEUE = 50  # messages that wait for a slow subscriber; rospy drops the oldest of more

_open = 0
_lock = threading.Lock()


class Ros1Transport(Transport):
    """A node of its own name; one for all transports of this process.

    Raises:
        OptionError: no rospy, or no master answers.
    """

    def __init__(self) -> None:
        global _open
        super().__init__(messages_of(Distribution.NOETIC))
        self._rospy = _import_rospy()
        rosgraph = importlib.import_module("rosgraph")
        if not rosgraph.is_master_online():
            raise OptionError(f"ros1: no master answers at {rosgraph.get_master_uri()}; start roscore")
        with _lock:
            if not self._rospy.core.is_initialized():
                self._rospy.init_node(
                    NODE, anonymous=True, disable_rosout=True, disable_signals=True, log_level=self._rospy.ERROR
                )
            _open += 1
        self._registered: list[Any] = []

    def subscribe(self, topic: str, type_: str, callback: Callback) -> None:
        def take(message: Any) -> None:
            callback(topic, message._buff)

        class_ = self._message_class(type_)
        self._registered.append(self._rospy.Subscriber(topic, class_, take, queue_size=QUEUE, tcp_nodelay=True))

    def create_publisher(self, topic: str, type_: str) -> Callable[[bytes], None]:
        class_ = self._message_class(type_)
        publisher = self._rospy.Publisher(topic, class_, queue_size=QUEUE, tcp_nodelay=True)
        self._registered.append(publisher)
        return lambda content: publisher.publish(class_().deserialize(content))

    def now(self) -> float:
        """The ROS clock [s]; simulated where the parameter /use_sim_time says so."""
        return float(self._rospy.get_time())

    def close(self) -> None:
        global _open
        for each in self._registered:
            each.unregister()
        with _lock:
            _open -= 1
            if not _open:
                self._rospy.signal_shutdown("ended")

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
