"""The fine check of a motion, by coal: the arm against persons, the scene and itself.

Distances are first found by kinecast's own compiled code, which also gives the clearance. Whatever comes near is then
measured again by coal, so that a plan is used only if two independent programs find it free.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from jaxtyping import Bool, Float

from kinecast.errors import MissingExtraError
from kinecast.geometry.scene import Scene
from kinecast.geometry.shapes import Box, Capsule, HalfSpace, Shape, Sphere
from kinecast.robot.clearance import arm_clearances
from kinecast.robot.occupancy import Occupancy
from kinecast.robot.trajectory import Trajectory
from kinecast.robot.ur5 import LINKS, UR5

try:
    import coal
except ImportError as error:  # pragma: no cover - the tests install it
    raise MissingExtraError("the robot", "robot") from error

_Placed: TypeAlias = tuple[coal.ShapeBase, coal.Transform3s]
_REQUEST = coal.CollisionRequest()

__all__ = ["Clearance", "CollisionChecker"]

FAR = 2.0
"""Distances beyond it are not looked for [m]."""
NEAR = 0.01
"""Within it coal measures again [m]."""
TIGHT = 0.001
"""Least distance from a person's region [m], looked for in tight passages."""
WORDS = ("a person's region", "the scene", "the arm itself")
_MEETING = (
    ("elbow", "pedestal"), ("forearm", "pedestal"), ("wrist_1", "pedestal"), ("wrist_2", "pedestal"),
    ("wrist_3", "pedestal"), ("palm", "pedestal"), ("left_finger", "pedestal"), ("right_finger", "pedestal"),
    ("forearm", "shoulder"), ("wrist_1", "shoulder"), ("wrist_2", "shoulder"), ("wrist_3", "shoulder"),
    ("palm", "shoulder"), ("left_finger", "shoulder"), ("right_finger", "shoulder"),
    ("wrist_1", "upper_arm"), ("wrist_2", "upper_arm"), ("wrist_3", "upper_arm"), ("palm", "upper_arm"),
    ("left_finger", "upper_arm"), ("right_finger", "upper_arm"),
    ("wrist_2", "elbow"), ("wrist_3", "elbow"), ("palm", "elbow"), ("left_finger", "elbow"), ("right_finger", "elbow"),
    ("wrist_3", "forearm"), ("palm", "forearm"), ("left_finger", "forearm"), ("right_finger", "forearm"),
)  # fmt: skip
"""Pairs of capsules that can meet: no link meets the one that carries it."""


@dataclass(frozen=True)
class Clearance:
    """Least distances along a motion.

    Attributes:
        person: to persons' regions where they are at that moment [m].
        scene: to the scene [m].
        own: of the arm to itself [m].
        time: at which the first of them is below 0 [s]; NaN where none is.
        what: in words, what is in the way then; empty where nothing is.
    """

    person: float
    scene: float
    own: float
    time: float = float("nan")
    what: str = ""

    @property
    def free(self) -> bool:
        """Nothing is in the way."""
        return not self.what


