"""Named skeletons: which joints a source tracks, under which names, in which order.

Inside kinecast a joint is always addressed by its canonical name (`JOINTS`). A source's own names come
in through the alias table of its `Skeleton`.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType

import numpy as np
from jaxtyping import Float

from kinecast.errors import DatasetError
from kinecast.types import SkeletonFrame

ARM_JOINTS = (
    "left_shoulder", "left_elbow", "left_wrist",
    "right_shoulder", "right_elbow", "right_wrist",
)  # fmt: skip
"""The six joints every method predicts, in the order of every (…, 6, 3) array."""

_SIDED = (
    "clavicle", "shoulder", "elbow", "wrist", "hand", "hand_tip", "thumb", "index", "pinky",
    "eye_inner", "eye", "eye_outer", "ear", "mouth", "hip", "knee", "ankle", "heel", "foot",
)  # fmt: skip

JOINTS = (
    "pelvis", "lumbar", "spine", "thorax", "chest", "collar", "neck", "head", "nose",
    *(f"left_{joint}" for joint in _SIDED),
    *(f"right_{joint}" for joint in _SIDED),
)  # fmt: skip
"""Every canonical joint name.

Up the back: pelvis, lumbar (L5), spine (L3, navel), thorax (T12), chest (T8), collar (between the clavicles),
neck. A hand lies past the wrist, a foot is the toe end past the ankle.
"""


def _plain(name: str) -> str:
    """A name without case and separators: `Left Wrist`, `left_wrist` and `LeftWrist` are one."""
    return "".join(letter for letter in name.casefold() if letter.isalnum())


@dataclass(frozen=True)
class Skeleton:
    """The joints one kind of source tracks."""

    name: str  # short, for messages, e.g. "Azure Kinect 32"
    joints: tuple[str, ...]  # canonical, in the order of the source
    aliases: Mapping[str, str]  # the source's own names to canonical ones; several may mean the same joint

    @cached_property
    def _by_plain_name(self) -> dict[str, str]:
        return {_plain(source): joint for source, joint in self.aliases.items()}

    def find(self, source_name: str) -> str | None:
        """Canonical name of a source joint, in any case; None where this skeleton does not know it."""
        return self._by_plain_name.get(_plain(source_name))

    def canonical(self, source_names: Iterable[str], where: object) -> tuple[str, ...]:
        """One canonical name for each source name, in the same order; `where` (file and place) is for the message.

        Raises:
            DatasetError: a name is unknown to this skeleton, or two mean the same joint.
        """
        sources: dict[str, str] = {}
        for source_name in source_names:
            joint = self.find(source_name)
            if joint is None:
                known = ", ".join(self.aliases)
                raise DatasetError(where, f"joint {source_name!r} is unknown; {self.name} has {known}")
            if joint in sources:
                raise DatasetError(where, f"{sources[joint]!r} and {source_name!r} both mean {joint}")
            sources[joint] = source_name
        return tuple(sources)


def without_side(joint: str) -> str:
    """`wrist` for `left_wrist` and `right_wrist`."""
    return joint.removeprefix("left_").removeprefix("right_")


def require_arms(joints: Iterable[str], where: object) -> None:
    """Check that both arms are tracked: shoulder, elbow and wrist of each side; `where` is for the message.

    Raises:
        DatasetError: names the joints that are missing and those there are.
    """
    present = tuple(joints)
    missing = [joint for joint in ARM_JOINTS if joint not in present]
    if missing:
        found = ", ".join(present) or "no joint"
        raise DatasetError(where, f"{', '.join(missing)} missing: both arms are needed; the joints are {found}")


def _skeleton(name: str, table: str, sides: Sequence[str] = ()) -> Skeleton:
    """A skeleton from its table: `source=canonical` in source order, one word where the two are the same.

    A line with `@` is of one side, and is read once for each of `sides`, the source's words for left and right.
    """
    aliases = {}
    for line in table.splitlines():
        for side in sides if "@" in line else ("",):
            for entry in line.split():
                source, _, joint = entry.partition("=")
                canonical = joint or source
                if side:
                    canonical = ("left_" if side[0] in "lL" else "right_") + canonical
                aliases[source.replace("@", side)] = canonical
    return Skeleton(name, tuple(dict.fromkeys(aliases.values())), MappingProxyType(aliases))


# Source: Azure Kinect Body Tracking SDK, joint ids 0 to 31.
AZURE_KINECT_32 = _skeleton("Azure Kinect 32", """
    PELVIS=pelvis SPINE_NAVAL=spine SPINE_CHEST=chest NECK=neck
    CLAVICLE_@=clavicle SHOULDER_@=shoulder ELBOW_@=elbow WRIST_@=wrist HAND_@=hand HANDTIP_@=hand_tip THUMB_@=thumb
    HIP_@=hip KNEE_@=knee ANKLE_@=ankle FOOT_@=foot
    HEAD=head NOSE=nose
    EYE_@=eye EAR_@=ear
""", ("LEFT", "RIGHT"))  # fmt: skip

# Source: HA4M's feature files (UpSkel, ArmSkel).
_HA4M_ARMS = """
    CLAVICLE_@=clavicle SHOULDER_@=shoulder ELBOW_@=elbow WRIST_@=wrist HAND_@=hand HANDTIP_@=hand_tip THUMB_@=thumb
