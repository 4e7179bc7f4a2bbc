"""Bytes of ROS messages, by the definitions of a distribution: the wire format of ROS 1 or CDR, made by rosbags.

Definitions of common packages are those of rosbags, others are in `definitions/`, kinecast's own in `kinecast_msgs/`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
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

LARGEST = 1 << 20  # bytes of a message that is read; a ZED camera's has 2 kB a person
LONGEST = 10_000  # elements of a sequence that is read

_HERE = Path(__file__).parent
_CLOCKS = ("builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration")
_PLAIN: dict[str, type] = {"string": str, "bool": bool, "float32": float, "float64": float}  # all others are int


class Distribution(Enum):
    """A release of ROS whose definitions are used."""

    NOETIC = "noetic"
    HUMBLE = "humble"
    JAZZY = "jazzy"


class Messages:
    """Bytes from fields, and objects from bytes, by the definitions of a distribution. A type is `package/Type`."""

    def __init__(self, distribution: Distribution) -> None:
        first = distribution is Distribution.NOETIC
        self.store: Typestore = get_typestore(Stores[f"ROS{1 if first else 2}_{distribution.name}"])
        self.store.max_sequence_length = LONGEST
        self.store.register(_definitions(first))
        self._known: dict[str, dict[str, tuple[Any, Any]]] = {}  # of each type, its fields: kind, and empty value
        if first:
            self._serialize, self._deserialize = self.store.serialize_ros1, self.store.deserialize_ros1
        else:
            self._serialize, self._deserialize = self.store.serialize_cdr, self.store.deserialize_cdr

    def encode(self, type_: str, fields: Mapping[str, Any]) -> bytes:
        """A message from values by name; those left out are zero, empty, or false.

        Fields of a message type are mappings themselves; a time or duration is a number of seconds. A KeyError for a
        type or field that is not defined.
        """
        name = normalize_msgtype(type_)
        return bytes(self._serialize(self._object(name, fields), name))

    def decode(self, type_: str, content: bytes) -> Any:
        """An object with the fields of a message of a known type; nothing in its bytes is trusted.

        A MessageError where it is no such message, or larger than `LARGEST`; nothing else is ever raised.
        """
        if len(content) > LARGEST:
            raise MessageError(f"{len(content)} bytes, at most {LARGEST} are taken")
        name = normalize_msgtype(type_)
        try:
            return self._deserialize(content, name)
        except Exception as error:
            raise MessageError(f"no {denormalize_msgtype(name)}: {str(error)[:200]}") from None

    def prepare(self, type_: str) -> None:
        """Makes now what else the first message would wait for."""
        self.decode(type_, self.encode(type_, {}))

    def _object(self, name: str, fields: Mapping[str, Any]) -> Any:
        """rosbags' object of a message."""
        if name not in self._known:
            kinds = dict(self.store.fielddefs[name][1])
            self._known[name] = {field: (kind, self._value(kind, None)) for field, kind in kinds.items()}
        known = self._known[name]
        if unknown := fields.keys() - known.keys():
            raise KeyError(f"{name} has no {', '.join(sorted(unknown))}")
        return self.store.types[name](*[
            self._value(kind, fields[field]) if field in fields else empty for field, (kind, empty) in known.items()
        ])  # fmt: skip

    def _value(self, kind: Any, value: Any) -> Any:
        """A field of rosbags' object; what it is where nothing is given for None."""
        node, of = kind
        if node == Nodetype.BASE:
            return _PLAIN.get(of[0], int)() if value is None else value
        if node == Nodetype.NAME:
            return self._object(of, {} if value is None else _clock(value) if of in _CLOCKS else value)
        part, length = of
        composed = part[0] == Nodetype.NAME or part[1][0] == "string"
        if value is None:
            value = [None if composed else 0] * (length if node == Nodetype.ARRAY else 0)
        if composed:
            return [self._value(part, each) for each in value]
        return np.asarray(value, "uint8" if part[1][0] in ("byte", "char") else part[1][0])


messages_of = cache(Messages)  # read once


def _clock(seconds: float) -> dict[str, int]:
    """Seconds as a time or duration, to the nanosecond."""
    whole = math.floor(seconds)
    carry, part = divmod(round((seconds - whole) * 1e9), 1_000_000_000)
    return {"sec": whole + carry, "nanosec": part}


def _definitions(first: bool) -> dict[str, Any]:
    """Of the types that rosbags does not have, for ROS 1 or 2."""
    read = {path.stem: path.read_text() for path in (_HERE / "definitions").glob("*.msg")}
    texts = {"moveit_msgs/msg/PlanningScene": read["moveit_msgs"], "tf2_msgs/msg/TFMessage": read["tf2_msgs"]}
    texts["zed_interfaces/msg/ObjectsStamped"] = zed = read["zed_interfaces_18" if first else "zed_interfaces"]
    if not first:
        texts["zed_msgs/msg/ObjectsStamped"] = zed.replace("zed_interfaces/", "zed_msgs/")
    for path in sorted((_HERE / "kinecast_msgs" / "msg").glob("*.msg")):
        texts[f"kinecast_msgs/msg/{path.stem}"] = path.read_text()
    return {name: each for type_, text in texts.items() for name, each in get_types_from_msg(text, type_).items()}
