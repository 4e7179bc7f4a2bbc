"""The descent: the smoothest path without obstacles, a free one past them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from kinecast.errors import OptionError
from kinecast.robot.attempt import Attempt
from kinecast.robot.chomp import ChompOptions, Surroundings, optimise, smoothest
from kinecast.robot.collision import CollisionChecker
from kinecast.robot.occupancy import Occupancy
from kinecast.robot.planner import PlannerOptions
from kinecast.robot.trajectory import Trajectory
from kinecast.robot.ur5 import UR5

from .conftest import HOME, staying

AWAY = HOME + np.array([-1.5, 0, 0, 0, 0, 0])
TIMES = np.linspace(0, 2, 40)
STILL = np.zeros(6)
POST = [-0.45, 0.0, 0.0, -0.45, 0.0, 0.15, 0.06]
"""Low enough to reach over."""


FAR = np.array([9.0, 0, 0, 9, 0, 0, 0])


def straight(velocity: np.ndarray = STILL, acceleration: np.ndarray = STILL) -> np.ndarray:
    return smoothest(HOME, AWAY, 40, 2 / 39, velocity, acceleration)


def around(checker: CollisionChecker, occupancy: Occupancy) -> Surroundings:
    return Attempt(checker, PlannerOptions(), HOME, occupancy, 0.0).surroundings(TIMES)


def test_from_rest_to_rest_it_is_the_polynomial_of_least_jerk() -> None:
    s = (TIMES / 2)[:, None]
    np.testing.assert_allclose(straight(), HOME + (10 * s**3 - 15 * s**4 + 6 * s**5) * (AWAY - HOME), atol=1e-7)


def test_from_a_moving_start_it_goes_on_as_it_came_and_no_other_way_has_less_jerk() -> None:
    velocity, acceleration = np.full(6, 0.5), np.full(6, -1.0)
    waypoints = straight(velocity, acceleration)

    def jerk(q: np.ndarray) -> float:
        _, _, _, third = Trajectory(TIMES, q, velocity, acceleration).derivatives(np.linspace(0, 2, 2000))
        return float((third**2).mean())

    rng = np.random.default_rng(0)
    for _ in range(10):
        other = waypoints.copy()
        other[1:-1] += 1e-4 * rng.standard_normal((38, 6))
        assert jerk(other) > jerk(waypoints)
    slope = Trajectory(TIMES, waypoints, velocity, acceleration).at(np.array([0.0]))[1]
    np.testing.assert_allclose(slope[0], velocity, atol=1e-9)


def test_without_obstacles_nothing_moves(arm: UR5) -> None:
    nothing = Surroundings(np.empty((40, 0, 7)), np.empty((40, 0, 17)), np.empty(0, dtype=np.int64))
    path, excess, _ = optimise(arm, straight(), straight(), nothing, ChompOptions())
    np.testing.assert_allclose(path, straight(), atol=1e-12)
    assert excess == np.inf


def test_it_goes_around_and_keeps_its_ends(arm: UR5, checker: CollisionChecker) -> None:
    surroundings, before = around(checker, staying(POST)), straight()
    assert not checker.check(Trajectory(TIMES, before), staying(POST)).free
    path, excess, iterations = optimise(arm, before, before, surroundings, ChompOptions())
    assert excess > 0
    assert iterations <= 100
    np.testing.assert_array_equal(path[[0, -1]], before[[0, -1]])
    found = checker.check(Trajectory(TIMES, path), staying(POST))
    assert found.free
    assert found.person > 0.005


def test_it_knows_when_a_place_is_free(arm: UR5, checker: CollisionChecker) -> None:
    """A post that is gone before the arm comes changes nothing; one that comes after it has passed neither."""
    gone = np.array([POST]) + FAR
    here = np.array([POST])
    for rows, times in (([here, gone], [0.2, 0.21]), ([gone, here], [1.8, 1.81])):
        capsules = np.stack(rows)
        region = Occupancy(0.0, np.array(times), capsules[..., :3], capsules[..., 3:6], capsules[..., 6], 0.0, 0.0)
        path, excess, _ = optimise(arm, straight(), straight(), around(checker, region), ChompOptions())
        assert excess > 0
        np.testing.assert_allclose(path, straight(), atol=1e-3)
    path, _, _ = optimise(arm, straight(), straight(), around(checker, staying(POST)), ChompOptions())
    assert np.abs(path - straight()).max() > 0.05


def test_angles_stay_within_their_range(checker: CollisionChecker) -> None:
    tight = UR5()
    tight.q_range = np.stack([straight().min(axis=0) - 0.02, straight().max(axis=0) + 0.02], axis=1)
    path, _, _ = optimise(tight, straight(), straight(), around(checker, staying(POST)), ChompOptions())
    assert (path >= tight.q_range[:, 0] - 1e-12).all()
    assert (path <= tight.q_range[:, 1] + 1e-12).all()


def test_where_there_is_no_way_it_says_so_and_stops(arm: UR5, checker: CollisionChecker) -> None:
    wall = staying(*[[-1.0, 0.0, z, 1.0, 0.0, z, 0.1] for z in np.arange(0.0, 1.6, 0.15)])
    _, excess, iterations = optimise(arm, straight(), straight(), around(checker, wall), ChompOptions())
    assert excess < 0
    assert iterations <= 100


def test_the_same_question_has_the_same_answer(arm: UR5, checker: CollisionChecker) -> None:
    one, other = (
        optimise(arm, straight(), straight(), around(checker, staying(POST)), ChompOptions())[0] for _ in range(2)
    )
    np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("change", [{"waypoints": 3}, {"person_zone": -1.0}, {"smooth_step": np.nan}])
def test_impossible_options_are_refused(change: dict[str, float]) -> None:
    with pytest.raises(OptionError):
        replace(ChompOptions(), **change)
