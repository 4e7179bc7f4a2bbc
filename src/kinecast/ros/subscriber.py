"""Skeleton frames from the messages of one topic, whatever carries them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from kinecast.errors import OptionError
from kinecast.geometry.transforms import apply
from kinecast.live.message import MessageError, SkeletonMessage, skeleton_frame
from kinecast.ros.messages import Messages
from kinecast.ros.ros4hri import BodyFrames, from_joint_state
from kinecast.ros.skeletons import from_markers, from_poses, from_zed, joint_order
from kinecast.ros.tf import TransformTree
from kinecast.types import SkeletonFrame

TF_TYPE = "tf2_msgs/TFMessage"
POSES, MARKERS, JOINT_STATE = "geometry_msgs/PoseArray", "visualization_msgs/MarkerArray", "sensor_msgs/JointState"
INPUTS = (TF_TYPE, POSES, MARKERS, JOINT_STATE, "zed_interfaces/ObjectsStamped", "zed_msgs/ObjectsStamped")
"""Types that skeletons are read from."""
TALLEST = 2.5


@dataclass(frozen=True)
class InputOptions:
    """What messages do not say themselves.

    Attributes:
        joints: order of the joints in PoseArray, and in MarkerArray where texts do not name them: see `joint_order`.
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
    plain = "TFMessage" if text.upper() == "TF" else text.replace("/msg/", "/")
    for type_ in INPUTS:
        if plain in (type_, type_.rpartition("/")[2]):
            return type_
    raise OptionError(f"type {text!r}: skeletons are read from {', '.join(INPUTS)}")


class SkeletonSubscriber:
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
        if type_ == POSES and not options.joints:
            raise OptionError(f"{topic}: say which joint each pose is of, by joints=COCO 17 or joints=left_wrist,…")
        self._type = type_
        self._options = options
        self._order = joint_order(options.joints) if options.joints else []
        self._tree = TransformTree()
        self._bodies = BodyFrames(self._tree, options.frame)
        self.topics = {topic: type_}
        if options.frame or type_ in (TF_TYPE, JOINT_STATE):
            self.topics |= {"/tf": TF_TYPE, "/tf_static": TF_TYPE}

    def read(self, messages: Messages, topic: str, content: bytes) -> Iterator[SkeletonFrame | MessageError]:
        """Frames of a message, or what is wrong with it or with one of them; nothing is raised.

        Args:
            messages: read it.
            topic: one of `topics`.
            content: of the message.
        """
        try:
            found = self._skeletons(topic, messages.decode(self.topics[topic], content))
        except MessageError as problem:
            yield problem
            return
        for each in found:
            try:
                yield self._in_frame(skeleton_frame(each))
            except MessageError as problem:
                yield problem

    def _skeletons(self, topic: str, message: Any) -> list[SkeletonMessage]:
        options, type_ = self._options, self.topics[topic]
        if type_ == TF_TYPE:
            fixed = topic.endswith("tf_static")
            if self._type == TF_TYPE:
                return self._bodies.update(message, fixed)
            self._tree.update(message, fixed)
            return []
        if type_ == POSES:
            return from_poses(message, self._order, options.person)
        if type_ == MARKERS:
            return from_markers(message, self._order)
        if type_ == JOINT_STATE:
            return from_joint_state(message, self._tree, options.frame, options.height)
        return from_zed(message)

    def _in_frame(self, frame: SkeletonFrame) -> SkeletonFrame:
        """The same in the frame that was asked for.

        Raises:
            MessageError: TF does not know it, or not lately.
        """
        within = self._options.frame
        if not within or frame.frame_id == within:
            return frame
        found = self._tree.lookup(frame.frame_id, within, frame.stamp)
        return replace(frame, positions=np.asarray(apply(found.T, frame.positions)), frame_id=within)
