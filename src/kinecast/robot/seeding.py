"""A path around what is in the way, by OMPL's RRTConnect: where the descent begins if it fails from a straight way.

The search knows no time: whatever a person may fill during the motion is in the way all the time.
"""

from __future__ import annotations

import itertools
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
from jaxtyping import Float

from kinecast.errors import MissingExtraError
from kinecast.robot.clearance import edge_is_free
from kinecast.robot.collision import CollisionChecker
from kinecast.robot.occupancy import Occupancy

try:
    from ompl import base as ob
    from ompl import geometric as og
    from ompl import util as ou
except ImportError as error:  # pragma: no cover - the tests install it
    raise MissingExtraError("the robot", "robot") from error

__all__ = ["Seeder", "evenly"]

STEP = 0.05
"""Largest change of an angle between two looks [rad]: 0.05 m at the arm's full reach of 0.85 m; plans are checked
finely again."""
_ONE_AT_A_TIME = threading.Lock()


class Seeder:
    """Searches paths for one moment's surroundings.

    Args:
        checker: the arm and its scene.
        occupancy: of persons.
        times: (T,) instants of the motion [s]; capsules of all of them are in the way.
        margins: kept from persons, the scene and the arm itself [m].
    """

    def __init__(
        self,
        checker: CollisionChecker,
        occupancy: Occupancy,
        times: Float[np.ndarray, " T"],
        margins: tuple[float, float, float],
    ) -> None:
        rows = occupancy.rows_at(times)
        self.capsules = np.ascontiguousarray(np.unique(rows.reshape(-1, 7), axis=0))
        self.obstacles = np.ascontiguousarray(checker.scene.rows(times).reshape(-1, 17))
        self.first_link = np.tile(checker.first_link, len(times))
        self.obstacles, kept = np.unique(self.obstacles, axis=0, return_index=True)
        self.first_link = self.first_link[kept]
        self.checker = checker
        self.margins = margins

    def edge_is_free(self, start: Float[np.ndarray, "6"], end: Float[np.ndarray, "6"]) -> bool:
        """Whether the straight way between two configurations keeps the margins; the start is not looked at."""
        return bool(
            edge_is_free(
                start, end, STEP, self.checker.body, self.capsules, self.obstacles, self.first_link, self.margins
            )
        )

    def keeps(self, q: Float[np.ndarray, "6"]) -> bool:
        """Whether a configuration keeps the margins."""
        return self.edge_is_free(q, q)

    def path(
        self,
        start: Float[np.ndarray, "6"],
        goals: Float[np.ndarray, "G 6"],
        seconds: float,
        iterations: int,
        seed: int = 0,
    ) -> Float[np.ndarray, "M 6"] | None:
        """Corners of a free path from the start to any of the goals, shortened; None where none is found in time.

        Args:
            start: (6,) [rad].
            goals: (G, 6) [rad].
            seconds: to search, and
            iterations: of the search, whichever ends first.
            seed: of the search; the same seed gives the same path as long as time suffices.
        """
        free = [goal for goal in goals if self.keeps(goal)]
        if not free or not self.keeps(start):
            return None
        end = time.perf_counter() + seconds
        with _ONE_AT_A_TIME, _quiet():
            corners = self._searched(start, free, end, iterations, seed)
        return None if corners is None else self._shortened(corners, np.random.default_rng(seed), end)

    def _searched(
        self, start: Float[np.ndarray, "6"], goals: list[Float[np.ndarray, "6"]], end: float, iterations: int, seed: int
    ) -> Float[np.ndarray, "M 6"] | None:
        # Generators made from here on follow from this seed, whatever OMPL's error says that _quiet keeps back.
        ou.RNG.setSeed(seed + 1)
        space = ob.RealVectorStateSpace(6)
        bounds = ob.RealVectorBounds(6)
        low, high = _box(start, np.array(goals), self.checker.arm.q_range)
        for j in range(6):
            bounds.setLow(j, float(low[j]))
            bounds.setHigh(j, float(high[j]))
        space.setBounds(bounds)
        information = ob.SpaceInformation(space)
        information.setStateValidityChecker(lambda state: self.keeps(_angles(state)))
        information.setMotionValidator(_Edges(information, self))
        information.setup()
        problem = ob.ProblemDefinition(information)
        problem.addStartState(_state(space, start))
        targets = ob.GoalStates(information)
        for goal in goals:
            targets.addState(_state(space, goal))
        problem.setGoal(targets)
        planner = og.RRTConnect(information)
        planner.setProblemDefinition(problem)
        planner.setup()
        left = itertools.count(iterations, -1)
        planner.solve(ob.PlannerTerminationCondition(lambda: next(left) <= 0 or time.perf_counter() > end))
        if not problem.hasExactSolution():
            return None
        path = problem.getSolutionPath()
        return np.array([_angles(state) for state in path.getStates()])

    def _shortened(
        self, corners: Float[np.ndarray, "M 6"], rng: np.random.Generator, end: float
    ) -> Float[np.ndarray, "C 6"]:
        """The path with free shortcuts between random places on it."""
        for _ in range(60):
            if len(corners) < 3 or time.perf_counter() > end:
                break
            legs = np.linalg.norm(np.diff(corners, axis=0), axis=1)
            along = np.concatenate([[0.0], np.cumsum(legs)])
            a, b = np.sort(rng.uniform(0.0, along[-1], 2))
            i, j = np.searchsorted(along, [a, b], side="right") - 1
            if i == j:
                continue
            p, q = (np.array([np.interp(s, along, column) for column in corners.T]) for s in (a, b))
            if self.edge_is_free(p, q):
                corners = np.concatenate([corners[: i + 1], p[None], q[None], corners[j + 1 :]])
        return corners