class CollisionChecker:
    """Measures configurations and motions of an arm in a scene.

    Args:
        arm: the arm.
        scene: what stands around it; goals of the scene are no obstacles.
        step: largest way of any point of the arm between two looks at a motion [m].
    """

    def __init__(self, arm: UR5, scene: Scene | None = None, step: float = 0.01) -> None:
        self.arm = arm
        self.scene = scene or Scene()
        self.step = step
        # The shoulder only turns on the spot: what it stands beside does not count.
        self.first_link = np.full(len(self.scene.obstacles), LINKS.index("upper_arm"))
        start, end, radius = arm.pedestal
        index = {**{name: k for k, name in enumerate(LINKS)}, "pedestal": -1}
        self.pairs = np.array([[index[a], index[b]] for a, b in _MEETING])
        self.body = (
            arm.base_rows,
            arm.joint_origins,
            arm.capsule_sites,
            arm.capsule_joint,
            arm.capsule_radius,
            self.pairs,
            np.array([*start, *end, radius]),
        )
        self._exact = _CoalArm(arm, self.scene, self.first_link, self.pairs)

    def clearances(
        self, q: Float[np.ndarray, "N 6"], times: Float[np.ndarray, " N"], occupancy: Occupancy
    ) -> Float[np.ndarray, "N 3"]:
        """(N, 3) distances [m] to persons, scene and itself of configurations (N, 6) at times (N,); 2 m at most."""
        rows = np.ascontiguousarray(q, dtype=np.float64)
        obstacles = np.ascontiguousarray(self.scene.rows(times))
        found: Float[np.ndarray, "N 3"] = arm_clearances(
            rows, self.body, occupancy.rows_at(times), obstacles, self.first_link, FAR
        )
        return found

    def touched(self, q: Float[np.ndarray, "N 6"], times: Float[np.ndarray, " N"], occupancy: Occupancy) -> list[str]:
        """What the arm touches at each of N moments, in words, by coal alone; empty where nothing."""
        return list(self._exact.meets(q, times, np.ones((len(q), 3), dtype=np.bool_), occupancy))

    def looks(self, trajectory: Trajectory, step: float) -> Float[np.ndarray, " N"]:
        """(N,) instants [s] so close together that no point of the arm moves farther than `step` [m] between two."""
        coarse = np.linspace(trajectory.times[0], trajectory.times[-1], 2 * len(trajectory.times))
        capsules = self.arm.capsules(trajectory.at(coarse)[0])
        ends = np.concatenate([capsules.start, capsules.end], axis=1)
        way = np.linalg.norm(np.diff(ends, axis=0), axis=-1).max(axis=-1) + 1e-4
        travelled = np.concatenate([[0.0], np.cumsum(way)])
        count = int(np.ceil(travelled[-1] / step)) + 1
        return np.interp(np.linspace(0.0, travelled[-1], count), travelled, coarse)

    def _looked(
        self, trajectory: Trajectory, occupancy: Occupancy, step: float
    ) -> tuple[Float[np.ndarray, " N"], Float[np.ndarray, "N 6"], Float[np.ndarray, "N 3"]]:
        """Instants, configurations and their clearances along a motion."""
        times = self.looks(trajectory, step)
        q, _ = trajectory.at(times)
        return times, q, self.clearances(q, times, occupancy)

    def check(self, trajectory: Trajectory, occupancy: Occupancy) -> Clearance:
        """Measures a motion finely; what lies between two looks is covered by half the way between them.

        A tight passage is looked at again, more closely.
        """
        times, q, found = self._looked(trajectory, occupancy, self.step)
        if TIGHT < found[:, 0].min() < 0.5 * self.step and (found[:, 1:] >= 0).all():
            times, q, found = self._looked(trajectory, occupancy, 2 * TIGHT)
            blocked = found < [TIGHT, 0.0, 0.0]
        else:
            blocked = found < [0.5 * self.step, 0.0, 0.0]
        person, scene, own = (float(least) for least in found.min(axis=0))
        if blocked.any():
            first = int(blocked.any(axis=1).argmax())
            what = WORDS[int(blocked[first].argmax())]
            return Clearance(person, scene, own, float(times[first]), what)
        near = found < NEAR
        looks = np.flatnonzero(near.any(axis=1))
        for n, what in zip(looks, self._exact.meets(q[looks], times[looks], near[looks], occupancy), strict=True):
            if what:
                return Clearance(person, scene, own, float(times[n]), what)
        return Clearance(person, scene, own)


