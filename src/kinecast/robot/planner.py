"""Plans: straight, pushed free by CHOMP, or along a path that RRTConnect found; always checked finely by coal.

People are no obstacles (docs/decisions/0028): a way may bend where they would slow the arm down.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Iterator
from itertools import count, pairwise
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from kinecast.errors import MissingExtraError
from kinecast.geometry.scene import Scene
from kinecast.robot.body import interpolated
from kinecast.robot.chomp import Chomp, People
from kinecast.robot.collision import CollisionChecker
from kinecast.robot.pick_place import nearest, postures
from kinecast.robot.trajectory import Trajectory, minimum_jerk
from kinecast.robot.ur5 import UR5

try:
    from ompl import base as ob
    from ompl import geometric as og
    from ompl import util as ou
except ImportError as error:  # pragma: no cover - the tests install it
    raise MissingExtraError("the robot", "robot") from error

LIMITS = SPEED, ACCELERATION, JERK = np.array([1.57, 4.0, 75.0])
"""Greatest of an angle [rad/s, rad/s^2, rad/s^3]: half of the speed that the arm can do, as beside people nothing is
gained by more; less than half of its acceleration and jerk, the rest is for braking."""
TOLERANCE = 1.02
"""A motion that needs so many times its time to be within these is within them; others are slowed to as much less."""
SHORTEST = 0.4  # duration of the shortest motion [s]
WAYPOINTS, BENT_WAYPOINTS = 40, 24  # of a path, and of one that bends around people
LEG = 14  # waypoints of a straight leg between two corners
STRAIGHT_GOALS = 2  # goals tried from a straight way, the best first
SCENE_MARGINS = (0.005, 0.01, 0.015, 0.02)  # least distances from the scene that the descent keeps, in turn [m]
SEARCH_MARGINS = (0.003, 0.001)  # kept by searched paths [m], in turn: what follows them cuts corners
SEARCH_STEP = 0.07
"""Way over all angles between two looks at an edge [rad], 0.06 m at full reach; plans are checked finely again."""
SHORTCUTS = 60  # tries to shorten a path that was found
DRAWN_IN = (0.3, 0.3)  # distance from the arm's axis and height of a hand that is drawn in [m]
ROOM, ROOM_WORTH = 0.1, 2.0
"""So much room around a goal [m], from the scene and from the arm itself, is worth a later arrival [s/m]."""
_ONE_SEARCH_AT_A_TIME = threading.Lock()


class NoPlan(NamedTuple):
    """No motion was found."""

    reason: str  # in words
    crashed: bool = False  # whether the planner failed rather than found nothing


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
        self, q: Float[np.ndarray, "6"], goals: Float[np.ndarray, "G 6"], start_time: float
    ) -> Trajectory | NoPlan:
        """A motion to whichever goal is reached soonest and free, with room around it.

        Args:
            q: (6,) where the arm rests at the start time [rad].
            goals: (G, 6) [rad], any of them will do.
            start_time: when the motion starts [s].

        Returns:
            A motion that was checked, from rest to rest, or why there is none.
        """
        if self.checker.touched(q):
            return NoPlan("the arm touches the scene or itself")
        if len(goals) == 0:
            return NoPlan("the goal is out of reach")
        goals = self._usable(q, goals)
        if not len(goals):
            return NoPlan("the goal is blocked by the scene or the arm itself")
        for goal in goals[:STRAIGHT_GOALS]:
            found = self._pushed(np.stack([q, goal]), start_time)
            if isinstance(found, Trajectory):
                return found
        for attempt in range(self.searches):
            margin = SEARCH_MARGINS[attempt % len(SEARCH_MARGINS)]
            corners = searched(self.checker, q, goals, margin, self.iterations, attempt)
            if corners is None:
                continue
            for way in (self._pushed, self._legs):
                found = way(corners, start_time)
                if isinstance(found, Trajectory):
                    return found
        return NoPlan(f"{found} is in the way; no way around it")

    def bent(self, trajectory: Trajectory, times: Float[np.ndarray, " T"], people: People) -> Iterator[Trajectory]:
        """Ways to where a plan leads that bend where speed would be lost beside people: from its own side, and inside.

        Args:
            trajectory: the plan with nobody there.
            times: (T,) increasing, T of 1 or more [s].
            people: where they may be at these times; they are no obstacles, they cost time.
        """
        q, goal, start_time = trajectory.q[0], trajectory.q[-1], float(trajectory.times[0])
        for corners in (np.stack([q, goal]), *self._inside(q, goal)):
            path, passed = _along(corners, BENT_WAYPOINTS, start_time)
            beside = People(interpolated(passed, times, people.capsules), people.separation)
            path, _ = self._chomp.optimise(path, SCENE_MARGINS[0], beside)
            bent = Trajectory(passed, path).within(LIMITS, TOLERANCE)
            if not self.checker.check(bent):
                yield bent

    def _inside(self, q: Float[np.ndarray, "6"], goal: Float[np.ndarray, "6"]) -> list[Float[np.ndarray, "3 6"]]:
        """Corners of a way past the arm's own foot, the hand drawn in; none where it cannot be."""
        start, end = (self.arm.forward_kinematics(each)[:3, 3] for each in (q, goal))
        turn = 0.5 * (math.atan2(start[1], start[0]) + math.atan2(end[1], end[0]))
        T = np.diag([1.0, -1.0, -1.0, 1.0])
        T[:3, 3] = DRAWN_IN[0] * math.cos(turn), DRAWN_IN[0] * math.sin(turn), DRAWN_IN[1]
        found = nearest(postures(self.arm, T), 0.5 * (q + goal), self.arm.q_range, 1)
        return [np.stack([q, middle, goal]) for middle in found]

    def _usable(self, q: Float[np.ndarray, "6"], goals: Float[np.ndarray, "G 6"]) -> Float[np.ndarray, "U 6"]:
        """Goals that are free, the best first: soon reached, with room around."""
        clear = np.array([self.checker.clearance(goal) for goal in goals])
        price = [_duration(goal - q) for goal in goals] - ROOM_WORTH * np.minimum(clear, ROOM).sum(axis=1)
        best = np.argsort(price, kind="stable")
        return goals[best[(clear[best] > 0).all(axis=1)]]

    def _pushed(self, corners: Float[np.ndarray, "M 6"], start_time: float) -> Trajectory | str:
        """A checked motion along corners that CHOMP has pushed free, or what was in its way."""
        path, times = _along(corners, WAYPOINTS, start_time)
        blocked = ""
        for margin in SCENE_MARGINS:
            path, excess = self._chomp.optimise(path, margin)
            trajectory = Trajectory(times, path).within(LIMITS, TOLERANCE)
            blocked = self.checker.check(trajectory)
            if not blocked:
                return trajectory
            if excess <= 0:
                break  # stuck: wider margins would not free it
        return blocked

    def _legs(self, corners: Float[np.ndarray, "M 6"], start_time: float) -> Trajectory | str:
        """A checked motion straight from corner to corner, at rest in each, or what was in its way."""
        times, q = [np.array([start_time])], [corners[:1]]
        for start, goal in pairwise(corners):
            times.append(times[-1][-1] + np.linspace(0.0, _duration(goal - start), LEG)[1:])
            q.append(start + minimum_jerk(LEG)[1:, None] * (goal - start))
        trajectory = Trajectory(np.concatenate(times), np.concatenate(q))
        return self.checker.check(trajectory) or trajectory


