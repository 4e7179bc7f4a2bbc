"""Probabilities over samples, and the speed from which the arm can stop."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module

import numpy as np
import pytest

from kinecast.robot.failsafe import FailsafeOptions, free_speed
from kinecast.robot.occupancy import Occupancy, OccupancyOptions
from kinecast.robot.overlap import reach_probabilities
from kinecast.robot.ur5 import UR5
from kinecast.types import Prediction

HOME = np.array([-0.86, -1.51, -1.55, -1.64, 1.57, 0.71])


def two_ways(share: float, samples: int = 100) -> Prediction:
    """The left wrist goes to x = 0.5 with this probability, and stays at x = 1 otherwise."""
    arms = np.array([[1.2, -0.2, 0.5], [1.2, -0.25, 0.2], [1.0, -0.2, 0.1]])
    arms = np.concatenate([arms, arms + np.array([0.0, 2.0, 0.0])])
    drawn = np.repeat(np.repeat(arms[None, None], samples, axis=0), 15, axis=1)
    drawn[: round(share * samples), -1, 2, 0] = 0.5
    times = np.arange(1, 16) / 30
    return Prediction(0.0, times, drawn, drawn.mean(axis=0), np.zeros((15, 6, 3, 3)), ("",) * 6)


@pytest.mark.parametrize("share", [0.0, 0.2, 0.7, 1.0])
def test_probabilities_are_shares_of_samples(share: float) -> None:
    prediction = two_ways(share)
    cubes = np.array([[0.45, -0.2, 0.05], [0.45, 0.6, 0.05]])
    np.testing.assert_allclose(reach_probabilities(prediction, cubes, 0.06), [share, 0.0])


def test_a_limb_that_is_not_known_may_be_anywhere() -> None:
    prediction = two_ways(0.0)
    prediction.samples[:10, 3, 2] = np.nan
    assert reach_probabilities(prediction, np.array([[5.0, 5.0, 5.0]]), 0.1)[0] == pytest.approx(0.1)


def turning(rate: float) -> Callable[[np.ndarray], np.ndarray]:
    """The whole arm turns about its base."""
    return lambda seconds: HOME + np.outer(seconds, [rate, 0, 0, 0, 0, 0])


def post(arm: UR5, turn: float, radius: float = 0.1) -> Occupancy:
    """A post where the tool is after a turn."""
    x, y, _ = arm.forward_kinematics(HOME + turn * np.eye(6)[0])[:3, 3]
    start, end = np.array([[[x, y, 0.0]]]), np.array([[[x, y, 1.0]]])
    return Occupancy(0.0, np.zeros(1), start, end, np.full((1, 1), radius), 0.0, 0.0)


def test_full_speed_where_nobody_is_and_less_the_nearer_somebody_is(arm: UR5) -> None:
    options = FailsafeOptions()
    assert free_speed(arm, turning(1.5), 0.0, Occupancy.empty(), options) == 1.0
    speeds = [free_speed(arm, turning(1.5), 0.0, post(arm, turn), options) for turn in (1.6, 0.9, 0.75, 0.6, 0.52)]
    assert speeds[0] == 1.0
    assert speeds == sorted(speeds, reverse=True)
    assert speeds[-1] < 0.5


def test_the_arm_stops_in_time_from_the_speed_that_is_allowed(arm: UR5) -> None:
    options = FailsafeOptions(stopping=0.4)
    for turn in np.linspace(0.4, 1.2, 9):
        occupancy, path = post(arm, float(turn)), turning(1.5)
        speed = free_speed(arm, path, 0.0, occupancy, options)
        way = speed * (options.reaction + options.stopping * speed)
        body = arm.body_points(path(np.linspace(0.0, way, 30)))
        distance = occupancy.signed_distance(body.positions, np.zeros(30))[0] - body.radius
        standing = distance[0].min()
        assert distance.min() >= min(0.0, standing) - 1e-9


def test_it_slows_gently_while_there_is_still_time_to_stop(arm: UR5) -> None:
    turns, far = np.linspace(0.5, 1.3, 11), FailsafeOptions()
    late, early = (
        np.array([free_speed(arm, turning(1.5), 0.0, post(arm, float(turn)), options) for turn in turns])
        for options in (FailsafeOptions(foresight=0.0), far)
    )
    assert (early <= late).all()
    assert (early >= np.minimum(late, far.gentle)).all(), "it does not stop before it must"
    assert ((late == 1.0) & (early < 1.0)).any()


def test_in_somebodys_region_it_may_draw_back_but_not_go_on(arm: UR5) -> None:
    inside = post(arm, 0.1, 0.3)
    assert free_speed(arm, turning(1.0), 0.0, inside, FailsafeOptions()) == 0.0
    assert free_speed(arm, turning(-1.0), 0.0, inside, FailsafeOptions()) > 0.9


def test_radii_are_those_of_the_occupied_space() -> None:
    prediction, cube = two_ways(1.0), np.array([[0.5 - 0.1 - 0.06 - 0.15, -0.2, 0.1]])
    thick = OccupancyOptions(hand=0.3)
    assert reach_probabilities(prediction, cube, 0.06)[0] == 0.0
    assert reach_probabilities(prediction, cube, 0.06, thick)[0] == 1.0
    assert import_module("kinecast.robot.body").TRUE_BODY.hand < OccupancyOptions().hand
