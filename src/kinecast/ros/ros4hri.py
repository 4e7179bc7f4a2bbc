"""Persons as ROS4HRI (REP-155) has them: TF frames named after a body, or joint angles of its kinematic model.

Source: https://www.ros.org/reps/rep-0155.html; proportions and axes of the model as in ros4hri/human_description,
urdf/human-tpl.xacro.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float

from kinecast.body.skeleton import ARM_JOINTS
from kinecast.geometry.transforms import apply, rotation_x, rotation_y, rotation_z
from kinecast.live.message import MessageError, SkeletonMessage
from kinecast.ros.tf import STALE, UNSEEN, Position, TransformTree, seconds

MOST_PERSONS = 64  # in one message, or begun
_SIDED = ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")
# Frames of a body, without its id, and the joints at their origins.
FRAMES = {"body": "pelvis", "torso": "collar", "head": "head"}
FRAMES |= {f"{side[0]}_{joint}": f"{side}_{joint}" for side in ("left", "right") for joint in _SIDED}
_FRAME = re.compile(rf"({'|'.join(FRAMES)})_(.+)")
_ARMS = tuple(frame for frame, joint in FRAMES.items() if joint in ARM_JOINTS)
_ANGLES = ("y_shoulder", "p_shoulder", "r_shoulder", "elbow")


class BodyFrames:
    """Skeletons from TF, within a frame or "": one of a body whenever its arms' frames are all there for a new stamp.

    A body whose frames come in several messages is complete with the last one; where one of them is missing, it
    follows with the next stamp, the joint not seen.
    """

    def __init__(self, tree: TransformTree, within: str) -> None:
        self._tree = tree
        self._within = within
        self._due: dict[str, float] = {}

    def update(self, message: Any, fixed: bool) -> list[SkeletonMessage]:
        """Takes a tf2_msgs/TFMessage into the tree: bodies that it completes, or begins anew before they were."""
        bodies: dict[str, float] = {}  # of which the message moves a frame, and the newest stamp of each [s]
        for each in message.transforms:
            if match := _FRAME.fullmatch(each.child_frame_id.lstrip("/")):
                bodies[match[2]] = max(bodies.get(match[2], -np.inf), seconds(each.header.stamp))
        late = [body for body, stamp in bodies.items() if self._due.get(body, np.inf) < stamp]
        found = [self._skeleton(body, self._due.pop(body)) for body in late]
        self._tree.update(message, fixed)
        for body, stamp in bodies.items():
            arms = [f"{arm}_{body}" for arm in _ARMS]
            known = all(arm in self._tree for arm in arms)
            if known and min(self._tree.lookup(arm, self._within).newest for arm in arms) >= stamp:
                self._due.pop(body, None)
                found.append(self._skeleton(body, stamp))
            elif len(self._due) < MOST_PERSONS or body in self._due:
                self._due[body] = stamp
            else:
                raise MessageError(f"more than {MOST_PERSONS} bodies whose arms are not all there")
        return found

    def _skeleton(self, body: str, stamp: float) -> SkeletonMessage:
        positions: dict[str, Position] = dict.fromkeys(ARM_JOINTS, UNSEEN)
        within = self._within
        for frame, joint in FRAMES.items():
            if (name := f"{frame}_{body}") in self._tree:
                found = self._tree.lookup(name, within)
                within = found.within
                if found.oldest >= stamp - STALE:
                    positions[joint] = found.T[:3, 3].tolist()
        places, joints = list(positions.values()), list(positions)
        return SkeletonMessage(stamp, places, joints=joints, person=body, frame_id=within or "world")


def from_joint_state(message: Any, tree: TransformTree, within: str, height: float) -> list[SkeletonMessage]:
    """A person of a height [m] from a sensor_msgs/JointState and the frame `body_<id>` in the tree, within a frame."""
    bodies = {match[1] for name in message.name if (match := re.fullmatch(r"[lr]_elbow_(.+)", name))}
    if len(bodies) != 1 or len(message.position) != len(message.name):
        raise MessageError("joint states of one body are expected: l_elbow_<id>, …, and a position for each")
    (body,) = bodies
    angles = dict(zip((name.removesuffix(f"_{body}") for name in message.name), message.position, strict=True))
    stamp = seconds(message.header.stamp)
    found = tree.lookup(f"body_{body}", within, stamp)
    joints = body_joints(angles, height)
    positions: list[Position] = apply(found.T, np.stack(list(joints.values()))).tolist()
    return [SkeletonMessage(stamp, positions, joints=list(joints), person=body, frame_id=found.within)]


def body_joints(angles: Mapping[str, float], height: float) -> dict[str, Float[np.ndarray, "3"]]:
    """Joints in the frame of a body [m], x forward, z up, by the kinematic model of ROS4HRI.

    All lengths are shares of the person's height [m]. Angles [rad] are of `waist` (0 where missing) and of both arms'
    `y_shoulder`, `p_shoulder`, `r_shoulder` and `elbow`, with `l_` or `r_` before them (else a MessageError).
    """
    unit = height / 7.5
    R_torso = rotation_y(angles.get("waist", 0.0))
    joints = {"pelvis": np.zeros(3), "collar": R_torso @ [0.0, 0.0, 2.75 * unit]}
    for side, sign in (("left", 1.0), ("right", -1.0)):
        try:
            yaw, pitch, roll, bend = (angles[f"{side[0]}_{each}"] for each in _ANGLES)
        except KeyError as missing:
            raise MessageError(f"joint states without {missing}") from None
        R_upper = R_torso @ rotation_z(-sign * yaw) @ rotation_x(sign * pitch) @ rotation_z(sign * roll)
        shoulder = R_torso @ [0.0, sign * 0.8 * unit, 2.75 * unit]
        elbow = shoulder + R_upper @ [0.0, 0.0, -1.6 * unit]
        wrist = elbow + R_upper @ rotation_y(-bend) @ [0.0, 0.0, -unit]
        joints |= {f"{side}_shoulder": shoulder, f"{side}_elbow": elbow, f"{side}_wrist": wrist}
        joints[f"{side}_hip"] = np.array([0.0, sign * 0.6 * unit, 0.0])
    return joints
