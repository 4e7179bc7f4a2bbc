"""A UR5 with a gripper: kinematics, capsules and limits, read from `data/ur5.urdf` by pinocchio.

Everything is in the controller's base frame.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from importlib.resources import files
from typing import no_type_check

import numpy as np
from jaxtyping import Float
from numba import njit

from kinecast.errors import MissingExtraError
from kinecast.geometry.transforms import inverse
from kinecast.robot.inverse_kinematics import branches

try:
    import coal
    import pinocchio as pin
except ImportError as error:  # pragma: no cover - the tests install it
    raise MissingExtraError("the robot", "robot") from error

__all__ = ["LINKS", "UR5", "LinkCapsules", "fixed_places"]

LINKS = (
    "shoulder", "upper_arm", "elbow", "forearm", "wrist_1", "wrist_2", "wrist_3", "palm", "left_finger", "right_finger",
)  # fmt: skip
"""Names of the moving capsules, in the order of every (…, L, …) array."""

MAX_ACCELERATION = 10.0
"""[rad/s^2]: the manufacturer gives none; the time parametrisation of its ROS 2 driver's MoveIt setup assumes this."""
MAX_JERK = 200.0
"""[rad/s^3]: the manufacturer gives none; full acceleration within 0.05 s, six of the controller's 125 Hz steps."""
STOP_JERK = 625.0
"""[rad/s^3] while it brakes: full deceleration within two of these steps. The manufacturer's own stops are harder: 3.19
rad/s to rest in 0.244 s on average, fully stretched and loaded (base; UR5/CB3 user manual 3.4.5, appendix A.1)."""


@dataclass(frozen=True)
class LinkCapsules:
    """The links as capsules.

    Attributes:
        start, end: (N, L, 3) ends of the axes [m].
        radius: (L,) [m].
    """

    start: Float[np.ndarray, "N L 3"]
    end: Float[np.ndarray, "N L 3"]
    radius: Float[np.ndarray, " L"]


class UR5:
    """The arm.

    Attributes:
        model, geometry: pinocchio's; the pedestal's capsule comes first in the geometry, then those of `LINKS`.
        q_range: (6, 2) least and greatest angle [rad].
        max_speed: (6,) [rad/s]; max_acceleration: (6,) [rad/s^2]; max_jerk: (6,) [rad/s^3].
        stop_jerk: (6,) that it may brake with [rad/s^3].
        joint_origins: (6, 3, 4) each joint's frame in its parent's, as [R t]; it turns about its own z axis.
        capsule_sites: (2 L, 3) ends of the capsules in their joints' frames [m], all starts first.
        capsule_joint: (L,) joint that moves each capsule.
        capsule_radius: (L,) [m].
        pedestal: start (3,), end (3,) [m] and radius of the base's capsule, which does not move.
    """

    def __init__(self) -> None:
        path = str(files("kinecast") / "data" / "ur5.urdf")
        self.model = pin.buildModelFromUrdf(path)
        tool, gripper = (self.model.frames[self.model.getFrameId(name)] for name in ("tool", "gripper"))
        self._T_wrist_tool = tool.placement.homogeneous
        self._T_tool_flange = inverse((gripper.placement.inverse() * tool.placement).homogeneous)
        self.q_range = np.stack([self.model.lowerPositionLimit, self.model.upperPositionLimit], axis=1)
        self.max_speed = np.array(self.model.velocityLimit)
        self.max_acceleration = np.full(6, MAX_ACCELERATION)
        self.max_jerk = np.full(6, MAX_JERK)
        self.stop_jerk = np.full(6, STOP_JERK)
        self.joint_origins = np.stack([placement.homogeneous[:3] for placement in self.model.jointPlacements[1:]])

        self.geometry = pin.buildGeomFromUrdf(self.model, path, pin.GeometryType.COLLISION)
        fixed, *moving = self.geometry.geometryObjects
        self.pedestal = (*_axis(fixed), float(fixed.geometry.radius))
        self.capsule_sites = np.ascontiguousarray(np.stack([_axis(each) for each in moving], axis=1).reshape(-1, 3))
        self.capsule_joint = np.array([each.parentJoint - 1 for each in moving])
        self.capsule_radius = np.array([each.geometry.radius for each in moving])
        for each in self.geometry.geometryObjects:
            each.geometry = coal.Capsule(each.geometry.radius, 2.0 * each.geometry.halfLength)

    def forward_kinematics(self, q: Float[np.ndarray, "6"]) -> Float[np.ndarray, "4 4"]:
        """T_base_tool: the tool's frame lies between the gripper's fingertips, its z axis pointing out of the hand.

        Args:
            q: (6,) [rad].
        """
        T_base_wrist = np.eye(4)
        T_base_wrist[:3] = self.frames(q[None])[0, -1]
        tool: Float[np.ndarray, "4 4"] = T_base_wrist @ self._T_wrist_tool
        return tool

    def frames(self, q: Float[np.ndarray, "N 6"]) -> Float[np.ndarray, "N 6 3 4"]:
        """T_base_joint of all joints as [R t] at configurations (N, 6) [rad]."""
        frames: Float[np.ndarray, "N 6 3 4"] = _joint_frames(np.ascontiguousarray(q, np.float64), self.joint_origins)
        return frames

    def capsules(self, q: Float[np.ndarray, "N 6"]) -> LinkCapsules:
        """The moving links (`LINKS`) at configurations (N, 6) [rad]."""
        ends = fixed_places(self.frames(q), self.capsule_sites, np.tile(self.capsule_joint, 2))
        return LinkCapsules(ends[:, : len(LINKS)], ends[:, len(LINKS) :], self.capsule_radius)

    def inverse_kinematics(self, T_base_tool: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "B 6"]:
        """Every configuration with angles in [−π, π) that puts the tool there: up to eight branches.

        Where the wrist is straight (q5 = 0 or π) the last angle is free, and 0 is given.

        Returns:
            (B, 6) [rad]; B = 0 where the place is out of reach.
        """
        return branches(T_base_tool @ self._T_tool_flange)


