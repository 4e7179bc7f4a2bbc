"""Plans: straight, pushed free by CHOMP, or along a path that RRTConnect found; always checked finely by coal.

People are no obstacles (docs/decisions/0028): a way may bend where they would slow the arm down.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Float, Int

from kinecast.geometry.scene import Scene
from kinecast.robot.chomp import Chomp, People
from kinecast.robot.collision import CollisionChecker
from kinecast.robot.occupancy import Occupancy
from kinecast.robot.pick_place import nearest, postures
from kinecast.robot.seeding import evenly, searched
from kinecast.robot.separation import SeparationOptions
from kinecast.robot.trajectory import Trajectory, minimum_jerk
from kinecast.robot.ur5 import UR5

__all__ = ["SPEED", "NoPlan", "Plan", "Planner"]

SPEED, ACCELERATION, JERK = 1.57, 4.0, 75.0
"""Greatest of an angle [rad/s, rad/s^2, rad/s^3]: half of the speed that the arm can do, as beside people nothing is
gained by more; less than half of its acceleration and jerk, the rest is for braking."""
TOLERANCE = 1.02
"""A motion that needs so many times its time to be within these is within them; others are slowed to as much less."""
SHORTEST = 0.4
"""Duration of the shortest motion [s]."""
WAYPOINTS, BENT_WAYPOINTS = 40, 24
"""Of a path, and of one that bends around people."""
LEG = 14
"""Waypoints of a straight leg between two corners."""
STRAIGHT_GOALS = 2
"""Goals tried from a straight way, the best first."""
SCENE_MARGINS = (0.005, 0.01, 0.015, 0.02)
"""Least distances from the scene that the descent keeps, in turn [m]."""
SEARCH_MARGINS = (0.003, 0.001)
"""Kept by searched paths [m], in turn: what follows them cuts corners."""
DRAWN_IN = (0.3, 0.3)
"""Distance from the arm's axis and height of a hand that is drawn in [m]."""
ROOM, ROOM_WORTH = 0.1, 2.0
"""So much room around a goal [m], from the scene and from the arm itself, is worth a later arrival [s/m]."""


@dataclass(frozen=True)
class Plan:
    """A motion that was checked.

    Attributes:
        trajectory: from the start to one of the goals.
        goal: index of the goal it leads to.
        solved_by: `chomp`, `chomp from rrt` or `rrt`.
    """

    trajectory: Trajectory
    goal: int = 0
    solved_by: str = "chomp"


@dataclass(frozen=True)
class NoPlan:
    """No motion was found.

    Attributes:
        reason: in words.
    """

    reason: str


