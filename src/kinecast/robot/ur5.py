"""A UR5 with a gripper: kinematics, capsules and limits, read from `data/ur5.urdf` by pinocchio."""

from __future__ import annotations

from dataclasses import dataclass
from importlib.resources import files

import numpy as np
from jaxtyping import Float, Int

from kinecast.errors import MissingExtraError, OptionError
from kinecast.geometry.transforms import inverse
from kinecast.robot.inverse_kinematics import branches, turns
from kinecast.robot.kinematics import site_jacobians, site_positions

try:
    import pinocchio as pin
except ImportError as error:  # pragma: no cover - the tests install it
    raise MissingExtraError("the robot", "robot") from error

__all__ = ["LINKS", "UR5", "BodyPoints", "LinkCapsules"]

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
SPACING = 1.3
"""Largest distance of body points along a capsule's axis, in its radii: halfway between two points the capsule's
surface stands out from their balls by 0.24 radii, 0.014 m at most."""


@dataclass(frozen=True)
class LinkCapsules:
    """The links as capsules.

    Attributes:
        start, end: (N, L, 3) ends of the axes [m] in the world.
        radius: (L,) [m].
    """

    start: Float[np.ndarray, "N L 3"]
    end: Float[np.ndarray, "N L 3"]
    radius: Float[np.ndarray, " L"]


@dataclass(frozen=True)
class BodyPoints:
    """Balls strung along the links' axes.

    Attributes:
        positions: (N, P, 3) centres [m] in the world.
        radius: (P,) [m].
        link: (P,) index into `LINKS`.
    """

    positions: Float[np.ndarray, "N P 3"]
    radius: Float[np.ndarray, " P"]
    link: Int[np.ndarray, " P"]


