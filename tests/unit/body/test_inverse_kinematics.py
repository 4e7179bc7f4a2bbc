"""Inverse kinematics: closed form with continuity, damped least squares for any chain."""

from __future__ import annotations

import numpy as np
import pytest

from kinecast.body.arm import forward_kinematics, jacobian
from kinecast.body.arm_angles import LEFT, RIGHT
from kinecast.body.denavit_hartenberg import Link, link_frames
from kinecast.body.inverse_kinematics import LeastSquaresOptions, closed_form, damped_least_squares
from kinecast.body.limits import JointLimits
from kinecast.body.posture import postures_from_points
from kinecast.errors import OptionError

ARM = np.array([0.31, 0.26])
HAND = np.array([0.31, 0.26, 0.18])
LIMITS = JointLimits()


def solve(target: np.ndarray, start: np.ndarray, lengths: np.ndarray, **options: float) -> tuple[np.ndarray, bool]:
    """Left arm to this target from this start."""
    count = len(start)
    solution = damped_least_squares(
        lambda theta: forward_kinematics(theta, lengths, LEFT),
        lambda theta: jacobian(theta, lengths, LEFT),
        target,
        start,
        LIMITS.lower[:count],
        LIMITS.upper[:count],
        LeastSquaresOptions(**options),  # type: ignore[arg-type]
    )
    assert np.all(LIMITS.lower[:count] <= solution.theta)
    assert np.all(solution.theta <= LIMITS.upper[:count])
    missed = np.linalg.norm(forward_kinematics(solution.theta, lengths, LEFT) - target)
    assert solution.residual == pytest.approx(missed, abs=1e-12)
    return solution.theta, solution.converged


@pytest.mark.parametrize("side", [LEFT, RIGHT])
def test_closed_form_gives_points_and_angles_back(side: float) -> None:
    rng = np.random.default_rng(1)
    theta = rng.uniform(LIMITS.lower[:4] + 0.2, LIMITS.upper[:4] - 0.2, (200, 4))
    for angles in theta:
        points = forward_kinematics(angles, ARM, side)
        found, lengths = closed_form(points[:1], points[1:], side, previous=angles)
        np.testing.assert_allclose(found[0], angles, atol=1e-10)
        np.testing.assert_allclose(lengths[0], ARM, atol=1e-15)


def test_closed_form_is_continuous_along_a_path() -> None:
    time = np.linspace(0.0, 2.0 * np.pi, 300)
    middle = np.array([0.6, 0.9, -0.3, 1.2])
    swing = np.array([0.7, 0.8, 0.6, 1.2])  # through a straight elbow, past shoulder height
    theta = middle + swing * np.sin(time[:, None] + np.arange(4))
    points = forward_kinematics(theta, ARM, LEFT)
    found, _ = closed_form(points[:, 0], points[:, 1], LEFT)
    np.testing.assert_allclose(found, theta, atol=1e-9)


def test_closed_form_is_the_arm_of_a_posture() -> None:
    rng = np.random.default_rng(2)
    points = np.zeros((40, 6, 3))
    points[:, :3, 1], points[:, 3:, 1] = 0.2, -0.2
    points[:, [1, 2, 4, 5]] += np.cumsum(0.1 * rng.standard_normal((40, 4, 3)), axis=0)
    postures = postures_from_points(points)
    for first, at, side in ((0, 6, LEFT), (3, 12, RIGHT)):
        relative = points[:, first + 1 : first + 3] - points[:, first : first + 1]
        theta, lengths = closed_form(relative[:, 0], relative[:, 1], side)
        np.testing.assert_allclose(theta, postures[:, at : at + 4], atol=1e-14)
        np.testing.assert_allclose(lengths, postures[:, at + 4 : at + 6], atol=1e-15)


def test_closed_form_passes_nan_on_and_bridges_it() -> None:
    points = np.repeat(forward_kinematics(np.array([[0.3, 0.2, -0.4, 1.0]]), ARM, LEFT), 3, axis=0)
    points[1, 1] = np.nan
    theta, lengths = closed_form(points[:, 0], points[:, 1], LEFT)
    np.testing.assert_array_equal(np.isnan(theta[1]), [False, False, True, True])
    np.testing.assert_array_equal(np.isnan(lengths[1]), [False, True])
    np.testing.assert_array_equal(theta[2], theta[0])
    with pytest.raises(OptionError, match=r"side 2\.0"):
        closed_form(points[:, 0], points[:, 1], 2.0)


