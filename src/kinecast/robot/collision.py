"""The arm against the scene and itself, measured by coal along pinocchio's kinematics."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from kinecast.errors import MissingExtraError, OptionError
from kinecast.geometry.distances import HALF_SPACE
from kinecast.geometry.scene import Scene
from kinecast.geometry.shapes import Shape
from kinecast.robot.trajectory import Trajectory
from kinecast.robot.ur5 import LINKS, UR5

try:
    import coal
    import pinocchio as pin
except ImportError as error:  # pragma: no cover - the tests install it
    raise MissingExtraError("the robot", "robot") from error

LOOKS = (0.01, 0.002)
"""Largest ways of any point of the arm between two looks at a motion [m]; the second in tight passages."""
FIRST_LINK = LINKS.index("upper_arm")
"""The first that may meet the scene: the shoulder only turns on the spot, and what it stands beside does not count."""
BODIES = ("pedestal", *LINKS)
MEETING = [(link, base) for base in range(5) for link in range(base + 3, len(BODIES))]
"""Pairs of the arm's own capsules that can meet: pedestal to forearm, each with those from the third after it on."""


class CollisionChecker:
    """Measures configurations and motions of an arm in a scene; for one thread at a time.

    Args:
        arm: the arm.
        scene: what stands around it; goals of the scene are no obstacles.

    Raises:
        OptionError: an obstacle moves.
    """

    def __init__(self, arm: UR5, scene: Scene | None = None) -> None:
        self.arm, self.scene = arm, scene or Scene()
        self._geometry = arm.geometry.copy()
        pairs = MEETING.copy()
        for obstacle in self.scene.obstacles:
            if not isinstance(obstacle, Shape):
                raise OptionError(f"the scene's {type(obstacle).__name__}: around the arm nothing may move by itself")
            placed = self._geometry.addGeometryObject(pin.GeometryObject("obstacle", 0, *_solid(obstacle.row)))
            pairs += [(link, placed) for link in range(FIRST_LINK + 1, len(BODIES))]
        for pair in pairs:
            self._geometry.addCollisionPair(pin.CollisionPair(*pair))
        self._links = [BODIES[link] for link, _ in pairs]
        self._data, self._placed = arm.model.createData(), pin.GeometryData(self._geometry)
        self._margin = 0.0

    def touched(self, q: Float[np.ndarray, "6"], margin: float = 0.0) -> str:
        """What is nearer than a margin [m] at a configuration [rad], in words; empty where nothing is."""
        if margin != self._margin:
            for request in self._placed.collisionRequests:
                request.security_margin = margin
            self._margin = margin
        if not pin.computeCollisions(self.arm.model, self._data, self._geometry, self._placed, q, True):
            return ""
        pair = next(k for k, result in enumerate(self._placed.collisionResults) if result.isCollision())
        return f"{'the arm itself' if pair < len(MEETING) else 'the scene'} ({self._links[pair]})"

    def clearance(self, q: Float[np.ndarray, "6"]) -> tuple[float, float]:
        """Least distances [m] to the scene, inf where it is empty, and of the arm to itself; below 0 where it cuts."""
        pin.computeDistances(self.arm.model, self._data, self._geometry, self._placed, q)
        found = [result.min_distance for result in self._placed.distanceResults]
        return min(found[len(MEETING) :], default=np.inf), min(found[: len(MEETING)])

    def looks(self, trajectory: Trajectory, step: float) -> Float[np.ndarray, " N"]:
        """(N,) instants [s] so close together that no point of the arm moves farther than `step` [m] between two."""
        coarse = np.linspace(trajectory.times[0], trajectory.times[-1], 2 * len(trajectory.times))
        ends = self.arm.capsules(trajectory.at(coarse))[..., :6].reshape(len(coarse), -1, 3)
        way = np.linalg.norm(np.diff(ends, axis=0), axis=-1).max(axis=-1) + 1e-4
        travelled = np.concatenate([[0.0], np.cumsum(way)])
        count = int(np.ceil(travelled[-1] / step)) + 1
        return np.interp(np.linspace(0.0, travelled[-1], count), travelled, coarse)

    def check(self, trajectory: Trajectory) -> str:
        """What is in a motion's way, in words; empty where nothing is.

        What lies between two looks is covered by a margin of half the way between them; a tight passage is looked at
        again, more closely.
        """
        found = ""
        for step in LOOKS:
            rows = trajectory.at(self.looks(trajectory, step))
            if not (found := next((what for q in rows if (what := self.touched(q, 0.5 * step))), "")):
                break
        return found


def _solid(row: Float[np.ndarray, "17"]) -> tuple[pin.SE3, coal.ShapeBase]:
    """Place and shape of an obstacle (kinecast.geometry.distances) for coal; a sphere is a capsule without length."""
    center, half, radius = row[1:4], row[13:16], float(row[16])
    if row[0] == HALF_SPACE:
        return pin.SE3.Identity(), coal.Halfspace(row[4:7], float(row[4:7] @ center))
    solid = coal.Capsule(radius, 2.0 * half[2]) if radius else coal.Box(*(2.0 * half))
    return pin.SE3(row[4:13].reshape(3, 3), center), solid
