"""Rollouts: inside Eq. 4's bounds always, the joint Gaussian where nothing binds, Eq. 2's law where something does."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy import stats

from kinecast.body.limits import AngleLimit, JointLimits, bounds, posture_bounds, violations
from kinecast.body.posture import (
    ANGLES,
    coordinates_from_postures,
    postures_from_coordinates,
    postures_from_points,
)
from kinecast.prediction.method import Method
from kinecast.prediction.observation import Observation
from kinecast.prediction.rollout import UNIFORM, Bounds, Rollout, hold, polar, roll_positions, roll_series

DT = 1.0 / 30.0
T = 3
START = np.array([0, 0, 0, 0, 0, 0.36, 0.4, 0.3, -0.5, 1.2, 0.30, 0.26, 0.5, 0.2, -0.4, 1.4, 0.28, 0.24])
FREE = posture_bounds(None)
TIGHT = JointLimits(
    flexion=AngleLimit(-1.0, 0.52, 2.0),
    abduction=AngleLimit(-0.9, 0.31, 2.0),
    axial_rotation=AngleLimit(-1.7, -0.35, 2.0),
    elbow=AngleLimit(0.0, 1.42, 2.0),
)


def gaussian(rng: np.random.Generator, spread: float) -> tuple[np.ndarray, np.ndarray]:
    """Mean (T, 18) near START and the factor of a covariance that ties all steps and coordinates together."""
    mean = coordinates_from_postures(START) + 0.02 * np.arange(1, T + 1)[:, None]
    mixing = np.tril(rng.standard_normal((18 * T, 18 * T))) * 0.2
    np.fill_diagonal(mixing, 1.0)
    mixing /= np.linalg.norm(mixing, axis=1, keepdims=True)
    scale = np.tile(np.where(np.isin(np.arange(18), [5, 10, 11, 16, 17]), 0.1 * spread, spread), T)
    return mean, scale[:, None] * mixing


def noise(rng: np.random.Generator, draws: int) -> tuple[np.ndarray, np.ndarray]:
    return rng.standard_normal((draws, 18 * T)), rng.random((draws, T, 8))


def rolled(
    mean: np.ndarray,
    factor: np.ndarray,
    initial: np.ndarray,
    normals: np.ndarray,
    uniforms: np.ndarray,
    within: Bounds,
) -> np.ndarray:
    """Draws of the joint Gaussian, held inside bounds."""
    drawn = postures_from_coordinates(mean + (normals @ factor.T).reshape(len(normals), T, 18))
    return hold(drawn, mean, np.linalg.norm(factor, axis=1).reshape(T, 18), initial, uniforms, within, DT)


def assert_inside(postures: np.ndarray, initial: np.ndarray, limits: JointLimits) -> None:
    """Every angle within Eq. 4's bounds from the draw before it, to the last bit."""
    lower, upper, speed = limits.of_posture()
    for s in range(len(postures)):
        before = initial
        for now in postures[s]:
            for d in ANGLES:
                lb, ub = bounds(lower[d], upper[d], speed[d], before[d], DT)
                assert lb <= now[d] <= ub
            before = now


@pytest.mark.parametrize("spread", [1e-12, 0.01, 0.1, 1.0, 30.0])
def test_every_gaussian_draw_is_inside_the_bounds_of_equation_4(spread: float) -> None:
    rng = np.random.default_rng(0)
    mean, factor = gaussian(rng, spread)
    postures = rolled(mean, factor, START, *noise(rng, 150), posture_bounds(TIGHT))
    assert np.isfinite(postures).all()
    assert_inside(postures, START, TIGHT)
    for broken in violations(postures, START, DT, TIGHT):
        assert not broken.any()


@pytest.mark.parametrize("shift", [-2.0, 2.0])
def test_a_mean_far_outside_is_held_at_the_edge(shift: float) -> None:
    rng = np.random.default_rng(1)
    mean, factor = gaussian(rng, 0.01)
    postures = rolled(mean + shift, factor, START, *noise(rng, 50), posture_bounds(TIGHT))
    assert_inside(postures, START, TIGHT)
    lower, upper, speed = TIGHT.of_posture()
    edge = bounds(lower[6], upper[6], speed[6], START[6], DT)[int(shift > 0)]
    np.testing.assert_allclose(postures[:, 0, 6], edge, atol=1e-3)


def test_a_start_outside_its_range_comes_back_at_full_speed() -> None:
    rng = np.random.default_rng(2)
    outside = START.copy()
    outside[[6, 9, 12]] = [0.9, 1.9, -1.4]
    mean, factor = gaussian(rng, 0.1)
    postures = rolled(mean, factor, outside, *noise(rng, 100), posture_bounds(TIGHT))
    assert_inside(postures, outside, TIGHT)
    reach = 2.0 * DT * np.arange(1, T + 1)
    np.testing.assert_allclose(postures[:, :, 6], np.broadcast_to(0.9 - reach, (100, T)), atol=1e-12)
    np.testing.assert_allclose(postures[:, :, 9], np.broadcast_to(1.9 - reach, (100, T)), atol=1e-12)
    np.testing.assert_allclose(postures[:, :, 12], np.broadcast_to(-1.4 + reach, (100, T)), atol=1e-12)


