"""Paths by RRTConnect: free, shortened, the same for the same seed."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from kinecast.robot.collision import CollisionChecker
from kinecast.robot.seeding import searched
from kinecast.robot.ur5 import UR5

from .conftest import AWAY, HOME, WALL, posts


def test_a_path_leads_from_the_start_to_a_goal_and_is_free_the_same_for_the_same_seed(arm: UR5) -> None:
    checker = CollisionChecker(arm, posts(*WALL))
    paths = [searched(checker, HOME, AWAY[None], 0.003, 5000, seed) for seed in (3, 4, 3)]
    for corners in paths:
        assert corners is not None
        np.testing.assert_allclose(corners[[0, -1]], [HOME, AWAY], atol=1e-12)
        assert not any(checker.touched(q) for leg in pairwise(corners) for q in np.linspace(*leg, 200))
    np.testing.assert_array_equal(paths[0], paths[2])
    assert paths[0].shape != paths[1].shape or not np.allclose(paths[0], paths[1])


def test_it_stops_when_iterations_or_time_are_over(arm: UR5) -> None:
    walled = CollisionChecker(arm, posts(*WALL))
    for seconds, iterations in ((30.0, 2), (0.0, 10**9)):
        assert searched(walled, HOME, AWAY[None], 0.003, iterations, seconds=seconds) is None


def test_a_blocked_end_has_no_path(arm: UR5) -> None:
    blocked = CollisionChecker(arm, posts([-0.4, -0.3, 0.1, -0.4, -0.3, 0.4, 0.1]))
    assert searched(blocked, HOME, AWAY[None], 0.003, 10) is None
    assert searched(blocked, AWAY, HOME[None], 0.003, 10) is None
