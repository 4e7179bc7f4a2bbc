"""A ROS 1 node: rospy carries the bytes, so that no message package needs to be built or installed beside it."""

from __future__ import annotations

import importlib
import os
import sys
import threading
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from kinecast.errors import OptionError
from kinecast.ros.carrier import Taker
from kinecast.ros.messages import Distribution, messages_of

__all__ = ["Ros1Carrier", "import_rospy"]

DEBIAN = Path("/usr/lib/python3/dist-packages")
"""Where Debian and Ubuntu keep the system's Python packages, rospy among them."""
NODE = "kinecast"
QUEUE = 50
"""Messages that wait for a slow subscriber; rospy drops the oldest of more."""

_open = 0
_lock = threading.Lock()


def import_rospy() -> Any:
    """rospy: of the ROS that is sourced, else of the system's packages, which then stand last on the path.

    Raises:
        OptionError: there is none, or it does not run with this Python.
    """
    try:
        return importlib.import_module("rospy")
    except ImportError as error:
        first = error
    if (DEBIAN / "rospy").is_dir() and str(DEBIAN) not in sys.path:
        sys.path.append(str(DEBIAN))
        importlib.invalidate_caches()
        try:
            return importlib.import_module("rospy")
        except ImportError as error:
            first = error
    raise OptionError(
        f"ros1: no rospy here ({first}): source ROS 1's setup.bash, or on Debian apt-get install python3-rospy"
    ) from None


class Ros1Carrier:
    """A node of its own name; one for all carriers of this process.

    Raises:
        OptionError: no rospy, or no master answers.
    """

    def __init__(self) -> None:
        global _open
        self.messages = messages_of(Distribution.NOETIC)
        _stay_local()
        self._rospy = import_rospy()
        self._genpy = importlib.import_module("genpy")
        rosgraph = importlib.import_module("rosgraph")
        if not rosgraph.is_master_online():
            raise OptionError(f"ros1: no master answers at {rosgraph.get_master_uri()}; start roscore")
        with _lock:
            if not self._rospy.core.is_initialized():
                self._rospy.init_node(
                    NODE, anonymous=True, disable_rosout=True, disable_signals=True, log_level=self._rospy.ERROR
                )
            _open += 1
        self._classes: dict[str, type] = {}
        self._publishers: dict[str, Any] = {}
        self._subscribers: list[Any] = []

    def subscribe(self, topic: str, type_: str, take: Taker) -> None:
        """See Carrier."""
        self._subscribers.append(
            self._rospy.Subscriber(
                topic, self._class(type_), lambda message: take(topic, message.content), queue_size=QUEUE,
                tcp_nodelay=True,
            )
        )  # fmt: skip

    def advertise(self, topic: str, type_: str) -> None:
        """See Carrier."""
        if topic not in self._publishers:
            class_ = self._class(type_)
            self._publishers[topic] = self._rospy.Publisher(topic, class_, queue_size=QUEUE, tcp_nodelay=True)

    def publish(self, topic: str, type_: str, content: bytes) -> None:
        """See Carrier."""
        self.advertise(topic, type_)
        self._publishers[topic].publish(self._class(type_)(content))

    def now(self) -> float:
        """See Carrier; simulated where the parameter /use_sim_time says so."""
        return float(self._rospy.get_time())

    def close(self) -> None:
        """See Carrier."""
        global _open
        for each in (*self._subscribers, *self._publishers.values()):
            each.unregister()
        with _lock:
            _open -= 1
            if not _open:
                self._rospy.signal_shutdown("ended")

    def _class(self, type_: str) -> type:
        if type_ not in self._classes:
            text, md5 = self.messages.definition(type_)
            self._classes[type_] = _bytes_class(self._genpy.Message, type_, md5, text)
        return self._classes[type_]


def _bytes_class(base: type, type_: str, md5: str, text: str) -> type:
    """A message class for rospy that leaves bytes as they are."""

    class Bytes(base):  # type: ignore[misc]
        __slots__ = ["content"]
        _type, _md5sum, _full_text, _has_header = type_, md5, text, False
        _slot_types = ("uint8[]",)

        def __init__(self, content: bytes = b"") -> None:
            self.content = content

        def serialize(self, buffer: Any) -> None:
            buffer.write(self.content)

        def deserialize(self, content: bytes) -> Any:
            self.content = bytes(content)
            return self

    return Bytes


def _stay_local() -> None:
    """Has rospy listen on the loopback only, where the master is on this machine and nothing else was said."""
    master = urlsplit(os.environ.get("ROS_MASTER_URI", "http://localhost:11311")).hostname or ""
    if master in ("localhost", "127.0.0.1", "::1") and not {"ROS_IP", "ROS_HOSTNAME"} & os.environ.keys():
        os.environ["ROS_HOSTNAME"] = "localhost"