def test_without_bounds_draws_are_the_joint_gaussian() -> None:
    rng = np.random.default_rng(3)
    mean, factor = gaussian(rng, 0.03)
    count = 4000
    postures = rolled(mean, factor, START, *noise(rng, count), FREE)
    drawn = coordinates_from_postures(postures).reshape(count, -1)
    covariance = factor @ factor.T
    deviation = np.sqrt(np.diag(covariance))
    # Standard errors of a mean and of a covariance of Gaussian draws; 5 of them over 54 + 54² numbers.
    assert (np.abs(drawn.mean(axis=0) - mean.ravel()) < 5 * deviation / math.sqrt(count)).all()
    error = np.sqrt((np.outer(deviation**2, deviation**2) + covariance**2) / count)
    assert (np.abs(np.cov(drawn.T) - covariance) < 5 * error).all()


def test_without_bounds_draws_are_the_linear_map_of_their_normals() -> None:
    rng = np.random.default_rng(4)
    mean, factor = gaussian(rng, 0.05)
    normals, uniforms = noise(rng, 30)
    postures = rolled(mean, factor, START, normals, uniforms, FREE)
    expected = mean + (normals @ factor.T).reshape(30, T, 18)
    np.testing.assert_allclose(coordinates_from_postures(postures), expected, atol=1e-12)


def test_limits_that_never_bind_change_nothing() -> None:
    rng = np.random.default_rng(5)
    mean, factor = gaussian(rng, 0.02)
    draws = noise(rng, 50)
    wide = JointLimits()
    np.testing.assert_array_equal(
        rolled(mean, factor, START, *draws, posture_bounds(wide)),
        rolled(mean, factor, START, *draws, FREE),
    )


def test_where_a_bound_binds_the_first_step_follows_the_truncated_normal() -> None:
    rng = np.random.default_rng(6)
    mean = np.repeat(coordinates_from_postures(START)[None], T, axis=0)
    factor = 0.05 * np.eye(18 * T)
    postures = rolled(mean, factor, START, *noise(rng, 4000), posture_bounds(TIGHT))
    lower, upper, speed = TIGHT.of_posture()
    for d in (6, 7, 12, 13):
        lb, ub = bounds(lower[d], upper[d], speed[d], START[d], DT)
        peer = stats.truncnorm((lb - START[d]) / 0.05, (ub - START[d]) / 0.05, START[d], 0.05)
        assert stats.kstest(postures[:, 0, d], peer.cdf).pvalue > 1e-3
    # θ3 and θ4 are drawn as a pair, and redrawn from their own laws to first order.
    for d, spread in ((8, 0.05 / START[9]), (9, 0.05)):
        lb, ub = bounds(lower[d], upper[d], speed[d], START[d], DT)
        peer = stats.truncnorm((lb - START[d]) / spread, (ub - START[d]) / spread, START[d], spread)
        assert stats.kstest(postures[:, 0, d], peer.cdf).statistic < 0.05


def test_wrist_speed_binds_through_the_jacobian() -> None:
    rng = np.random.default_rng(7)
    mean, factor = gaussian(rng, 1.0)
    slow = JointLimits(wrist_speed=0.3)
    postures = rolled(mean, factor, START, *noise(rng, 60), posture_bounds(slow))
    position, speed = violations(postures, START, DT, slow)
    assert not position.any()
    assert not speed.any()
    # Each angle alone moves its wrist no faster than the limit; the longest lever is the straight arm.
    assert np.abs(postures[:, 0, 7] - START[7]).max() <= 0.3 * DT / 0.30 + 1e-9


def test_at_a_straight_elbow_draws_stay_finite_and_inside() -> None:
    rng = np.random.default_rng(8)
    straight = START.copy()
    straight[[9, 15]] = 0.0
    mean = np.repeat(coordinates_from_postures(straight)[None], T, axis=0)
    for factor in (0.05 * np.eye(18 * T), gaussian(rng, 0.05)[1]):
        limits = JointLimits(axial_rotation=AngleLimit(-0.7, 0.2, 12.0))
        postures = rolled(mean, factor, straight, *noise(rng, 200), posture_bounds(limits))
        assert np.isfinite(postures).all()
        assert_inside(postures, straight, limits)
        assert (postures[:, :, [9, 15]] >= 0.0).all()


def test_bones_never_shrink_to_nothing() -> None:
    rng = np.random.default_rng(9)
    mean = np.repeat(coordinates_from_postures(START)[None], T, axis=0)
    postures = rolled(mean, np.eye(18 * T), START, *noise(rng, 100), FREE)
    assert postures[:, :, [5, 10, 11, 16, 17]].min() == 0.05


def test_no_draws_are_no_trouble() -> None:
    rng = np.random.default_rng(10)
    mean, factor = gaussian(rng, 0.1)
    assert rolled(mean, factor, START, *noise(rng, 0), FREE).shape == (0, T, 18)


