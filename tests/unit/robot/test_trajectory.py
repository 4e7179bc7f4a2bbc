"""The spline through the waypoints."""

from __future__ import annotations

import numpy as np
import pytest

from kinecast.robot.trajectory import Trajectory, minimum_jerk


def wavy() -> Trajectory:
    times = 3.0 + np.linspace(0, 2, 12)
    q = np.random.default_rng(0).normal(0, 0.3, (12, 6)).cumsum(axis=0)
    return Trajectory(times, q)


def test_it_passes_its_waypoints_and_ends_at_rest() -> None:
    path = wavy()
    np.testing.assert_allclose(path.at(path.times), path.q, atol=1e-9)
    for order in (1, 2):
        np.testing.assert_allclose(path.at(np.array([3.0, 5.0]), order), 0.0, atol=1e-7)


def test_derivatives_are_those_of_the_angles() -> None:
    path, step = wavy(), 1e-6
    times = np.linspace(3.01, 4.99, 50)
    for k in range(3):
        numeric = (path.at(times + step, k) - path.at(times - step, k)) / (2 * step)
        np.testing.assert_allclose(numeric, path.at(times, k + 1), rtol=1e-4, atol=1e-3)


def test_before_and_after_it_rests() -> None:
    path = wavy()
    for t, waypoint in ((-10.0, 0), (9.0, -1)):
        np.testing.assert_allclose(path.at(t), path.q[waypoint], atol=1e-9)
        assert not path.at(t, 1).any()


def peaks(path: Trajectory) -> np.ndarray:
    """(3,) greatest speed, acceleration and jerk."""
    rates = (path.at(np.linspace(*path.times[[0, -1]], 2001), order) for order in (1, 2, 3))
    return np.array([np.abs(rate).max() for rate in rates])


def test_within_limits_it_takes_the_same_way_more_slowly() -> None:
    limits, path = np.array([1.0, 3.0, 20.0]), wavy()
    slow = path.within(limits)
    assert (peaks(slow) / limits).max() == pytest.approx(1.0, rel=1e-2)
    np.testing.assert_allclose(slow.at(3.0 + 0.25 * slow.duration), path.at(3.5), atol=1e-9)
    assert slow.within(1.05 * limits) is slow
    usual = Trajectory(np.linspace(0.0, 1.0, 40), minimum_jerk(40)[:, None] * np.ones(6))
    np.testing.assert_allclose(peaks(usual), [1.875, 10 / 3**0.5, 60.0], rtol=2e-3)