class UR5:
    """The arm, fixed in the world.

    Args:
        base: T_world_base, the controller's base frame in the world.

    Attributes:
        T_world_base: (4, 4).
        q_range: (6, 2) least and greatest angle [rad].
        max_speed: (6,) [rad/s]; max_acceleration: (6,) [rad/s^2]; max_jerk: (6,) [rad/s^3].
        stop_jerk: (6,) that it may brake with [rad/s^3].
        joint_origins: (6, 3, 4) each joint's frame in its parent's (kinecast.robot.kinematics).
        capsule_sites: (2 L, 3) ends of the capsules in their joints' frames [m], all starts first.
        capsule_joint: (L,) joint that moves each capsule.
        capsule_radius: (L,) [m].
        pedestal: start (3,), end (3,) [m] in the world and radius of the base's capsule, which does not move.
    """

    def __init__(self, base: Float[np.ndarray, "4 4"] | None = None) -> None:
        self.T_world_base = _checked_base(base)
        path = str(files("kinecast") / "data" / "ur5.urdf")
        self.model = pin.buildModelFromUrdf(path)
        self._data = self.model.createData()
        self._tool = self.model.getFrameId("tool")
        self._T_flange_tool = (
            self.model.frames[self.model.getFrameId("gripper")].placement.inverse()
            * self.model.frames[self._tool].placement
        ).homogeneous
        self.q_range = np.stack([self.model.lowerPositionLimit, self.model.upperPositionLimit], axis=1)
        self.max_speed = np.array(self.model.velocityLimit)
        self.max_acceleration = np.full(6, MAX_ACCELERATION)
        self.max_jerk = np.full(6, MAX_JERK)
        self.stop_jerk = np.full(6, STOP_JERK)
        self.joint_origins = np.stack([placement.homogeneous[:3] for placement in self.model.jointPlacements[1:]])
        self.base_rows = np.ascontiguousarray(self.T_world_base[:3])

        geometry = pin.buildGeomFromUrdf(self.model, path, pin.GeometryType.COLLISION)
        fixed, *moving = geometry.geometryObjects
        ends = np.stack([_axis(each) for each in (fixed, *moving)], axis=1)
        start, end = ends[:, 0] @ self.T_world_base[:3, :3].T + self.T_world_base[:3, 3]
        self.pedestal = (start, end, float(fixed.geometry.radius))
        self.capsule_sites = np.ascontiguousarray(ends[:, 1:].reshape(-1, 3))
        self.capsule_joint = np.array([each.parentJoint - 1 for each in moving])
        self.capsule_radius = np.array([each.geometry.radius for each in moving])
        self._place_points(ends[0, 1:], ends[1, 1:])

    def _place_points(self, starts: Float[np.ndarray, "L 3"], ends: Float[np.ndarray, "L 3"]) -> None:
        """Body points from each capsule's start to its end, at most `SPACING` radii apart."""
        sites, link = [], []
        for k, (start, end, radius) in enumerate(zip(starts, ends, self.capsule_radius, strict=True)):
            count = int(np.ceil(np.linalg.norm(end - start) / (SPACING * radius))) + 1
            sites.append(np.linspace(start, end, count))
            link += [k] * count
        self.point_sites = np.concatenate(sites)
        self.point_link = np.array(link)
        self.point_joint = self.capsule_joint[self.point_link]
        self.point_radius = self.capsule_radius[self.point_link]

    def forward_kinematics(self, q: Float[np.ndarray, "6"]) -> Float[np.ndarray, "4 4"]:
        """T_world_tool: the tool's frame lies between the gripper's fingertips, its z axis pointing out of the hand.

        Args:
            q: (6,) [rad].
        """
        pin.framesForwardKinematics(self.model, self._data, np.asarray(q, dtype=np.float64))
        tool: Float[np.ndarray, "4 4"] = self.T_world_base @ self._data.oMf[self._tool].homogeneous
        return tool

    def capsules(self, q: Float[np.ndarray, "N 6"]) -> LinkCapsules:
        """The moving links (`LINKS`) at configurations (N, 6) [rad]."""
        joint = np.tile(self.capsule_joint, 2)
        ends = site_positions(_rows(q), self.base_rows, self.joint_origins, self.capsule_sites, joint)
        count = len(LINKS)
        return LinkCapsules(ends[:, :count], ends[:, count:], self.capsule_radius)

    def body_points(self, q: Float[np.ndarray, "N 6"]) -> BodyPoints:
        """Balls along the moving links at configurations (N, 6) [rad]."""
        positions = site_positions(_rows(q), self.base_rows, self.joint_origins, self.point_sites, self.point_joint)
        return BodyPoints(positions, self.point_radius, self.point_link)

    def body_jacobians(self, q: Float[np.ndarray, "N 6"]) -> Float[np.ndarray, "N P 3 6"]:
        """(N, P, 3, 6) derivative of each body point's position by q [m/rad]."""
        jacobians: Float[np.ndarray, "N P 3 6"] = site_jacobians(
            _rows(q), self.base_rows, self.joint_origins, self.point_sites, self.point_joint
        )
        return jacobians

    def inverse_kinematics(self, T_world_tool: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "B 6"]:
        """Every configuration within `q_range` that puts the tool there: up to eight branches, and their full turns.

        Where the wrist is straight (q5 = 0 or ± π) the last angle is free, and the one nearest 0 is given.

        Args:
            T_world_tool: (4, 4).

        Returns:
            (B, 6) [rad]; B = 0 where the place is out of reach.
        """
        T_base_flange = inverse(self.T_world_base) @ T_world_tool @ inverse(self._T_flange_tool)
        return turns(branches(T_base_flange), self.q_range)


def _checked_base(base: Float[np.ndarray, "4 4"] | None) -> Float[np.ndarray, "4 4"]:
    """A copy of T_world_base, checked to be a rigid transform."""
    T = np.eye(4) if base is None else np.array(base, dtype=np.float64)
    rigid = T.shape == (4, 4) and np.allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-6)
    if not rigid or np.linalg.det(T[:3, :3]) < 0 or not np.allclose(T[3], [0, 0, 0, 1]) or not np.isfinite(T).all():
        raise OptionError(f"base {T.tolist()} is not a rigid transform")
    return T


def _axis(capsule: pin.GeometryObject) -> Float[np.ndarray, "2 3"]:
    """Both ends of a cylinder's axis in its joint's frame."""
    half = capsule.placement.rotation[:, 2] * capsule.geometry.halfLength
    return np.stack([capsule.placement.translation - half, capsule.placement.translation + half])


def _rows(q: Float[np.ndarray, "N 6"]) -> Float[np.ndarray, "N 6"]:
    """Configurations as compiled code takes them."""
    return np.ascontiguousarray(q, dtype=np.float64)