def test_polar_is_first_order_away_from_a_straight_elbow() -> None:
    rng = np.random.default_rng(11)
    a, b, sd_a, sd_b = 0.6, -0.8, 0.02, 0.05
    x, y = a + sd_a * rng.standard_normal(40_000), b + sd_b * rng.standard_normal(40_000)
    m3, sd3, m4, sd4 = polar(a, b, sd_a, sd_b, -1.0)
    assert m3 == pytest.approx(math.atan2(b, a))
    assert m4 == pytest.approx(1.0)
    assert sd3 == pytest.approx(np.arctan2(y, x).std(), rel=0.03)
    assert sd4 == pytest.approx(np.hypot(x, y).std(), rel=0.03)


@pytest.mark.parametrize(("a", "b"), [(0.0, 0.0), (1e-12, 0.0), (0.0, 1e-4)])
@pytest.mark.parametrize(("sd_a", "sd_b"), [(0.1, 0.1), (1.0, 1e-6), (1e-6, 1.0)])
def test_polar_never_says_more_than_that_nothing_is_known(a: float, b: float, sd_a: float, sd_b: float) -> None:
    m3, sd3, m4, sd4 = polar(a, b, sd_a, sd_b, 7.0)
    assert abs(m3 - 7.0) <= math.pi + 1e-12
    assert 0.0 < sd3 <= UNIFORM
    assert m4 >= 0.0
    assert sd4 > 0.0


def series_draws(
    method: Method, observation: Observation, limits: JointLimits | None, draws: int, noise_sd: float = 0.0
) -> tuple[Rollout, np.ndarray, np.ndarray]:
    """What roll_series gives; the normals behind them; the last observed posture."""
    rng = np.random.default_rng(12)
    track = postures_from_points(observation.points, continuous=True)
    normals = rng.standard_normal((draws, method.steps, 18))
    offsets = noise_sd * rng.standard_normal((draws, 18))
    uniforms = rng.random((draws, method.steps, 8))
    made = roll_series(
        coordinates_from_postures(track), offsets, method.processes, method.length_spread, track[-1],
        normals, uniforms, posture_bounds(limits), method.dt,
    )  # fmt: skip
    return made, normals, track[-1]


def test_free_series_are_their_means_and_spreads(trained: dict[str, Method[Any]], observation: Observation) -> None:
    (postures, means, spreads, *_), normals, initial = series_draws(trained["gp_angles"], observation, None, 70)
    angles = [0, 1, 2, 3, 4, 5, *ANGLES]
    np.testing.assert_allclose(postures[..., angles], (means + spreads * normals)[..., angles], atol=1e-12)
    assert (spreads > 0).all()
    # All samples share the first step's law; bones keep one error over all steps, about their last length.
    assert np.ptp(means[:, 0], axis=0).max() < 1e-9
    bones = [10, 11, 16, 17]
    np.testing.assert_allclose(means[:, :, bones], np.broadcast_to(initial[bones], means[:, :, bones].shape))
    np.testing.assert_allclose(postures[..., bones], (means + spreads * normals[:, :1])[..., bones], atol=1e-12)


def test_the_number_of_draws_does_not_change_a_draw(trained: dict[str, Method[Any]], observation: Observation) -> None:
    for count in (1, 3, 17):
        (some, *_), normals, _ = series_draws(trained["gp_constrained"], observation, JointLimits(), count)
        assert some.shape == (count, trained["gp_angles"].steps, 18)
        assert normals.shape == some.shape
        assert np.isfinite(some).all()


@pytest.mark.parametrize("noise_sd", [0.0, 0.5])
def test_every_series_draw_is_inside_the_bounds_of_equation_4(
    trained: dict[str, Method[Any]], posed: Observation, noise_sd: float
) -> None:
    initial = np.array([0.1, 0.3, -0.5, 0.6])
    tight = JointLimits(*(AngleLimit(a - 0.4, a + 0.01, 1.0) for a in initial))
    (postures, *_), _, start = series_draws(trained["gp_angles"], posed, tight, 150, noise_sd)
    assert_inside(postures, start, tight)


def test_series_of_positions_are_their_means_and_spreads(
    trained: dict[str, Method[Any]], observation: Observation
) -> None:
    method = trained["gp_xyz"]
    rng = np.random.default_rng(13)
    normals = rng.standard_normal((20, method.steps, 18))
    window = observation.positions.reshape(-1, 18)
    positions, means, spreads = roll_positions(window, np.zeros((20, 18)), method.processes, normals)
    np.testing.assert_allclose(positions, means + spreads * normals, atol=1e-12)
    assert (spreads > 0).all()
    # A sample's law depends on nothing but its own past: fed back as the window, it is the first step's law.
    later = np.concatenate([window[1:], positions[7, :1]])
    _, again, widths = roll_positions(later, np.zeros((1, 18)), method.processes, normals[:1])
    np.testing.assert_allclose(again[0, 0], means[7, 1], atol=1e-9)
    np.testing.assert_allclose(widths[0, 0], spreads[7, 1], atol=1e-9)