@pytest.mark.parametrize("lengths", [ARM, HAND])
def test_least_squares_follows_an_arm_from_nearby(lengths: np.ndarray) -> None:
    rng = np.random.default_rng(3)
    count = {2: 4, 3: 7}[len(lengths)]
    lower, upper = LIMITS.lower[:count], LIMITS.upper[:count]
    for _ in range(15):
        theta = rng.uniform(lower, upper)
        target = forward_kinematics(theta, lengths, LEFT)
        _, converged = solve(target, np.clip(theta + 0.2 * rng.standard_normal(count), lower, upper), lengths)
        assert converged


def test_least_squares_finds_an_arm_from_far_away() -> None:
    rng = np.random.default_rng(4)
    reached = 0
    for _ in range(15):
        theta = rng.uniform(LIMITS.lower, LIMITS.upper)
        _, converged = solve(forward_kinematics(theta, HAND, LEFT), np.zeros(7), HAND, restarts=20)
        reached += converged
    assert reached >= 14


def test_least_squares_leaves_a_straight_elbow() -> None:
    target = forward_kinematics(np.array([0.5, 0.3, -0.2, 1.5]), ARM, LEFT)
    # Pulled straight back along the arm, the elbow has no gradient to bend it.
    back = np.array([[0.0, 0.0, -0.31], [0.0, 0.0, -0.31 - 0.1]])
    theta, converged = solve(target, np.zeros(4), ARM)
    assert converged
    assert theta[3] == pytest.approx(1.5, abs=1e-4)
    assert not solve(back, np.zeros(4), ARM)[1]  # a forearm cannot become shorter


def test_out_of_reach_gives_the_nearest_arm_and_says_so() -> None:
    target = np.array([[0.31, 0.0, 0.0], [1.0, 0.0, 0.0]])
    theta, converged = solve(target, np.array([0.2, 0.1, 0.0, 0.4]), ARM)
    assert not converged
    np.testing.assert_allclose(forward_kinematics(theta, ARM, LEFT)[1], [0.57, 0.0, 0.0], atol=2e-3)


def test_beyond_the_range_stops_at_its_end() -> None:
    target = forward_kinematics(np.array([-1.5, 0.0, 0.0, 0.5]), ARM, LEFT)
    theta, converged = solve(target, np.array([0.0, 0.0, 0.0, 0.5]), ARM, restarts=0)
    assert not converged
    assert theta[0] == pytest.approx(LIMITS.flexion.lower)


def test_nan_target_gives_the_start_and_nan() -> None:
    start = np.array([0.1, 0.2, 0.3, 0.4])
    solution = damped_least_squares(
        lambda theta: forward_kinematics(theta, ARM, LEFT),
        lambda theta: jacobian(theta, ARM, LEFT),
        np.full((2, 3), np.nan),
        start,
        LIMITS.lower[:4],
        LIMITS.upper[:4],
    )
    np.testing.assert_array_equal(solution.theta, start)
    assert np.isnan(solution.residual)
    assert not solution.converged


def test_least_squares_serves_any_chain_and_unbounded_angles() -> None:
    """A planar two-link chain from its Denavit-Hartenberg table, Jacobian by differences."""
    links = (Link(0.0, 0.0, a=1.0), Link(0.0, 0.0, a=0.5))

    def tip(theta: np.ndarray) -> np.ndarray:
        return link_frames(links, theta)[-1, :3, 3]

    def slope(theta: np.ndarray) -> np.ndarray:
        return np.stack([(tip(theta + e) - tip(theta - e)) / 2e-6 for e in 1e-6 * np.eye(2)], axis=-1)

    free = np.full(2, np.inf)
    solution = damped_least_squares(tip, slope, np.array([0.3, 0.9, 0.0]), np.zeros(2), -free, free)
    assert solution.converged
    np.testing.assert_allclose(tip(solution.theta), [0.3, 0.9, 0.0], atol=1e-6)


def test_options_out_of_range_are_refused_by_value() -> None:
    with pytest.raises(OptionError, match=r"tolerance 0\.0"):
        LeastSquaresOptions(tolerance=0.0)
    with pytest.raises(OptionError, match="iterations 0"):
        LeastSquaresOptions(iterations=0)
    with pytest.raises(OptionError, match="restarts -1"):
        LeastSquaresOptions(restarts=-1)
    with pytest.raises(OptionError, match="angle 1"):
        damped_least_squares(
            lambda theta: theta,
            lambda theta: np.diag(np.ones_like(theta)),
            np.zeros(2),
            np.zeros(2),
            np.zeros(2),
            np.array([1.0, -1.0]),
        )