class _Edges(ob.MotionValidator):  # type: ignore[misc]
    """Looks at a whole edge in one compiled call."""

    def __init__(self, information: ob.SpaceInformation, seeder: Seeder) -> None:
        super().__init__(information)
        self._seeder = seeder

    def checkMotion(self, start: ob.State, end: ob.State) -> bool:  # noqa: N802 - OMPL's name
        return self._seeder.edge_is_free(_angles(start), _angles(end))


def evenly(corners: Float[np.ndarray, "M 6"], shares: Float[np.ndarray, " W"]) -> Float[np.ndarray, "W 6"]:
    """Places on a path of straight legs at shares (W,) of its length, 0..1."""
    legs = np.linalg.norm(np.diff(corners, axis=0), axis=1)
    along = np.concatenate([[0.0], np.cumsum(legs)])
    keep = np.concatenate([[True], legs > 0])
    return np.stack([np.interp(shares * along[-1], along[keep], column[keep]) for column in corners.T], axis=1)


def _box(
    start: Float[np.ndarray, "6"], goals: Float[np.ndarray, "G 6"], q_range: Float[np.ndarray, "6 2"]
) -> tuple[Float[np.ndarray, "6"], Float[np.ndarray, "6"]]:
    """Where to search: half a turn around start and goals, within the range; whole turns more lead nowhere new."""
    places = np.concatenate([start[None], goals])
    return (
        np.maximum(places.min(axis=0) - np.pi, q_range[:, 0]),
        np.minimum(places.max(axis=0) + np.pi, q_range[:, 1]),
    )


def _angles(state: ob.State) -> Float[np.ndarray, "6"]:
    return np.array([state[j] for j in range(6)])


def _state(space: ob.RealVectorStateSpace, q: Float[np.ndarray, "6"]) -> ob.State:
    state = space.allocState()
    for j in range(6):
        state[j] = float(q[j])
    return state


@contextmanager
def _quiet() -> Iterator[None]:
    """OMPL says nothing meanwhile: what it finds is in what it returns."""
    before = ou.getLogLevel()
    ou.setLogLevel(ou.LOG_NONE)
    try:
        yield
    finally:
        ou.setLogLevel(before)
