"""Skeleton frames from the messages of one source, whatever carries them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from kinecast.errors import OptionError
from kinecast.geometry.transforms import apply
from kinecast.live.message import MessageError, SkeletonMessage, skeleton_frame
from kinecast.ros.frames import STALE, FrameTree
from kinecast.ros.messages import Messages
from kinecast.ros.ros4hri import BodyFrames, from_joint_state
from kinecast.ros.skeletons import JointOrder, from_markers, from_poses, from_zed
from kinecast.types import SkeletonFrame

__all__ = ["INPUTS", "TF_TYPE", "Incoming", "InputOptions", "input_type"]

TF_TYPE = "tf2_msgs/TFMessage"
_SHORT = {"PoseArray": "geometry_msgs", "MarkerArray": "visualization_msgs", "JointState": "sensor_msgs"}
INPUTS = (
    TF_TYPE,
    *(f"{package}/{name}" for name, package in _SHORT.items()),
    "zed_interfaces/ObjectsStamped",
    "zed_msgs/ObjectsStamped",
)
"""Types that skeletons are read from."""
TALLEST = 2.5


@dataclass(frozen=True)
class InputOptions:
    """What messages do not say themselves.

    Attributes:
        joints: order of the joints in PoseArray, and in MarkerArray where texts do not name them: see `JointOrder`.
        person: of a PoseArray.
        frame: that positions are carried into by TF; "" leaves them as they come.
        height: of the person whose joint states are read [m].
    """

    joints: str = ""
    person: str = "0"
    frame: str = ""
    height: float = 1.65

    def __post_init__(self) -> None:
        if not 0.5 <= self.height <= TALLEST:
            raise OptionError(f"height {self.height:g} m is outside 0.5..{TALLEST} m")


def input_type(text: str) -> str:
    """`package/Type` of what was written: `PoseArray`, `geometry_msgs/PoseArray`, `geometry_msgs/msg/PoseArray`, `TF`.

    Raises:
        OptionError: skeletons are not read from it.
    """
    plain = text.replace("/msg/", "/")
    known = {each.rpartition("/")[2]: each for each in reversed(INPUTS)} | {each: each for each in INPUTS}
    found = known.get("TFMessage" if plain.upper() == "TF" else plain)
    if found is None:
        raise OptionError(f"type {text!r}: skeletons are read from {', '.join(INPUTS)}")
    return found


class Incoming:
    """Reads messages of one topic, and of TF where that is needed.

    Args:
        topic: with skeletons.
        type_: of its messages, one of `INPUTS`.
        options: see there.

    Attributes:
        topics: to subscribe to, with the type of each.

    Raises:
        OptionError: a PoseArray whose joints are not stated.
    """

    def __init__(self, topic: str, type_: str, options: InputOptions) -> None:
        if type_ == "geometry_msgs/PoseArray" and not options.joints:
            raise OptionError(f"{topic}: say which joint each pose is of, by joints=COCO 17 or joints=left_wrist,…")
        self._topic = topic
        self._options = options
        self._tree = FrameTree()
        self._bodies = BodyFrames(self._tree, options.frame or None)
        self._convert = self._conversion(type_)
        self.topics = {topic: type_}
        if options.frame or type_ in (TF_TYPE, "sensor_msgs/JointState"):
            self.topics |= {"/tf": TF_TYPE, "/tf_static": TF_TYPE}

    def read(self, topic: str, message: Any) -> Iterator[SkeletonFrame | MessageError]:
        """Frames of a message, or what is wrong with it or with one of them; nothing is raised.

        Args:
            topic: one of `topics`.
            message: as decoded.
        """
        try:
            found = self._messages(topic, message)
        except MessageError as problem:
            yield problem
            return
        for each in found:
            try:
                yield self._carried(skeleton_frame(each))
            except MessageError as problem:
                yield problem

    def read_bytes(self, messages: Messages, topic: str, content: bytes) -> Iterator[SkeletonFrame | MessageError]:
        """As `read`, of a message that is bytes still."""
        try:
            message = messages.decode(self.topics[topic], content)
        except MessageError as problem:
            yield problem
        else:
            yield from self.read(topic, message)

    def _messages(self, topic: str, message: Any) -> list[SkeletonMessage]:
        if self.topics[topic] != TF_TYPE:
            return self._convert(message)
        wanted = self.topics[self._topic] == TF_TYPE
        found = self._bodies.before(message) if wanted else []
        self._tree.update(message, fixed=topic.endswith("tf_static"))
        return found + self._bodies.after(message) if wanted else found

    def _conversion(self, type_: str) -> Callable[[Any], list[SkeletonMessage]]:
        options = self._options
        order = JointOrder(options.joints) if options.joints else None
        conversions: Mapping[str, Callable[[Any], list[SkeletonMessage]]] = {
            "visualization_msgs/MarkerArray": lambda message: from_markers(message, order),
            "sensor_msgs/JointState": lambda message: from_joint_state(
                message, self._tree, options.frame or None, options.height
            ),
        }
        if type_ == "geometry_msgs/PoseArray" and order is not None:
            return lambda message: from_poses(message, order, options.person)
        return conversions.get(type_, from_zed)

    def _carried(self, frame: SkeletonFrame) -> SkeletonFrame:
        """The same in the frame that was asked for.

        Raises:
            MessageError: TF does not know it, or not lately.
        """
        within = self._options.frame
        if not within or frame.frame_id == within:
            return frame
        found = self._tree.find(frame.frame_id, within)
        if found.oldest < frame.stamp - STALE:
            age = frame.stamp - found.oldest
            raise MessageError(f"TF said {age:.1f} s before where {frame.frame_id!r} is in {within!r}")
        return replace(frame, positions=np.asarray(apply(found.T, frame.positions)), frame_id=within)
