"""A UR5 with a gripper: kinematics, capsules and limits, read from `data/ur5.urdf` by pinocchio.

Everything is in the controller's base frame. Three parallel axes (2, 3, 4) give inverse kinematics a closed form: the
place of wrist 2 gives q1, the flange's height along those axes q5, its direction q6, and what is left is a triangle in
the plane of upper arm and forearm. After K. P. Hawkins, "Analytic Inverse Kinematics for the Universal Robots UR-5/
UR-10 Arms" (Georgia Institute of Technology, 2013).
"""

from __future__ import annotations

from importlib.resources import files
from itertools import product

import numpy as np
from jaxtyping import Float, Int

from kinecast.errors import MissingExtraError
from kinecast.geometry.transforms import inverse

try:
    import coal
    import pinocchio as pin
except ImportError as error:  # pragma: no cover - the tests install it
    raise MissingExtraError("the robot", "robot") from error

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

D1, A2, A3, D4, D5, D6 = 0.089159, -0.425, -0.39225, 0.10915, 0.09465, 0.0823
"""Denavit-Hartenberg lengths [m], as in data/ur5.urdf (a test compares them)."""
STRAIGHT = 1e-7  # |sin q5| under which the wrist counts as straight and q6 as free
ROUND_OFF = 1e-9  # how far a cosine may exceed 1: the arm stretched to its end, but for round-off
SHOULDER, WRIST, ELBOW = np.array(list(product((1.0, -1.0), repeat=3))).T
"""Signs of q1's offset, q5 and q3 in the eight branches."""


