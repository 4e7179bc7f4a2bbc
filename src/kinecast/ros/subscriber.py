"""Skeleton frames from the messages of one topic, whatever carries them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Annotated, Any

from msgspec import Meta

from kinecast.body.skeleton import ARM_JOINTS, JOINTS, SKELETONS
from kinecast.errors import OptionError
from kinecast.geometry.transforms import apply
from kinecast.live.message import MOST_JOINTS, MessageError, SkeletonMessage, skeleton_frame
from kinecast.live.sender_guard import SenderOptions
from kinecast.ros.messages import Messages
from kinecast.ros.ros4hri import MOST_PERSONS, BodyFrames, from_joint_state
from kinecast.ros.tf import UNSEEN, Position, TransformTree, point, seconds
from kinecast.types import SkeletonFrame

TF_TYPE = "tf2_msgs/TFMessage"
POSES, MARKERS, JOINT_STATE = "geometry_msgs/PoseArray", "visualization_msgs/MarkerArray", "sensor_msgs/JointState"
INPUTS = (TF_TYPE, POSES, MARKERS, JOINT_STATE, "zed_interfaces/ObjectsStamped", "zed_msgs/ObjectsStamped")
CUBE, SPHERE, SPHERE_LIST, POINTS = 1, 2, 7, 8  # types of visualization_msgs/Marker that stand for joints
DELETE, DELETEALL = 2, 3

_KNOWN = {each.name: list(each.joints) for each in SKELETONS}
# Sources: the ZED SDK's BODY_FORMAT, BODY_18_PARTS, BODY_34_PARTS and BODY_38_PARTS. A name that kinecast does not know
# is left out.
_ZED_18, _ZED_38 = map(str.split, (
    """nose neck right_shoulder right_elbow right_wrist left_shoulder left_elbow left_wrist right_hip right_knee
    right_ankle left_hip left_knee left_ankle right_eye left_eye right_ear left_ear""",
    """pelvis lumbar spine chest neck nose left_eye right_eye left_ear right_ear left_clavicle right_clavicle
    left_shoulder right_shoulder left_elbow right_elbow left_wrist right_wrist left_hip right_hip left_knee right_knee
    left_ankle right_ankle left_foot right_foot left_small_toe right_small_toe left_heel right_heel left_thumb
    right_thumb left_index right_index left_middle right_middle left_pinky right_pinky""",
))  # fmt: skip
_ZED_FORMATS = {0: _ZED_18, 1: _KNOWN["ZED 34"], 2: _ZED_38}


@dataclass(frozen=True)
class InputOptions(SenderOptions):
    """What messages do not say themselves, and their type (`input_type`)."""

    type: str = ""
    joints: str = ""
    """Order in PoseArray, and in MarkerArray where texts do not name them: a skeleton, or names with commas."""
    person: str = "0"  # of a PoseArray
    frame: str = ""  # that positions are carried into by TF; "" leaves them as they come
    height: Annotated[float, Meta(ge=0.5, le=2.5)] = 1.65  # of the person whose joint states are read [m]


def input_type(topic: str, text: str) -> str:
    """`package/Type` of what was written: `PoseArray`, `geometry_msgs/PoseArray`, `geometry_msgs/msg/PoseArray`, `TF`.

    An OptionError where skeletons are not read from it, or it is not told of a topic that is not TF's.
    """
    if not topic.startswith("/"):
        raise OptionError(f"{topic!r}: a topic such as /skeletons is expected")
    text = text or ("TF" if topic in ("/tf", "/tf_static") else "")
    if not text:
        raise OptionError(f"{topic}: say of which type the messages are, such as type=PoseArray")
    plain = "TFMessage" if text.upper() == "TF" else text.replace("/msg/", "/")
    for type_ in INPUTS:
        if plain in (type_, type_.rpartition("/")[2]):
            return type_
    raise OptionError(f"type {text!r}: skeletons are read from {', '.join(INPUTS)}")


class SkeletonSubscriber:
    """Reads messages of one topic of a type of `INPUTS`, and of TF where that is needed: `topics` and their types.

    An OptionError for a PoseArray whose joints are not stated.
    """

    def __init__(self, topic: str, type_: str, options: InputOptions) -> None:
        if type_ == POSES and not options.joints:
            raise OptionError(f"{topic}: say which joint each pose is of, by joints=COCO 17 or joints=left_wrist,…")
        self._type = type_
        self._options = options
        self._order = _joint_order(options.joints) if options.joints else []
        self._within = options.frame.lstrip("/")
        self._tree = TransformTree()
        self._bodies = BodyFrames(self._tree, self._within)
        self.topics = {topic: type_}
        if self._within or type_ in (TF_TYPE, JOINT_STATE):
            self.topics |= {"/tf": TF_TYPE, "/tf_static": TF_TYPE}

    def read(self, messages: Messages, topic: str, content: bytes) -> Iterator[SkeletonFrame | MessageError]:
        """Frames of a message on one of the topics, or what is wrong with it or one of them; nothing is raised."""
        try:
            found = self._skeletons(topic, messages.decode(self.topics[topic], content))
        except MessageError as problem:
            yield problem
            return
        within = self._within
        for each in found:
            try:
                frame = skeleton_frame(each)
                if within and frame.frame_id != within:
                    T = self._tree.lookup(frame.frame_id, within, frame.stamp).T
                    frame = replace(frame, positions=apply(T, frame.positions), frame_id=within)
                yield frame
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
            positions = [point(pose.position) for pose in message.poses]
            return [_skeleton(message.header, positions, self._order, options.person)]
        if type_ == MARKERS:
            return _from_markers(message, self._order)
        if type_ == JOINT_STATE:
            return from_joint_state(message, self._tree, self._within, options.height)
        return _from_zed(message)


def _joint_order(text: str) -> list[str]:
    """Joints of a skeleton's name, such as `COCO 17`, or with commas between them; unknown ones are left out."""
    names = _KNOWN.get(text) or [name.strip() for name in text.split(",")]
    if text not in _KNOWN and not set(names) & set(JOINTS):
        known = f"a skeleton ({', '.join(_KNOWN)}) or joints such as left_wrist,left_elbow"
        raise OptionError(f"joints {text!r}: expected {known}")
    return names