class _CoalArm:
    """The arm, the scene and persons as coal's shapes."""

    def __init__(self, arm: UR5, scene: Scene, first_link: np.ndarray, pairs: np.ndarray) -> None:
        self.arm = arm
        self.scene = scene
        self.first_link = first_link
        self.pairs = pairs
        starts, ends = np.split(arm.capsule_sites, 2)
        lengths = np.linalg.norm(ends - starts, axis=-1)
        self.links = [coal.Capsule(float(r), float(h)) for r, h in zip(arm.capsule_radius, lengths, strict=True)]
        start, end, radius = arm.pedestal
        self.pedestal = (coal.Capsule(radius, float(np.linalg.norm(end - start))), _placed(start, end))

    def meets(
        self,
        q: Float[np.ndarray, "N 6"],
        times: Float[np.ndarray, " N"],
        near: Bool[np.ndarray, "N 3"],
        occupancy: Occupancy,
    ) -> Iterator[str]:
        """What the arm touches at each moment, in words; empty where nothing.

        Args:
            q: (N, 6) [rad].
            times: (N,) [s].
            near: (N, 3) whether persons, the scene and the arm itself are looked at.
            occupancy: of persons.
        """
        capsules = self.arm.capsules(q)
        axes = _along(capsules.start, capsules.end)
        persons = occupancy.rows_at(times)
        person_axes = _along(persons[..., :3], persons[..., 3:6])
        rows = self.scene.rows(times)
        for n in range(len(q)):
            links = [
                (shape, coal.Transform3s(*placed))
                for shape, *placed in zip(self.links, *(a[n] for a in axes), strict=True)
            ]
            yield (
                (self._person(links, persons[n], [a[n] for a in person_axes]) if near[n, 0] else "")
                or (self._scene(links, rows[n]) if near[n, 1] else "")
                or (self._own(links) if near[n, 2] else "")
            )

    def _person(self, links: list[_Placed], rows: np.ndarray, axes: list[np.ndarray]) -> str:
        """Which link touches a person's region, in words; empty where none."""
        for row, rotation, centre in zip(rows, *axes, strict=True):
            length = float(np.linalg.norm(row[3:6] - row[:3]))
            person = (coal.Capsule(float(row[6]), length), coal.Transform3s(rotation, centre))
            for name, link in zip(LINKS, links, strict=True):
                if _touch(link, person):
                    return f"a person's region ({name})"
        return ""

    def _scene(self, links: list[_Placed], rows: np.ndarray) -> str:
        """Which link touches the scene, in words; empty where none."""
        for obstacle, row, first in zip(self.scene.obstacles, rows, self.first_link, strict=True):
            body = _solid(obstacle if isinstance(obstacle, Shape) else obstacle.shape, row)
            for name, link in zip(LINKS[first:], links[first:], strict=True):
                if _touch(link, body):
                    return f"the scene ({name})"
        return ""

    def _own(self, links: list[_Placed]) -> str:
        """Which link touches another, in words; empty where none."""
        for k, other in self.pairs:
            if _touch(links[k], self.pedestal if other < 0 else links[other]):
                return f"the arm itself ({LINKS[k]})"
        return ""


def _touch(a: _Placed, b: _Placed) -> bool:
    """Whether two placed shapes touch."""
    return bool(coal.collide(a[0], a[1], b[0], b[1], _REQUEST, coal.CollisionResult()))


def _along(
    start: Float[np.ndarray, "*b 3"], end: Float[np.ndarray, "*b 3"]
) -> tuple[Float[np.ndarray, "*b 3 3"], Float[np.ndarray, "*b 3"]]:
    """Rotation and centre of capsules along z whose axes run from start to end."""
    axis = end - start
    length = np.linalg.norm(axis, axis=-1, keepdims=True)
    z = np.where(length > 1e-12, axis / np.maximum(length, 1e-12), [0.0, 0.0, 1.0])
    # Half a turn about the middle between the world's z and the axis carries one into the other.
    flip = z + np.where(z[..., 2:] >= 0, [0.0, 0.0, 1.0], [0.0, 0.0, -1.0])
    flip /= np.linalg.norm(flip, axis=-1, keepdims=True)
    return 2.0 * flip[..., :, None] * flip[..., None, :] - np.eye(3), 0.5 * (start + end)


def _placed(start: Float[np.ndarray, "3"], end: Float[np.ndarray, "3"]) -> coal.Transform3s:
    """Where a capsule along z stands whose axis runs from start to end."""
    return coal.Transform3s(*_along(start, end))


def _solid(shape: Shape, row: Float[np.ndarray, " 17"]) -> _Placed:
    """An obstacle as coal's shape, where its row says that it is."""
    origin = row[1:4]
    if isinstance(shape, Box):
        return coal.Box(*map(float, shape.size)), coal.Transform3s(np.array(shape.rotation), origin)
    if isinstance(shape, Sphere):
        return coal.Sphere(float(shape.radius)), coal.Transform3s(np.eye(3), origin)
    if isinstance(shape, Capsule):
        half = 0.5 * (shape.end - shape.start)
        return coal.Capsule(float(shape.radius), 2 * float(np.linalg.norm(half))), _placed(origin - half, origin + half)
    if isinstance(shape, HalfSpace):
        return coal.Halfspace(np.array(shape.normal), float(shape.normal @ origin)), coal.Transform3s.Identity()
    raise TypeError(f"{type(shape).__name__} is no shape of kinecast.geometry.shapes")