class UR5:
    """The arm.

    Attributes:
        model, geometry: pinocchio's; the pedestal's capsule comes first in the geometry, then those of `LINKS`.
        q_range: (6, 2) least and greatest angle [rad].
        max_speed: (6,) [rad/s]; max_acceleration: (6,) [rad/s^2]; max_jerk: (6,) [rad/s^3].
        stop_jerk: (6,) that it may brake with [rad/s^3].
        joint_origins: (6, 4, 4) each joint's frame in its parent's; it turns about its own z axis.
        links: (L, 7) capsules of the `LINKS`, each in its joint's frame; link_joint: (L,) the joint that moves it.
        pedestal: (7,) the base's capsule, which does not move.
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
        self.joint_origins = np.stack([placement.homogeneous for placement in self.model.jointPlacements[1:]])

        self.geometry = pin.buildGeomFromUrdf(self.model, path, pin.GeometryType.COLLISION)
        capsules = self.geometry.geometryObjects
        rows = np.array([_capsule(each) for each in capsules])
        self.pedestal, self.links = rows[0], rows[1:]
        self.link_joint = np.array([each.parentJoint - 1 for each in capsules[1:]])
        for each in capsules:
            each.geometry = coal.Capsule(each.geometry.radius, 2.0 * each.geometry.halfLength)

    def forward_kinematics(self, q: Float[np.ndarray, "*N 6"]) -> Float[np.ndarray, "*N 4 4"]:
        """T_base_tool: the tool's frame lies between the gripper's fingertips, its z axis pointing out of the hand.

        Args:
            q: (…, 6) [rad].
        """
        tool: Float[np.ndarray, "*N 4 4"] = self.frames(q)[..., -1, :, :] @ self._T_wrist_tool
        return tool

    def frames(self, q: Float[np.ndarray, "*N 6"]) -> Float[np.ndarray, "*N 6 4 4"]:
        """T_base_joint of all joints at configurations (…, 6) [rad]."""
        turns = np.zeros((*q.shape, 4, 4))
        turns[..., 0, 0] = turns[..., 1, 1] = np.cos(q)
        turns[..., 1, 0] = np.sin(q)
        turns[..., 0, 1] = -turns[..., 1, 0]
        turns[..., 2, 2] = turns[..., 3, 3] = 1.0
        frames: Float[np.ndarray, "*N 6 4 4"] = self.joint_origins @ turns
        for j in range(1, 6):
            frames[..., j, :, :] = frames[..., j - 1, :, :] @ frames[..., j, :, :]
        return frames

    def capsules(self, q: Float[np.ndarray, "*N 6"]) -> Float[np.ndarray, "*N L 7"]:
        """(…, L, 7) start, end and radius [m] of the moving links (`LINKS`) at configurations (…, 6) [rad]."""
        ends = fixed_places(self.frames(q), np.repeat(self.link_joint, 2), self.links[:, :6].reshape(-1, 3))
        radius = np.broadcast_to(self.links[:, 6:], (*q.shape[:-1], len(LINKS), 1))
        return np.concatenate([ends.reshape(*q.shape[:-1], len(LINKS), 6), radius], axis=-1)

    def inverse_kinematics(self, T_base_tool: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "B 6"]:
        """Every configuration with angles in [−π, π) that puts the tool there: up to eight branches.

        Where the wrist is straight (q5 = 0 or π) the last angle is free, and 0 is given.

        Returns:
            (B, 6) [rad]; B = 0 where the place is out of reach.
        """
        T = T_base_tool @ self._T_tool_flange
        R, wrist_2 = T[:3, :3], T[:3, 3] - D6 * T[:3, 2]
        with np.errstate(invalid="ignore", divide="ignore"):
            aside = _arccos(D4 / np.hypot(wrist_2[:1], wrist_2[1:2]))
            q1 = np.arctan2(wrist_2[1], wrist_2[0]) + np.pi / 2 + SHOULDER * aside
            s1, c1 = np.sin(q1), np.cos(q1)
            q5 = WRIST * _arccos((T[0, 3] * s1 - T[1, 3] * c1 - D4) / D6)
            s5, c5 = np.sin(q5), np.cos(q5)
            axis = np.stack([s1, -c1, 0.0 * s1], axis=1) @ R  # of joints 2 to 4, as the flange sees it
            q6 = np.where(np.abs(s5) > STRAIGHT, np.arctan2(-axis[:, 1] * np.sign(s5), axis[:, 0] * np.sign(s5)), 0.0)
            s6, c6 = np.sin(q6), np.cos(q6)
            x_4, z_4 = np.stack([[c5 * c6, -c5 * s6, -s5], [-s6, -c6, 0.0 * s6]]).swapaxes(1, 2) @ R.T
            wrist_1 = wrist_2 - D5 * z_4
            x, y = c1 * wrist_1[:, 0] + s1 * wrist_1[:, 1], wrist_1[:, 2] - D1  # in the plane of the arm
            q3 = ELBOW * _arccos((x * x + y * y - A2 * A2 - A3 * A3) / (2 * A2 * A3))
        q2 = np.arctan2(y, x) - np.arctan2(A3 * np.sin(q3), A2 + A3 * np.cos(q3))
        q4 = np.arctan2(x_4[:, 2], c1 * x_4[:, 0] + s1 * x_4[:, 1]) - q2 - q3
        found = np.stack([q1, q2, q3, q4, q5, q6], axis=1)
        return (found[np.isfinite(found).all(axis=1)] + np.pi) % (2 * np.pi) - np.pi


def _arccos(cosine: Float[np.ndarray, "*B"]) -> Float[np.ndarray, "*B"]:
    """NaN where there is none."""
    return np.asarray(np.arccos(np.where(np.abs(cosine) <= 1 + ROUND_OFF, np.clip(cosine, -1.0, 1.0), np.nan)))


def fixed_places(
    frames: Float[np.ndarray, "*N 6 4 4"], joint: Int[np.ndarray, " M"], sites: Float[np.ndarray, "M 3"]
) -> Float[np.ndarray, "*N M 3"]:
    """(…, M, 3) places [m] of points (M, 3) fixed to the links of joints (M,), whose frames are (…, 6, 4, 4)."""
    T, (x, y, z) = frames[..., joint, :3, :], sites.T[..., None]
    places: Float[np.ndarray, "*N M 3"] = T[..., 0] * x + T[..., 1] * y + T[..., 2] * z + T[..., 3]
    return places


def _capsule(cylinder: pin.GeometryObject) -> Float[np.ndarray, "7"]:
    """Start, end and radius in its joint's frame."""
    middle, half = cylinder.placement.translation, cylinder.placement.rotation[:, 2] * cylinder.geometry.halfLength
    return np.array([*(middle - half), *(middle + half), cylinder.geometry.radius])
