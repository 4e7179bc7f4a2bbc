"""A path around what is in the way, by OMPL's RRTConnect: where the descent begins if it fails from a straight way."""

from __future__ import annotations

import itertools
import math
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

__all__ = ["searched"]

STEP = 0.07
"""Way over all angles between two looks at an edge [rad], 0.06 m at full reach; plans are checked finely again."""
SHORTCUTS = 60
"""Tries to shorten a path that was found."""
_ONE_AT_A_TIME = threading.Lock()


def searched(
    checker: CollisionChecker,
    start: Float[np.ndarray, "6"],
    goals: Float[np.ndarray, "G 6"],
    margin: float,
    iterations: int,
    seed: int = 0,
    seconds: float = math.inf,
) -> Float[np.ndarray, "M 6"] | None:
    """Corners of a free path from the start to any of the goals, shortened; None where none is found.

    It looks half a turn around start and goals, within the range: whole turns more lead nowhere new.

    Args:
        checker: the arm and its scene.
        start: (6,) [rad].
        goals: (G, 6) [rad].
        margin: kept from the scene and the arm itself [m].
        iterations: of the search at most, about 0.5 ms each, and
        seed: of it; the same seed gives the same path as long as time suffices.
        seconds: to search at most.
    """
    free = [goal for goal in goals if not checker.touched(goal, margin)]
    if not free or checker.touched(start, margin):
        return None
    end, left = time.perf_counter() + seconds, itertools.count(iterations, -1)
    ends, bounds = np.stack([start, *free]), ob.RealVectorBounds(6)
    low = np.maximum(ends.min(axis=0) - np.pi, checker.arm.q_range[:, 0])
    high = np.minimum(ends.max(axis=0) + np.pi, checker.arm.q_range[:, 1])
    with _ONE_AT_A_TIME:
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
        information.setStateValidityCheckingResolution(STEP / space.getMaximumExtent())
        setup.setStateValidityChecker(lambda state: not checker.touched(_angles(state), margin))
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


def _angles(state: ob.State) -> Float[np.ndarray, "6"]:
    return np.array([state[j] for j in range(6)])


def _state(space: ob.RealVectorStateSpace, q: Float[np.ndarray, "6"]) -> ob.State:
    state = space.allocState()
    for j, angle in enumerate(q):
        state[j] = float(angle)
    return state
