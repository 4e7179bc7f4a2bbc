"""Execution keeps to the path and to the arm's limits whatever is asked of it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from kinecast.errors import OptionError
from kinecast.robot.execution import Executor
from kinecast.robot.trajectory import Trajectory
from kinecast.robot.ur5 import UR5

from .conftest import HOME

DT = 0.008
END = HOME + np.array([-1.2, 0.3, -0.2, 0.4, 0.5, 1.0])


def path(start: np.ndarray = HOME, end: np.ndarray = END, seconds: float = 1.8) -> Trajectory:
    s = np.linspace(0, 1, 40)
    return Trajectory(5.0 + seconds * s, start + (10 * s**3 - 15 * s**4 + 6 * s**5)[:, None] * (end - start))


def run(executor: Executor, scale: Callable[[int], float] = lambda _: 1.0, most: int = 1000) -> np.ndarray:
    """(N, 3, 6) states until it has arrived."""
    states: list[tuple[np.ndarray, ...]] = []
    while not (states and executor.done) and len(states) < most:
        executor.step(scale(len(states)))
        states.append((executor.q, executor.qd, executor.qdd))
    return np.array(states)


def assert_within_limits(arm: UR5, states: np.ndarray, braked: bool = False) -> None:
    q, qd, qdd = states[:, 0], states[:, 1], states[:, 2]
    assert (np.abs(qd) <= arm.max_speed + 1e-9).all()
    assert (np.abs(qdd) <= arm.max_acceleration + 1e-9).all()
    assert (np.abs(np.diff(q, axis=0)) <= DT * arm.max_speed + 1e-9).all()
    assert (np.abs(np.diff(qd, axis=0)) <= DT * arm.max_acceleration + 1e-9).all()
    jerk = arm.stop_jerk if braked else arm.max_jerk
    assert (np.abs(np.diff(qdd, axis=0)) <= DT * jerk + 1e-9).all()


def off_the_path(states: np.ndarray, trajectory: Trajectory) -> float:
    """Greatest distance [rad] of a state from the nearest place of the path."""
    places = trajectory.at(np.linspace(trajectory.times[0], trajectory.times[-1], 4000))
    return float(max(np.abs(places - q).max(axis=1).min() for q in states[:, 0]))


def test_at_full_speed_it_arrives_as_planned(arm: UR5) -> None:
    executor = Executor(arm, DT, HOME)
    executor.follow(path())
    states = run(executor)
    np.testing.assert_allclose(states[-1], [END, np.zeros(6), np.zeros(6)], atol=1e-9)
    assert len(states) * DT == pytest.approx(1.8, abs=2 * DT)
    assert_within_limits(arm, states)
    times = 5.0 + DT * np.arange(1, len(states))
    np.testing.assert_allclose(states[:-1, 0], path().at(times), atol=1e-9)


@pytest.mark.parametrize(
    "scale",
    [
        lambda k: 0.0 if 80 < k < 160 else 1.0,
        lambda k: float(np.random.default_rng(k // 7).random()),
        lambda k: float(k % 2),
        lambda k: 0.1 if k < 60 else 1.0,
        lambda k: [np.nan, 1.0, -3.0, 7.0][k % 4],
    ],
    ids=["stop and go", "random", "flutter", "slow", "nonsense"],
)
def test_whatever_the_speed_it_stays_on_the_path_and_within_the_limits(arm: UR5, scale: Callable[[int], float]) -> None:
    executor = Executor(arm, DT, HOME)
    executor.follow(path())
    states = run(executor, scale)
    assert_within_limits(arm, states, braked=True)
    assert off_the_path(states, path()) < 2e-3
    # It brakes harder than it speeds up: where every other step says stop, it all but stands.
    fluttering = scale(0) != scale(1) and scale(1) == 1.0
    assert executor.done != fluttering
    assert not fluttering or np.abs(states[-1, 1]).max() < 0.1


@pytest.mark.parametrize("steps", range(5, 220, 15))
def test_it_brakes_within_a_quarter_of_a_second_wherever_it_is(arm: UR5, steps: int) -> None:
    executor = Executor(arm, DT, HOME)
    executor.follow(path())
    run(executor, most=steps)
    states = run(executor, lambda _: 0.0, most=round(0.25 / DT))
    assert executor.at_rest
    assert_within_limits(arm, states, braked=True)


def test_it_brakes_on_the_path(arm: UR5) -> None:
    executor = Executor(arm, DT, HOME)
    executor.follow(path())
    run(executor, most=110)
    expected, seconds = executor.stopping()
    assert seconds < 0.25
    states = run(executor, lambda _: 0.0, most=60)
    np.testing.assert_allclose(states[-1, 0], expected, atol=1e-6)
    assert np.abs(states[-1, 1]).max() < 1e-6
    assert off_the_path(states, path()) < 1e-3


def test_from_anywhere_else_it_is_led_to_the_start(arm: UR5) -> None:
    executor = Executor(arm, DT, HOME)
    executor.follow(path())
    first = run(executor, most=120)
    with pytest.raises(OptionError, match="while the arm moves"):
        executor.follow(path(HOME + 0.1, HOME - 0.5))
    stopping = run(executor, lambda _: 0.0, most=round(0.25 / DT))
    executor.follow(path(executor.q + 0.05, HOME - 0.5))
    assert executor.remaining > 1.8
    states = np.concatenate([first, stopping, run(executor, lambda k: 0.5 if k % 50 < 20 else 1.0)])
    assert_within_limits(arm, states, braked=True)
    np.testing.assert_allclose(states[-1, 0], HOME - 0.5, atol=1e-9)


def test_a_trajectory_too_fast_for_the_arm_is_followed_more_slowly(arm: UR5) -> None:
    executor = Executor(arm, DT, HOME)
    executor.follow(path(seconds=0.3))
    states = run(executor, lambda k: 0.0 if 20 < k < 40 else 1.0)
    assert_within_limits(arm, states, braked=True)
    np.testing.assert_allclose(states[-1, 0], END, atol=1e-9)


def test_without_a_trajectory_it_rests(arm: UR5) -> None:
    executor = Executor(arm, DT, HOME)
    assert executor.done
    states = run(executor, most=3)
    np.testing.assert_array_equal(states[-1], [HOME, np.zeros(6), np.zeros(6)])
    assert executor.stopping()[1] == 0