def searched(
    checker: CollisionChecker,
    start: Float[np.ndarray, "6"],
    goals: Float[np.ndarray, "G 6"],
    margin: float,
    iterations: int,
    seed: int = 0,
) -> Float[np.ndarray, "M 6"] | None:
    """Corners of a free path from the start to any of the goals, by RRTConnect, shortened; None where none is found.

    It looks half a turn around start and goals, within the range: whole turns more lead nowhere new.

    Args:
        checker: the arm and its scene.
        start: (6,) [rad].
        goals: (G, 6) [rad].
        margin: kept from the scene and the arm itself [m].
        iterations: of the search at most, about 0.5 ms each.
        seed: of the search; the same seed gives the same path.
    """
    left = count(iterations, -1)
    ends, bounds = np.stack([start, *goals]), ob.RealVectorBounds(6)
    low = np.maximum(ends.min(axis=0) - np.pi, checker.arm.q_range[:, 0])
    high = np.minimum(ends.max(axis=0) + np.pi, checker.arm.q_range[:, 1])
    with _ONE_SEARCH_AT_A_TIME:
        ou.setLogLevel(ou.LOG_NONE)  # what it finds is in what it returns
        # Generators made from here on follow from this seed, whatever OMPL's error would say.
        ou.RNG.setSeed(seed + 1)
        space = ob.RealVectorStateSpace(6)
        for j in range(6):
            bounds.setLow(j, float(low[j]))
            bounds.setHigh(j, float(high[j]))
        space.setBounds(bounds)
        setup = og.SimpleSetup(space)
        information = setup.getSpaceInformation()
        information.setStateValidityCheckingResolution(SEARCH_STEP / space.getMaximumExtent())
        setup.setStateValidityChecker(lambda state: not checker.touched(_angles(state), margin))
        setup.addStartState(_state(space, start))
        targets = ob.GoalStates(information)
        for goal in goals:
            targets.addState(_state(space, goal))
        setup.setGoal(targets)
        setup.setPlanner(og.RRTConnect(information))
        setup.solve(ob.PlannerTerminationCondition(lambda: next(left) <= 0))
        if not setup.haveExactSolutionPath():
            return None
        path = setup.getSolutionPath()
        og.PathSimplifier(information).partialShortcutPath(path, SHORTCUTS)
        return np.array([_angles(state) for state in path.getStates()])


def _angles(state: ob.State) -> Float[np.ndarray, "6"]:
    return np.array([state[j] for j in range(6)])


def _state(space: ob.RealVectorStateSpace, q: Float[np.ndarray, "6"]) -> ob.State:
    state = space.allocState()
    for j, angle in enumerate(q):
        state[j] = float(angle)
    return state


def _along(
    corners: Float[np.ndarray, "M 6"], waypoints: int, start_time: float
) -> tuple[Float[np.ndarray, "W 6"], Float[np.ndarray, " W"]]:
    """Waypoints along straight legs, with the speed of least jerk over all of them, and their times [s]."""
    legs = np.linalg.norm(np.diff(corners, axis=0), axis=1)
    keep = np.concatenate([[True], legs > 0])
    along = np.concatenate([[0.0], np.cumsum(legs)])[keep]
    share = minimum_jerk(waypoints) * along[-1]
    path = interpolated(share, along, corners[keep])
    return path, start_time + np.linspace(0.0, _duration(np.abs(np.diff(path, axis=0)).sum(axis=0)), waypoints)


def _duration(way: Float[np.ndarray, "6"]) -> float:
    """Of a motion of least jerk from rest to rest along a way of each angle [rad], within the limits [s]."""
    longest = float(np.abs(way).max())
    return max(
        1.875 * longest / SPEED, (5.7735 * longest / ACCELERATION) ** 0.5, (60 * longest / JERK) ** (1 / 3), SHORTEST
    )