class Planner:
    """Plans motions of an arm in a scene.

    Args:
        arm: the arm.
        scene: what stands around it.
        searches: searched paths that are begun with where straight ways fail.
        iterations: most of one search, about 0.5 ms each.
    """

    def __init__(self, arm: UR5, scene: Scene | None = None, searches: int = 1, iterations: int = 150) -> None:
        self.arm, self.searches, self.iterations = arm, searches, iterations
        self.checker = CollisionChecker(arm, scene)
        self._chomp = Chomp(arm, self.checker.scene.rows(np.zeros(1))[0])

    def plan(
        self,
        q: Float[np.ndarray, "6"],
        goals: Float[np.ndarray, "G 6"],
        start_time: float,
        seconds: float = math.inf,
    ) -> Plan | NoPlan:
        """A motion to whichever goal is reached soonest and free, with room around it.

        Args:
            q: (6,) where the arm rests at the start time [rad].
            goals: (G, 6) [rad], any of them will do.
            start_time: when the motion starts [s].
            seconds: after which nothing new is begun; without an end the plan depends on the question alone.

        Returns:
            A plan that was checked, or why there is none.
        """
        end = time.perf_counter() + seconds
        if not np.isfinite(q).all():
            return NoPlan("the arm's state is not known")
        if self.checker.touched(q):
            return NoPlan("the arm touches the scene or itself")
        if len(goals) == 0 or not np.isfinite(goals).all():
            return NoPlan("the goal is out of reach")
        order = self._usable(q, goals)
        if not len(order):
            return NoPlan("the goal is blocked by the scene or the arm itself")
        blocked = ""
        for k in order[:STRAIGHT_GOALS]:
            if blocked and time.perf_counter() > end:
                break
            found = self._pushed(np.stack([q, goals[k]]), start_time, end)
            if isinstance(found, Trajectory):
                return Plan(found, int(k))
            blocked = found
        for attempt in range(self.searches):
            left = end - time.perf_counter()
            if left <= 0:
                return NoPlan(f"{blocked} is in the way; no way around it found in time")
            margin = SEARCH_MARGINS[attempt % len(SEARCH_MARGINS)]
            # Wide ways first; half of the time is kept for narrow ones.
            corners = searched(self.checker, q, goals[order], margin, 0.5 * left, self.iterations, attempt)
            if corners is None:
                continue
            k = order[np.abs(goals[order] - corners[-1]).max(axis=1).argmin()]
            for name, way in (("chomp from rrt", self._pushed), ("rrt", self._legs)):
                found = way(corners, start_time, end)
                if isinstance(found, Trajectory):
                    return Plan(found, int(k), name)
                blocked = found
        return NoPlan(f"{blocked} is in the way; no way around it")

    def bent(
        self,
        plan: Plan,
        q: Float[np.ndarray, "6"],
        goals: Float[np.ndarray, "G 6"],
        people: Occupancy,
        start_time: float,
        separation: SeparationOptions,
    ) -> Iterator[Plan]:
        """Ways to where a plan leads that bend where speed would be lost beside people: from its own side, and inside.

        Args:
            plan: with nobody there.
            q: (6,) where the arm rests at the start time [rad].
            goals: (G, 6) of the plan [rad].
            people: where they may be; they are no obstacles, they cost time.
            start_time: [s].
            separation: of monitoring.
        """
        goal = goals[plan.goal]
        for corners in (np.stack([q, goal]), *self._inside(q, goal)):
            path, times = _along(corners, BENT_WAYPOINTS, start_time)
            beside = People(people.rows_at(times), separation)
            path, _, _ = self._chomp.optimise(path, _straight(path), SCENE_MARGINS[0], beside, 25, 40)
            trajectory = _slow_enough(Trajectory(times, path))
            if not self.checker.check(trajectory):
                yield Plan(trajectory, plan.goal)

    def _inside(self, q: Float[np.ndarray, "6"], goal: Float[np.ndarray, "6"]) -> list[Float[np.ndarray, "3 6"]]:
        """Corners of a way past the arm's own foot, the hand drawn in; none where it cannot be."""
        start, end = (self.arm.forward_kinematics(each)[:3, 3] for each in (q, goal))
        turn = 0.5 * (math.atan2(start[1], start[0]) + math.atan2(end[1], end[0]))
        T = np.diag([1.0, -1.0, -1.0, 1.0])
        T[:3, 3] = DRAWN_IN[0] * math.cos(turn), DRAWN_IN[0] * math.sin(turn), DRAWN_IN[1]
        found = nearest(postures(self.arm, T), 0.5 * (q + goal), self.arm.q_range, 1)
        return [np.stack([q, middle, goal]) for middle in found]

    def _usable(self, q: Float[np.ndarray, "6"], goals: Float[np.ndarray, "G 6"]) -> Int[np.ndarray, " U"]:
        """Goals that are free, the best first: soon reached, with room around."""
        clear = np.array([self.checker.clearance(goal) for goal in goals])
        price = [_duration(goal - q) for goal in goals] - ROOM_WORTH * np.minimum(clear, ROOM).sum(axis=1)
        best = np.argsort(price, kind="stable")
        return best[(clear[best] > 0).all(axis=1)]

    def _pushed(self, corners: Float[np.ndarray, "M 6"], start_time: float, end: float) -> Trajectory | str:
        """A checked motion along corners that CHOMP has pushed free, or what was in its way.

        Nothing but the first descent is begun later than the end [s, time.perf_counter].
        """
        path, times = _along(corners, WAYPOINTS, start_time)
        straight, blocked = _straight(path), ""
        for margin in SCENE_MARGINS:
            path, excess, _ = self._chomp.optimise(path, straight, margin)
            trajectory = _slow_enough(Trajectory(times, path))
            blocked = self.checker.check(trajectory)
            if not blocked:
                return trajectory
            if excess <= 0 or time.perf_counter() > end:
                break  # stuck: wider margins would not free it
        return blocked

    def _legs(self, corners: Float[np.ndarray, "M 6"], start_time: float, _end: float) -> Trajectory | str:
        """A checked motion straight from corner to corner, at rest in each, or what was in its way."""
        times, q = [np.array([start_time])], [corners[:1]]
        for start, goal in pairwise(corners):
            times.append(times[-1][-1] + np.linspace(0.0, _duration(goal - start), LEG)[1:])
            q.append(start + minimum_jerk(LEG)[1:, None] * (goal - start))
        trajectory = Trajectory(np.concatenate(times), np.concatenate(q))
        return self.checker.check(trajectory) or trajectory


def _along(
    corners: Float[np.ndarray, "M 6"], count: int, start_time: float
) -> tuple[Float[np.ndarray, "count 6"], Float[np.ndarray, " count"]]:
    """Waypoints along straight legs, with the speed of least jerk over all of them, and their times [s]."""
    path = evenly(corners, minimum_jerk(count))
    return path, start_time + np.linspace(0.0, _duration(np.abs(np.diff(path, axis=0)).sum(axis=0)), count)


def _straight(path: Float[np.ndarray, "W 6"]) -> Float[np.ndarray, "W 6"]:
    """The path of least jerk between the ends of another."""
    straight: Float[np.ndarray, "W 6"] = path[0] + minimum_jerk(len(path))[:, None] * (path[-1] - path[0])
    return straight


def _duration(way: Float[np.ndarray, "6"]) -> float:
    """Of a motion of least jerk from rest to rest along a way of each angle [rad], within the limits [s]."""
    longest = float(np.abs(way).max())
    return max(
        1.875 * longest / SPEED,
        float(np.sqrt(5.7735 * longest / ACCELERATION)),
        float(np.cbrt(60.0 * longest / JERK)),
        SHORTEST,
    )


def _slow_enough(trajectory: Trajectory) -> Trajectory:
    """The motion in as much time as the limits need."""
    excess = trajectory.excess(np.array([SPEED, ACCELERATION, JERK]), 100)
    return trajectory.stretched(TOLERANCE * excess) if excess > TOLERANCE else trajectory