"""
HA4M_ARMS_14 = _skeleton("HA4M arms 14", _HA4M_ARMS, "LR")
HA4M_UPPER_23 = _skeleton("HA4M upper 23", f"""
    SPINE_NAVAL=spine SPINE_CHEST=chest NECK=neck {_HA4M_ARMS}
    HEAD=head NOSE=nose
    EYE_@=eye EAR_@=ear
""", "LR")  # fmt: skip

# Source: Xsens MVN user manual. A segment's origin is its proximal joint, so UpperArm is the shoulder joint.
XSENS_23 = _skeleton("Xsens 23", """
    Pelvis=pelvis L5=lumbar L3=spine T12=thorax T8=chest Neck=neck Head=head
    @Shoulder=clavicle @UpperArm=shoulder @ForeArm=elbow @Hand=wrist
    @UpperLeg=hip @LowerLeg=knee @Foot=ankle @Toe=foot
""", ("Right", "Left"))  # fmt: skip

# Source: COCO keypoint annotations.
COCO_17 = _skeleton("COCO 17", """
    nose left_eye right_eye left_ear right_ear left_shoulder right_shoulder left_elbow right_elbow
    left_wrist right_wrist left_hip right_hip left_knee right_knee left_ankle right_ankle
""")  # fmt: skip

# Source: MediaPipe Pose landmarks 0 to 32.
MEDIAPIPE_33 = _skeleton("MediaPipe 33", """
    nose left_eye_inner left_eye left_eye_outer right_eye_inner right_eye right_eye_outer left_ear right_ear
    mouth_left=left_mouth mouth_right=right_mouth left_shoulder right_shoulder left_elbow right_elbow
    left_wrist right_wrist left_pinky right_pinky left_index right_index left_thumb right_thumb
    left_hip right_hip left_knee right_knee left_ankle right_ankle left_heel right_heel
    left_foot_index=left_foot right_foot_index=right_foot
""")  # fmt: skip

# Source: ZED SDK, BODY_34.
ZED_34 = _skeleton("ZED 34", """
    PELVIS=pelvis NAVAL_SPINE=spine CHEST_SPINE=chest NECK=neck
    @_CLAVICLE=clavicle @_SHOULDER=shoulder @_ELBOW=elbow @_WRIST=wrist @_HAND=hand @_HANDTIP=hand_tip @_THUMB=thumb
    @_HIP=hip @_KNEE=knee @_ANKLE=ankle @_FOOT=foot
    HEAD=head NOSE=nose
    @_EYE=eye @_EAR=ear
    @_HEEL=heel
""", ("LEFT", "RIGHT"))  # fmt: skip

# Source: the human_robot_animations files. Points are marker clusters; the hand's stands for the wrist.
VICON = _skeleton("Vicon bodies", """
    collar head hip=pelvis left_shoulder left_elbow left_hand=left_wrist
    right_shoulder right_elbow right_hand=right_wrist
""")  # fmt: skip

# Source: the KTH handover files. A frame's origin is its proximal joint, so UArm is the shoulder joint.
KTH_13 = _skeleton("KTH 13", """
    hip=pelvis ab=spine chest neck head
    @Shoulder=clavicle @UArm=shoulder @FArm=elbow @Hand=wrist
""", "LR")  # fmt: skip

# Source: the human_assembly_data files, columns in this order.
LEGO_6 = _skeleton("LEGO 6", "left_wrist right_wrist left_elbow right_elbow left_shoulder right_shoulder")

# BVH files name an arm in one of two ways. With Arm and ForeArm, Shoulder is the clavicle; with Elbow,
# Shoulder is the shoulder joint and the clavicle is called Collar.
BVH_FOREARM = _skeleton("BVH forearm", """
    Hips=pelvis LowerBack=lumbar Spine=spine Spine1=thorax Spine2=chest Neck=neck Head=head
    @Shoulder=clavicle @Arm=shoulder @ForeArm=elbow @Hand=wrist
    @UpLeg=hip @Leg=knee @Foot=ankle @Toe=foot @ToeBase=foot
""", ("Left", "Right"))  # fmt: skip
BVH_COLLAR = _skeleton("BVH collar", """
    Hips=pelvis Chest=spine Chest2=thorax Chest3=chest Neck=neck Head=head
    @Collar=clavicle @Shoulder=shoulder @Elbow=elbow @Wrist=wrist @Hand=wrist
    @Hip=hip @Knee=knee @Ankle=ankle @Toe=foot
""", ("Left", "Right"))  # fmt: skip

SKELETONS = (
    AZURE_KINECT_32, HA4M_UPPER_23, HA4M_ARMS_14, XSENS_23, COCO_17, MEDIAPIPE_33, ZED_34, VICON, KTH_13,
    LEGO_6, BVH_FOREARM, BVH_COLLAR,
)  # fmt: skip
"""Every skeleton kinecast knows."""


def arms_of(frame: SkeletonFrame) -> Float[np.ndarray, "6 3"]:
    """(6, 3) the arm joints of a frame [m]; NaN where not seen, or where it has fewer positions than names."""
    return of_arms(frame.joints, np.where(frame.valid[:, None], frame.positions, np.nan))


def of_arms(joints: Sequence[str], values: Float[np.ndarray, "J *n"]) -> Float[np.ndarray, "6 *n"]:
    """What there is of each arm joint; NaN where there is none."""
    arms = np.full((6, *values.shape[1:]), np.nan)
    for row, name in enumerate(ARM_JOINTS):
        if name in joints[: len(values)]:
            arms[row] = values[joints.index(name)]
    return arms