def _axis(capsule: pin.GeometryObject) -> Float[np.ndarray, "2 3"]:
    """Both ends of a cylinder's axis in its joint's frame."""
    half = capsule.placement.rotation[:, 2] * capsule.geometry.halfLength
    return np.stack([capsule.placement.translation - half, capsule.placement.translation + half])


@njit(cache=True)
@no_type_check
def _joint_frames(q: np.ndarray, origins: np.ndarray) -> np.ndarray:
    """(N, D, 3, 4) T_base_joint of configurations (N, D) [rad]; origins (D, 3, 4) are the joints' frames at 0 rad."""
    frames = np.empty((len(q), *origins.shape))
    for n in range(len(q)):
        parent = np.eye(4)[:3]
        for j in range(q.shape[1]):
            c, s = math.cos(q[n, j]), math.sin(q[n, j])
            for r in range(3):
                a, b, d = parent[r, 0], parent[r, 1], parent[r, 2]
                x = a * origins[j, 0, 0] + b * origins[j, 1, 0] + d * origins[j, 2, 0]
                y = a * origins[j, 0, 1] + b * origins[j, 1, 1] + d * origins[j, 2, 1]
                frames[n, j, r, 0] = c * x + s * y
                frames[n, j, r, 1] = c * y - s * x
                frames[n, j, r, 2] = a * origins[j, 0, 2] + b * origins[j, 1, 2] + d * origins[j, 2, 2]
                frames[n, j, r, 3] = a * origins[j, 0, 3] + b * origins[j, 1, 3] + d * origins[j, 2, 3] + parent[r, 3]
            parent = frames[n, j]
    return frames


@njit(cache=True)
@no_type_check
def fixed_places(frames: np.ndarray, sites: np.ndarray, joint: np.ndarray) -> np.ndarray:
    """(N, M, 3) places [m] of points (M, 3) that are fixed to links whose joints (M,) have frames (N, D, 3, 4)."""
    places = np.empty((len(frames), len(sites), 3))
    for n in range(len(frames)):
        for m in range(len(sites)):
            for i in range(3):
                row = frames[n, joint[m], i]
                places[n, m, i] = row[0] * sites[m, 0] + row[1] * sites[m, 1] + row[2] * sites[m, 2] + row[3]
    return places
