"""Bytes of ROS messages, by the definitions of a distribution: the wire format of ROS 1 or CDR.

Definitions of common packages are those of rosbags. Those of moveit_msgs and its dependencies, of tf2_msgs and of the
ZED camera are in `definitions/`, fields only; kinecast's own package is `kinecast_msgs/`. Sources: moveit/moveit_msgs,
OctoMap/octomap_msgs, wg-perception/object_recognition_msgs, ros/geometry2, stereolabs/zed-ros-interfaces and
zed-ros2-interfaces.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from enum import Enum
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.msg import denormalize_msgtype, normalize_msgtype
from rosbags.typesys.store import Typestore

from kinecast.live.message import MessageError

__all__ = ["LARGEST", "Distribution", "Messages", "messages_of"]

LARGEST = 1 << 20
"""Bytes of a message that is read; a ZED camera's has 2 kB a person."""
LONGEST = 10_000
"""Elements of a sequence that is read."""

_HERE = Path(__file__).parent


class Distribution(Enum):
    """A release of ROS whose definitions are used."""

    NOETIC = "noetic"
    HUMBLE = "humble"
    JAZZY = "jazzy"

    @property
    def generation(self) -> int:
        """1 or 2."""
        return 1 if self is Distribution.NOETIC else 2


_STORES = {
    Distribution.NOETIC: Stores.ROS1_NOETIC,
    Distribution.HUMBLE: Stores.ROS2_HUMBLE,
    Distribution.JAZZY: Stores.ROS2_JAZZY,
}


@cache
def messages_of(distribution: Distribution) -> Messages:
    """The messages of a distribution, read once."""
    return Messages(distribution)


class Messages:
    """Bytes from fields, and objects from bytes.

    Args:
        distribution: whose definitions are used.
    """

    def __init__(self, distribution: Distribution) -> None:
        self.distribution = distribution
        self.store: Typestore = get_typestore(_STORES[distribution])
        self.store.max_sequence_length = LONGEST
        self.store.register(_definitions(distribution))
        self._builders: dict[str, Callable[[Mapping[str, Any]], Any]] = {}

    def knows(self, type_: str) -> bool:
        """Whether there is a definition of `package/Type`."""
        return normalize_msgtype(type_) in self.store.fielddefs if "/" in type_ else False

    def encode(self, type_: str, fields: Mapping[str, Any]) -> bytes:
        """A message.

        Args:
            type_: `package/Type`.
            fields: values by name; those left out are zero, empty, or false. Fields of a message type are mappings
                themselves; a time or duration is a number of seconds.

        Raises:
            KeyError: a type or field that is not defined.
        """
        name = normalize_msgtype(type_)
        content = self._builder(name)(fields)
        if self.distribution.generation == 1:
            return bytes(self.store.serialize_ros1(content, name))
        return bytes(self.store.serialize_cdr(content, name))

    def decode(self, type_: str, content: bytes) -> Any:
        """An object with the fields of a message.

        Args:
            type_: `package/Type`, one that is known.
            content: from anywhere; nothing in it is trusted.

        Raises:
            MessageError: it is no such message, or larger than `LARGEST`; nothing else is ever raised.
        """
        if len(content) > LARGEST:
            raise MessageError(f"{len(content)} bytes, at most {LARGEST} are taken")
        name = normalize_msgtype(type_)
        try:
            if self.distribution.generation == 1:
                return self.store.deserialize_ros1(content, name)
            return self.store.deserialize_cdr(content, name)
        except Exception as error:
            raise MessageError(f"no {denormalize_msgtype(name)}: {str(error)[:200]}") from None

    def prepare(self, type_: str) -> None:
        """Makes now what else the first message would wait for."""
        self.decode(type_, self.encode(type_, {}))

    def definition(self, type_: str) -> tuple[str, str]:
        """Text of a message's definition with all it is made of, and its hash: MD5 in ROS 1, RIHS01 in ROS 2."""
        name = normalize_msgtype(type_)
        text, md5 = self.store.generate_msgdef(name, ros_version=self.distribution.generation)
        return text, md5 if self.distribution.generation == 1 else self.store.hash_rihs01(name)

    def _builder(self, name: str) -> Callable[[Mapping[str, Any]], Any]:
        """Makes a rosbags object of a message's fields; made once for each type."""
        if name not in self._builders:
            parts = [(field, *self._part(*kind)) for field, kind in self.store.fielddefs[name][1]]
            known = frozenset(field for field, _, _ in parts)
            class_ = self.store.types[name]

            def build(fields: Mapping[str, Any]) -> Any:
                if not known.issuperset(fields):
                    raise KeyError(f"{name} has no {', '.join(sorted(fields.keys() - known))}")
                return class_(*[make(fields[field]) if field in fields else empty for field, make, empty in parts])

            self._builders[name] = build
        return self._builders[name]

    def _part(self, node: Nodetype, kind: Any) -> tuple[Callable[[Any], Any], Any]:
        """What makes a field of a value, and the field without one."""
        if node == Nodetype.NAME:
            build = self._builder(kind)
            if kind in _CLOCKS:
                return (lambda value: build(_clock(value))), build({})
            return build, build({})
        if node == Nodetype.BASE:
            make = _PLAIN[kind[0]]
            return make, make()
        (part, of), length = kind
        length = length if node == Nodetype.ARRAY else 0
        if part == Nodetype.NAME or of[0] == "string":
            make, empty = self._part(part, of)
            return (lambda values: [make(each) for each in values]), [empty] * length
        dtype = _DTYPES.get(of[0], of[0])
        return (lambda values: np.asarray(values, dtype)), np.zeros(length, dtype)


_CLOCKS = ("builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration")
_PLAIN: dict[str, Any] = {"string": str, "bool": bool, "float32": float, "float64": float, "byte": int, "char": int} | {
    f"{sign}int{bits}": int for sign in ("", "u") for bits in (8, 16, 32, 64)
}
_DTYPES = {"byte": "uint8", "char": "uint8"}


def _clock(seconds: float) -> dict[str, int]:
    """Seconds as a time or duration, to the nanosecond."""
    whole = math.floor(seconds)
    carry, part = divmod(round((seconds - whole) * 1e9), 1_000_000_000)
    return {"sec": whole + carry, "nanosec": part}


def _definitions(distribution: Distribution) -> dict[str, Any]:
    def read(name: str, type_: str, package: str = "") -> dict[str, Any]:
        text = (_HERE / "definitions" / f"{name}.msg").read_text()
        return dict(get_types_from_msg(text.replace("zed_interfaces/", package or "zed_interfaces/"), type_))

    types = read("moveit_msgs", "moveit_msgs/msg/PlanningScene") | read("tf2_msgs", "tf2_msgs/msg/TFMessage")
    if distribution.generation == 1:
        types |= read("zed_interfaces_18", "zed_interfaces/msg/ObjectsStamped")
    else:
        types |= read("zed_interfaces", "zed_interfaces/msg/ObjectsStamped")
        types |= read("zed_interfaces", "zed_msgs/msg/ObjectsStamped", "zed_msgs/")
    for path in sorted((_HERE / "kinecast_msgs" / "msg").glob("*.msg")):
        types |= get_types_from_msg(path.read_text(), f"kinecast_msgs/msg/{path.stem}")
    return types
