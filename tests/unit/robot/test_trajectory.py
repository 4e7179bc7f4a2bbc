"""The spline through the waypoints."""

from __future__ import annotations

import numpy as np
import pytest

from kinecast.errors import OptionError
from kinecast.robot.trajectory import Trajectory, minimum_jerk


def wavy() -> Trajectory:
    times = 3.0 + np.linspace(0, 2, 12)
    q = np.random.default_rng(0).normal(0, 0.3, (12, 6)).cumsum(axis=0)
    return Trajectory(times, q)


def test_it_passes_its_waypoints_and_ends_at_rest() -> None:
    path = wavy()
    np.testing.assert_allclose(path.at(path.times)[0], path.q, atol=1e-9)
    _, qd, qdd, _ = path.derivatives(np.array([3.0, 5.0]))
    np.testing.assert_allclose(qd, 0.0, atol=1e-9)
    np.testing.assert_allclose(qdd, 0.0, atol=1e-7)


def test_derivatives_are_those_of_the_angles() -> None:
    path, step = wavy(), 1e-6
    times = np.linspace(3.01, 4.99, 50)
    values = path.derivatives(times)
    later, earlier = path.derivatives(times + step), path.derivatives(times - step)
    for k in range(3):
        np.testing.assert_allclose((later[k] - earlier[k]) / (2 * step), values[k + 1], rtol=1e-4, atol=1e-3)


def test_before_and_after_it_rests() -> None:
    path = wavy()
    for t, waypoint in ((-10.0, 0), (9.0, -1)):
        q, qd = path.at(t)
        np.testing.assert_allclose(q, path.q[waypoint], atol=1e-9)
        assert not qd.any()


def test_stretched_it_takes_the_same_way_more_slowly() -> None:
    path = wavy()
    slow = path.stretched(2.0)
    assert slow.duration == pytest.approx(4.0)
    np.testing.assert_allclose(slow.at(4.0)[0], path.at(3.5)[0], atol=1e-9)
    np.testing.assert_allclose(slow.at(4.0)[1], path.at(3.5)[1] / 2, atol=1e-9)


def peaks(path: Trajectory) -> np.ndarray:
    """(3,) greatest speed, acceleration and jerk."""
    return np.array([np.abs(rate).max() for rate in path.derivatives(np.linspace(*path.times[[0, -1]], 2001))[1:]])


def test_its_excess_is_how_much_longer_it_should_take() -> None:
    limits = np.array([1.0, 3.0, 20.0])
    slow = wavy().stretched(wavy().excess(limits, 2001))
    assert (peaks(slow) / limits).max() == pytest.approx(1.0)
    usual = Trajectory(np.linspace(0.0, 1.0, 40), minimum_jerk(40)[:, None] * np.ones(6))
    np.testing.assert_allclose(peaks(usual), [1.875, 10 / 3**0.5, 60.0], rtol=2e-3)


@pytest.mark.parametrize(
    ("times", "q"),
    [
        (np.array([0.0]), np.zeros((1, 6))),
        (np.array([0.0, 1.0]), np.zeros((3, 6))),
        (np.array([0.0, 0.0]), np.zeros((2, 6))),
        (np.array([0.0, np.nan]), np.zeros((2, 6))),
        (np.array([0.0, 1.0]), np.full((2, 6), np.inf)),
    ],
)
def test_what_is_no_trajectory_is_refused(times: np.ndarray, q: np.ndarray) -> None:
    with pytest.raises((OptionError, TypeError)):
        Trajectory(times, q)
