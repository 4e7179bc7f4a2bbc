"""Named skeletons: which joints a source tracks, under which names, in which order.

Inside kinecast a joint is always addressed by its canonical name (`JOINTS`). A source's own names come
in through the alias table of its `Skeleton`.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType

from kinecast.errors import DatasetError

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
    """The joints one kind of source tracks.

    Attributes:
        name: short name for messages, e.g. `"Azure Kinect 32"`.
        joints: canonical joint names, in the order of the source.
        aliases: the source's own names to canonical names; several may mean the same joint.
    """

    name: str
    joints: tuple[str, ...]
    aliases: Mapping[str, str]

    @cached_property
    def _by_plain_name(self) -> dict[str, str]:
        return {_plain(source): joint for source, joint in self.aliases.items()}

    def find(self, source_name: str) -> str | None:
        """Canonical name of a source joint, in any case; None where this skeleton does not know it."""
        return self._by_plain_name.get(_plain(source_name))

    def canonical(self, source_names: Iterable[str], where: object) -> tuple[str, ...]:
        """Canonical names of source joints.

        Args:
            source_names: the source's names, in any order and case.
            where: file (and place) for the message.

        Returns:
            One canonical name for each source name, in the same order.

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
    """Check that both arms are tracked: shoulder, elbow and wrist of each side.

    Args:
        joints: canonical joint names of a recording or frame.
        where: file (and place) for the message.

    Raises:
        DatasetError: names the joints that are missing and those there are.
    """
    present = tuple(joints)
    missing = [joint for joint in ARM_JOINTS if joint not in present]
    if missing:
        found = ", ".join(present) or "no joint"
        raise DatasetError(where, f"{', '.join(missing)} missing: both arms are needed; the joints are {found}")


def _skeleton(name: str, table: str) -> Skeleton:
    """A skeleton from its table: `source=canonical` in source order, one word where the two are the same."""
    pairs = (entry.partition("=") for entry in table.split())
    aliases = {source: joint or source for source, _, joint in pairs}
    return Skeleton(name, tuple(dict.fromkeys(aliases.values())), MappingProxyType(aliases))


# Source: Azure Kinect Body Tracking SDK, joint ids 0 to 31.
AZURE_KINECT_32 = _skeleton("Azure Kinect 32", """
    PELVIS=pelvis SPINE_NAVAL=spine SPINE_CHEST=chest NECK=neck
    CLAVICLE_LEFT=left_clavicle SHOULDER_LEFT=left_shoulder ELBOW_LEFT=left_elbow WRIST_LEFT=left_wrist
    HAND_LEFT=left_hand HANDTIP_LEFT=left_hand_tip THUMB_LEFT=left_thumb
    CLAVICLE_RIGHT=right_clavicle SHOULDER_RIGHT=right_shoulder ELBOW_RIGHT=right_elbow
    WRIST_RIGHT=right_wrist HAND_RIGHT=right_hand HANDTIP_RIGHT=right_hand_tip THUMB_RIGHT=right_thumb
    HIP_LEFT=left_hip KNEE_LEFT=left_knee ANKLE_LEFT=left_ankle FOOT_LEFT=left_foot
    HIP_RIGHT=right_hip KNEE_RIGHT=right_knee ANKLE_RIGHT=right_ankle FOOT_RIGHT=right_foot
    HEAD=head NOSE=nose EYE_LEFT=left_eye EAR_LEFT=left_ear EYE_RIGHT=right_eye EAR_RIGHT=right_ear
""")  # fmt: skip

# Source: HA4M's feature files (UpSkel, ArmSkel).
_HA4M_ARMS = """
    CLAVICLE_L=left_clavicle SHOULDER_L=left_shoulder ELBOW_L=left_elbow WRIST_L=left_wrist
    HAND_L=left_hand HANDTIP_L=left_hand_tip THUMB_L=left_thumb
    CLAVICLE_R=right_clavicle SHOULDER_R=right_shoulder ELBOW_R=right_elbow WRIST_R=right_wrist
    HAND_R=right_hand HANDTIP_R=right_hand_tip THUMB_R=right_thumb
"""
HA4M_ARMS_14 = _skeleton("HA4M arms 14", _HA4M_ARMS)
HA4M_UPPER_23 = _skeleton("HA4M upper 23", f"""
    SPINE_NAVAL=spine SPINE_CHEST=chest NECK=neck {_HA4M_ARMS}
    HEAD=head NOSE=nose EYE_L=left_eye EAR_L=left_ear EYE_R=right_eye EAR_R=right_ear
""")  # fmt: skip

