"""Postures and points are one and the same thing, wherever the arms are."""

from __future__ import annotations

import numpy as np
from hypothesis import example, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from kinecast.body.limits import JointLimits, bounds, violations
from kinecast.body.posture import (
    ANGLES,
    LEFT_ARM,
    LENGTHS,
    RIGHT_ARM,
    USUAL_RANGE,
    block_log_det,
    coordinates_from_postures,
    other_branch,
    points_from_postures,
    postures_from_coordinates,
    postures_from_points,
)

coordinate = st.floats(-1.0, 1.0) | st.sampled_from([0.0, 0.25, 0.25 + 1e-13, 0.25 + 1e-9, 1e-300])
points = arrays(np.float64, (6, 3), elements=coordinate)
angle = st.floats(-3.2, 3.2)
previous_postures = arrays(np.float64, 18, elements=angle | st.just(np.nan))


@st.composite
def postures(draw: st.DrawFn, margin: float = 0.05) -> np.ndarray:
    """Postures of a person: angles within the usual range, bones and shoulders of some width."""
    posture = np.array(draw(arrays(np.float64, 18, elements=st.floats(0.0, 1.0))))
    posture[:3] -= 0.5
    posture[3] = 6.0 * posture[3] - 3.0
    posture[4] = 2.8 * posture[4] - 1.4
    posture[list(LENGTHS)] = 0.1 + 0.4 * posture[list(LENGTHS)]
    for arm in (LEFT_ARM, RIGHT_ARM):
        lower, upper = np.array(USUAL_RANGE).T
        posture[arm] = lower + margin + (upper - lower - 2 * margin) * posture[arm]
    return posture


def _sine_of_degeneracy(posture: np.ndarray) -> float:
    return float(np.min(np.abs([np.cos(posture[[7, 13]]), np.sin(posture[[9, 15]])])))


TINY = 7.5e-158
"""Its square is no longer held to all digits."""
NARROW = np.full((6, 3), TINY)
NARROW[0, :2], NARROW[2, 0] = 0.0, 1.0
SHORT = np.array([[0, 0.2, 0], [TINY, 0.2, -3 * TINY], [1, 0.2, 0], [0, -0.2, 0], [0, -0.2, 2 * TINY], [0, -0.2, 1]])


@settings(max_examples=300)
@given(points, previous_postures)
@example(NARROW, np.full(18, np.nan))
@example(SHORT, np.full(18, np.nan))
def test_points_come_back_from_any_posture(x: np.ndarray, previous: np.ndarray) -> None:
    for start in (None, previous):
        back = points_from_postures(postures_from_points(x[None], start))[0]
        np.testing.assert_allclose(back, x, rtol=0, atol=1e-12)


@settings(max_examples=200)
@given(postures())
def test_a_posture_comes_back_when_it_is_the_previous_one(posture: np.ndarray) -> None:
    x = points_from_postures(posture)
    tolerance = 1e-13 / _sine_of_degeneracy(posture) + 1e-11
    back = postures_from_points(x[None], posture)[0]
    np.testing.assert_allclose(back, posture, rtol=0, atol=tolerance)


@settings(max_examples=200)
@given(postures())
def test_both_branches_are_the_same_points(posture: np.ndarray) -> None:
    other = posture.copy()
    other[LEFT_ARM] = other_branch(posture[LEFT_ARM])
    other[RIGHT_ARM] = other_branch(posture[RIGHT_ARM])
    np.testing.assert_allclose(points_from_postures(other), points_from_postures(posture), atol=1e-14)
    np.testing.assert_allclose(block_log_det(other), block_log_det(posture), atol=1e-9)


@settings(max_examples=200)
@given(postures())
def test_smooth_coordinates_come_back(posture: np.ndarray) -> None:
    back = postures_from_coordinates(coordinates_from_postures(posture))
    np.testing.assert_allclose(back, posture, rtol=0, atol=1e-12)


@settings(max_examples=60)
@given(postures(margin=0.3))
def test_the_jacobians_determinant_is_that_of_finite_differences(posture: np.ndarray) -> None:
    step = 1e-6
    shifted = np.array([posture + sign * step * np.eye(18) for sign in (1.0, -1.0)])
    ahead, behind = points_from_postures(shifted).reshape(2, 18, 18)
    _, numeric = np.linalg.slogdet((ahead - behind) / (2 * step))
    # Central differences are good to about 1e-9, the logarithm to that over its smallest factor.
    tolerance = 1e-7 / _sine_of_degeneracy(posture)
    assert abs(numeric - block_log_det(posture).sum()) < tolerance


@settings(max_examples=100)
@given(postures(margin=-0.6), st.integers(0, 2**32 - 1))
def test_whoever_keeps_the_bounds_violates_nothing(start: np.ndarray, seed: int) -> None:
    """Also from a start outside its range, and also when only the points of the steps are known."""
    rng, limits, dt = np.random.default_rng(seed), JointLimits(), 1.0 / 30.0
    start[[9, 15]] = np.clip(start[[9, 15]], 0.05, 3.0)
    lower, upper, speed = limits.of_posture()
    path = np.tile(start, (15, 1))
    before = start
    for now in path:
        for i in ANGLES:
            lb, ub = bounds(lower[i], upper[i], speed[i], before[i], dt)
            assert lb <= ub
            now[i] = rng.uniform(lb, ub) if rng.uniform() < 0.7 else rng.choice([lb, ub])
        before = now
    position, fast = violations(path[None], start, dt, limits)
    assert not position.any()
    assert not fast.any()
    x = points_from_postures(path)
    again = postures_from_points(x, start)
    clear = min(_sine_of_degeneracy(posture) for posture in path) > 1e-3
    if clear:
        np.testing.assert_allclose(again, path, rtol=0, atol=1e-9)
        position, fast = violations(again, start, dt, limits)
        assert not position.any()
        assert not fast.any()
