"""A path around what is in the way, by OMPL's RRTConnect: where the descent begins if it fails from a straight way."""

from __future__ import annotations

import itertools
import threading
import time

import numpy as np
from jaxtyping import Float

from kinecast.errors import MissingExtraError
from kinecast.robot.collision import CollisionChecker

try:
    from ompl import base as ob
    from ompl import geometric as og
    from ompl import util as ou
except ImportError as error:  # pragma: no cover - the tests install it
    raise MissingExtraError("the robot", "robot") from error

__all__ = ["evenly", "searched"]

SHORTCUTS = 60
"""Tries to shorten a path that was found."""
_ONE_AT_A_TIME = threading.Lock()


def searched(
    checker: CollisionChecker,
    start: Float[np.ndarray, "6"],
    goals: Float[np.ndarray, "G 6"],
    margin: float,
    seconds: float,
    iterations: int,
    seed: int = 0,
) -> Float[np.ndarray, "M 6"] | None:
    """Corners of a free path from the start to any of the goals, shortened; None where none is found in time.

    Args:
        checker: the arm and its scene.
        start: (6,) [rad].
        goals: (G, 6) [rad].
        margin: kept from the scene and the arm itself [m].
        seconds: to search, and
        iterations: of the search, whichever ends first.
        seed: of the search; the same seed gives the same path as long as time suffices.
    """
    free = [goal for goal in goals if not checker.touched(goal, margin)]
    if not free or checker.touched(start, margin):
        return None
    end, left = time.perf_counter() + seconds, itertools.count(iterations, -1)
    with _ONE_AT_A_TIME:
        ou.setLogLevel(ou.LOG_NONE)  # what it finds is in what it returns
        # Generators made from here on follow from this seed, whatever OMPL's error would say.
        ou.RNG.setSeed(seed + 1)
        space = ob.RealVectorStateSpace(6)
        space.setBounds(_bounds(np.stack([start, *free]), checker.arm.q_range))
        setup = og.SimpleSetup(space)
        information = setup.getSpaceInformation()
        setup.setStateValidityChecker(lambda state: not checker.touched(_angles(state), margin))
        information.setMotionValidator(_Edges(information, checker, margin))
        setup.addStartState(_state(space, start))
        targets = ob.GoalStates(information)
        for goal in free:
            targets.addState(_state(space, goal))
        setup.setGoal(targets)
        setup.setPlanner(og.RRTConnect(information))
        setup.solve(ob.PlannerTerminationCondition(lambda: next(left) <= 0 or time.perf_counter() > end))
        if not setup.haveExactSolutionPath():
            return None
        path = setup.getSolutionPath()
        og.PathSimplifier(information).partialShortcutPath(path, SHORTCUTS)
        return np.array([_angles(state) for state in path.getStates()])


class _Edges(ob.MotionValidator):  # type: ignore[misc]
    """Looks at an edge as finely as the arm needs, whatever share of the space that is."""

    def __init__(self, information: ob.SpaceInformation, checker: CollisionChecker, margin: float) -> None:
        super().__init__(information)
        self._checker, self._margin = checker, margin

    def checkMotion(self, start: ob.State, end: ob.State) -> bool:  # noqa: N802 - OMPL's name
        return self._checker.edge_is_free(_angles(start), _angles(end), self._margin)


def evenly(corners: Float[np.ndarray, "M 6"], shares: Float[np.ndarray, " W"]) -> Float[np.ndarray, "W 6"]:
    """Places on a path of straight legs at shares (W,) of its length, 0..1."""
    legs = np.linalg.norm(np.diff(corners, axis=0), axis=1)
    along = np.concatenate([[0.0], np.cumsum(legs)])
    keep = np.concatenate([[True], legs > 0])
    return np.stack([np.interp(shares * along[-1], along[keep], column[keep]) for column in corners.T], axis=1)


def _bounds(places: Float[np.ndarray, "P 6"], q_range: Float[np.ndarray, "6 2"]) -> ob.RealVectorBounds:
    """Where to search: half a turn around start and goals, within the range; whole turns more lead nowhere new."""
    bounds = ob.RealVectorBounds(6)
    for j, (low, high) in enumerate(q_range):
        bounds.setLow(j, float(max(places[:, j].min() - np.pi, low)))
        bounds.setHigh(j, float(min(places[:, j].max() + np.pi, high)))
    return bounds


def _angles(state: ob.State) -> Float[np.ndarray, "6"]:
    return np.array([state[j] for j in range(6)])


def _state(space: ob.RealVectorStateSpace, q: Float[np.ndarray, "6"]) -> ob.State:
    state = space.allocState()
    for j in range(6):
        state[j] = float(q[j])
    return state