def _from_markers(message: Any, order: list[str]) -> list[SkeletonMessage]:
    """Every person in a visualization_msgs/MarkerArray.

    A person's markers have one namespace: either a sphere or cube for each joint, whose id is its place in the stated
    order or whose text is its name, or one list of spheres or points in that order. Without a namespace, id // 100 is
    the person and id % 100 the place, as Azure Kinect's driver has it. Other markers are passed over.
    """
    persons: dict[str, dict[str, Position]] = {}
    headers: dict[str, Any] = {}
    for marker in message.markers:
        if marker.action in (DELETE, DELETEALL) or marker.type not in (CUBE, SPHERE, SPHERE_LIST, POINTS):
            continue
        person = marker.ns or str(marker.id // 100)
        if headers.setdefault(person, marker.header).frame_id != marker.header.frame_id:
            raise MessageError(f"markers of person {person!r} are in several frames")
        joints = persons.setdefault(person, {})
        if marker.type in (SPHERE_LIST, POINTS):
            joints |= {_joint(order, "", place): point(each) for place, each in enumerate(marker.points)}
        else:
            place = marker.id if marker.ns else marker.id % 100
            joints[_joint(order, marker.text, place)] = point(marker.pose.position)
    if len(persons) > MOST_PERSONS or any(len(joints) > MOST_JOINTS for joints in persons.values()):
        raise MessageError(f"more than {MOST_PERSONS} persons or {MOST_JOINTS} joints")
    found = []
    for person, joints in persons.items():
        names = list(order or dict.fromkeys((*joints, *ARM_JOINTS)))
        found.append(_skeleton(headers[person], [joints.get(name, UNSEEN) for name in names], names, person))
    return found


def _from_zed(message: Any) -> list[SkeletonMessage]:
    """Every tracked person in a zed_interfaces/ObjectsStamped or zed_msgs/ObjectsStamped: 18, 34 or 38 keypoints."""
    if len(message.objects) > MOST_PERSONS:
        raise MessageError(f"{len(message.objects)} objects, at most {MOST_PERSONS} are taken")
    found = []
    for body in message.objects:
        if not body.skeleton_available or body.tracking_state == 0:
            continue
        points = body.skeleton_3d.keypoints
        names = _ZED_18 if len(points) == len(_ZED_18) else _ZED_FORMATS.get(body.body_format)
        if names is None:
            raise MessageError(f"body format {body.body_format} of a ZED camera; 18, 34 and 38 keypoints are known")
        positions: list[Position] = [[float(value) for value in each.kp] for each in points[: len(names)]]
        found.append(_skeleton(message.header, positions, names, str(body.label_id)))
    return found


def _joint(order: list[str], text: str, place: int) -> str:
    """Which joint a marker is of."""
    if text in JOINTS:
        return text
    if not order:
        how = "state joints, or give each its joint's name as text"
        raise MessageError(f"nothing says which joint a marker is of: {how}")
    if not 0 <= place < len(order):
        raise MessageError(f"marker {place} is outside the {len(order)} joints that were stated")
    return order[place]


def _skeleton(header: Any, positions: list[Position], names: list[str], person: str) -> SkeletonMessage:
    frame = header.frame_id.lstrip("/") or "world"
    return SkeletonMessage(seconds(header.stamp), positions, joints=names, person=person, frame_id=frame)