# Source: Xsens MVN user manual. A segment's origin is its proximal joint, so UpperArm is the shoulder joint.
XSENS_23 = _skeleton("Xsens 23", """
    Pelvis=pelvis L5=lumbar L3=spine T12=thorax T8=chest Neck=neck Head=head
    RightShoulder=right_clavicle RightUpperArm=right_shoulder RightForeArm=right_elbow RightHand=right_wrist
    LeftShoulder=left_clavicle LeftUpperArm=left_shoulder LeftForeArm=left_elbow LeftHand=left_wrist
    RightUpperLeg=right_hip RightLowerLeg=right_knee RightFoot=right_ankle RightToe=right_foot
    LeftUpperLeg=left_hip LeftLowerLeg=left_knee LeftFoot=left_ankle LeftToe=left_foot
""")  # fmt: skip

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
    LEFT_CLAVICLE=left_clavicle LEFT_SHOULDER=left_shoulder LEFT_ELBOW=left_elbow LEFT_WRIST=left_wrist
    LEFT_HAND=left_hand LEFT_HANDTIP=left_hand_tip LEFT_THUMB=left_thumb
    RIGHT_CLAVICLE=right_clavicle RIGHT_SHOULDER=right_shoulder RIGHT_ELBOW=right_elbow
    RIGHT_WRIST=right_wrist RIGHT_HAND=right_hand RIGHT_HANDTIP=right_hand_tip RIGHT_THUMB=right_thumb
    LEFT_HIP=left_hip LEFT_KNEE=left_knee LEFT_ANKLE=left_ankle LEFT_FOOT=left_foot
    RIGHT_HIP=right_hip RIGHT_KNEE=right_knee RIGHT_ANKLE=right_ankle RIGHT_FOOT=right_foot
    HEAD=head NOSE=nose LEFT_EYE=left_eye LEFT_EAR=left_ear RIGHT_EYE=right_eye RIGHT_EAR=right_ear
    LEFT_HEEL=left_heel RIGHT_HEEL=right_heel
""")  # fmt: skip

# Source: the human_robot_animations files. Points are marker clusters; the hand's stands for the wrist.
VICON = _skeleton("Vicon bodies", """
    collar head hip=pelvis left_shoulder left_elbow left_hand=left_wrist
    right_shoulder right_elbow right_hand=right_wrist
""")  # fmt: skip

# Source: the KTH handover files. A frame's origin is its proximal joint, so UArm is the shoulder joint.
KTH_13 = _skeleton("KTH 13", """
    hip=pelvis ab=spine chest neck head
    LShoulder=left_clavicle LUArm=left_shoulder LFArm=left_elbow LHand=left_wrist
    RShoulder=right_clavicle RUArm=right_shoulder RFArm=right_elbow RHand=right_wrist
""")  # fmt: skip

# Source: the human_assembly_data files, columns in this order.
LEGO_6 = _skeleton("LEGO 6", "left_wrist right_wrist left_elbow right_elbow left_shoulder right_shoulder")

# BVH files name an arm in one of two ways. With Arm and ForeArm, Shoulder is the clavicle; with Elbow,
# Shoulder is the shoulder joint and the clavicle is called Collar.
BVH_FOREARM = _skeleton("BVH forearm", """
    Hips=pelvis LowerBack=lumbar Spine=spine Spine1=thorax Spine2=chest Neck=neck Head=head
    LeftShoulder=left_clavicle LeftArm=left_shoulder LeftForeArm=left_elbow LeftHand=left_wrist
    RightShoulder=right_clavicle RightArm=right_shoulder RightForeArm=right_elbow RightHand=right_wrist
    LeftUpLeg=left_hip LeftLeg=left_knee LeftFoot=left_ankle LeftToe=left_foot LeftToeBase=left_foot
    RightUpLeg=right_hip RightLeg=right_knee RightFoot=right_ankle RightToe=right_foot RightToeBase=right_foot
""")  # fmt: skip
BVH_COLLAR = _skeleton("BVH collar", """
    Hips=pelvis Chest=spine Chest2=thorax Chest3=chest Neck=neck Head=head
    LeftCollar=left_clavicle LeftShoulder=left_shoulder LeftElbow=left_elbow LeftWrist=left_wrist
    LeftHand=left_wrist
    RightCollar=right_clavicle RightShoulder=right_shoulder RightElbow=right_elbow RightWrist=right_wrist
    RightHand=right_wrist
    LeftHip=left_hip LeftKnee=left_knee LeftAnkle=left_ankle LeftToe=left_foot
    RightHip=right_hip RightKnee=right_knee RightAnkle=right_ankle RightToe=right_foot
""")  # fmt: skip

SKELETONS = (
    AZURE_KINECT_32, HA4M_UPPER_23, HA4M_ARMS_14, XSENS_23, COCO_17, MEDIAPIPE_33, ZED_34, VICON, KTH_13,
    LEGO_6, BVH_FOREARM, BVH_COLLAR,
)  # fmt: skip
"""Every skeleton kinecast knows."""
