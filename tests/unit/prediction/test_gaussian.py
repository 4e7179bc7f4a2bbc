"""Gaussian methods: the covariance is the residuals', noise adds to it, constraints act only where they bind."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from kinecast.body.limits import AngleLimit, JointLimits, posture_bounds, violations
from kinecast.body.posture import postures_from_points
from kinecast.geometry.scene import Scene
from kinecast.geometry.shapes import Box, Sphere
from kinecast.prediction.gaussian import (
    FLOOR,
    Examples,
    PositionGaussian,
    PostureGaussian,
    posture_examples,
    residual_factor,
    with_noise,
)
from kinecast.prediction.linear import zero_velocity
from kinecast.prediction.method import Method, forecast_in_scene
from kinecast.prediction.observation import Observation
from kinecast.prediction.training_windows import TrainingWindows

SAMPLES = 400


def test_residual_covariance_is_that_of_errors_on_left_out_folds() -> None:
    rng = np.random.default_rng(0)
    windows, futures = rng.standard_normal((40, 3, 2)), rng.standard_normal((40, 2, 2))
    folds = np.arange(40) % 4
    seen: list[set[int]] = []

    class Shift:
        def __init__(self, shift: float) -> None:
            self.shift = shift

        def mean(self, windows: np.ndarray) -> np.ndarray:
            return np.repeat(windows[:, -1:], 2, axis=1) + self.shift

        def to_arrays(self) -> dict[str, np.ndarray]:
            return {}

    def fit(_windows: np.ndarray, fitted: np.ndarray, inside: np.ndarray) -> Shift:
        seen.append(set(inside.tolist()))
        return Shift(float(fitted.mean()))

    factor = residual_factor(fit, Examples(windows, futures, folds))
    errors = [
        futures[folds == k] - Shift(float(futures[folds != k].mean())).mean(windows[folds == k]) for k in range(4)
    ]
    stacked = np.concatenate(errors).reshape(40, -1)
    np.testing.assert_allclose(factor @ factor.T, stacked.T @ stacked / 40 + FLOOR**2 * np.eye(4), atol=1e-12)
    assert seen == [{1, 2, 3}, {0, 2, 3}, {0, 1, 3}, {0, 1, 2}]


def test_noise_of_the_last_frame_is_one_error_for_all_steps() -> None:
    rng = np.random.default_rng(1)
    factor = np.linalg.cholesky(np.cov(rng.standard_normal((6, 50))) + np.eye(6))
    sd = np.array([0.5, 0.0, 2.0])
    noisy = with_noise(factor, sd)
    added = noisy @ noisy.T - factor @ factor.T
    np.testing.assert_allclose(added, np.tile(np.diag(sd**2), (2, 2)), atol=1e-12)
    assert with_noise(factor, np.zeros(3)) is factor


def test_samples_of_positions_have_the_stated_mean_and_covariance(
    trained: dict[str, Method[Any]], observation: Observation
) -> None:
    method = trained["damped_velocity"]
    assert isinstance(method, PositionGaussian)
    forecast = forecast_in_scene(method, None, observation, np.random.default_rng(2), 4000, None)
    errors = (observation.to_torso(forecast.samples) - observation.to_torso(forecast.mean)).reshape(4000, -1)
    covariance = method.cholesky @ method.cholesky.T
    deviation = np.sqrt(np.diag(covariance))
    assert (np.abs(errors.mean(axis=0)) < 5 * deviation / math.sqrt(4000)).all()
    tolerance = 5 * np.sqrt((np.outer(deviation**2, deviation**2) + covariance**2) / 4000)
    assert (np.abs(errors.T @ errors / 4000 - covariance) < tolerance).all()


def test_zero_velocity_means_the_last_frame(trained: dict[str, Method[Any]], observation: Observation) -> None:
    forecast = forecast_in_scene(trained["zero_velocity"], None, observation, np.random.default_rng(3), 10, None)
    np.testing.assert_allclose(forecast.mean, np.repeat(observation.positions[-1:], 3, axis=0), atol=1e-12)


@pytest.mark.parametrize("name", ["damped_velocity", "ridge_angles", "ridge_constrained", "gp_xyz", "gp_angles"])
def test_stated_noise_widens_the_spread_of_that_joint(
    trained: dict[str, Method[Any]], observation: Observation, name: str
) -> None:
    noisy = replace(observation, noise=np.array([0.0, 0.0, 0.05, 0.0, 0.0, 0.0]))
    spreads = [
        forecast_in_scene(trained[name], None, seen, np.random.default_rng(4), SAMPLES, None)
        .samples[:, 0]
        .std(axis=0)
        .mean(axis=-1)
        for seen in (observation, noisy)
    ]
    grown = spreads[1] - spreads[0]
    assert grown[2] > 0.02  # the left wrist, by about its own noise
    assert np.abs(grown[3:]).max() < 0.005  # not the right arm


def test_equal_generators_give_equal_forecasts(trained: dict[str, Method[Any]], observation: Observation) -> None:
    scene = Scene((Sphere(observation.positions[-1, 2] + np.array([0.08, 0.0, 0.0]), 0.07),))
    for name, method in trained.items():
        first, second = (
            forecast_in_scene(method, None, observation, np.random.default_rng(5), 30, scene) for _ in range(2)
        )
        np.testing.assert_array_equal(first.samples, second.samples, err_msg=name)
        other = forecast_in_scene(method, None, observation, np.random.default_rng(6), 30, scene)
        assert not np.array_equal(first.samples, other.samples), name


@pytest.mark.parametrize("base", ["kalman", "ridge"])
def test_limits_that_never_bind_leave_the_gaussian_as_it_is(
    trained: dict[str, Method[Any]], posed: Observation, base: str
) -> None:
    everything = AngleLimit(-2 * math.pi, 2 * math.pi, math.inf)
    loose = JointLimits(everything, everything, everything, everything)
    free = forecast_in_scene(trained[f"{base}_angles"], None, posed, np.random.default_rng(7), 200, None)
    held = forecast_in_scene(
        replace(trained[f"{base}_constrained"], limits=loose), None, posed, np.random.default_rng(7), 200, None
    )
    np.testing.assert_array_equal(held.samples, free.samples)
    for pose in free.samples[:20]:
        np.testing.assert_allclose(held.density.log_prob(pose), free.density.log_prob(pose), atol=1e-9)


def tight(observation: Observation, slack: float, speed: float = 2.0) -> JointLimits:
    """Limits that end just beyond where both arms are."""
    arms = postures_from_points(observation.points, continuous=True)[-1, 6:].reshape(2, 6)[:, :4]
    ranges = zip(arms.min(axis=0) - 0.6, arms.max(axis=0) + slack, strict=True)
    flexion, abduction, rotation, elbow = (AngleLimit(low, high, speed) for low, high in ranges)
    return JointLimits(flexion, abduction, rotation, AngleLimit(0.0, elbow.upper, speed))


@pytest.mark.parametrize("name", ["kalman_constrained", "ridge_constrained", "gp_constrained"])
@pytest.mark.parametrize("slack", [-0.05, 0.0, 0.02])
def test_constrained_samples_violate_nothing_counted_from_their_positions(
    trained: dict[str, Method[Any]], posed: Observation, name: str, slack: float
) -> None:
    limits = tight(posed, slack)
    wrist = posed.positions[-1, 2]
    ball = Sphere(wrist + np.array([0.04, 0.0, 0.03]), 0.04)
    table = Box(wrist - np.array([0.0, 0.0, 0.15]), np.array([0.4, 0.4, 0.2]))
    scene = Scene((ball, table))
    method = replace(trained[name], limits=limits)
    forecast = forecast_in_scene(method, None, posed, np.random.default_rng(8), SAMPLES, scene)
    assert 0 < forecast.effective_sample_size < SAMPLES
    assert (np.diff(forecast.accepted) <= 0).all()
    assert forecast.accepted[-1] == pytest.approx(forecast.effective_sample_size / SAMPLES)
    initial = postures_from_points(posed.points, continuous=True)[-1]
    postures = postures_from_points(posed.to_torso(forecast.samples), initial, continuous=True, usual=False)
    position, speed = violations(postures, initial, posed.dt, limits)
    assert not position.any()
    assert not speed.any()
    assert scene.free(forecast.samples, posed.times(method.steps)).all()
    np.testing.assert_allclose(forecast.mean, forecast.samples.mean(axis=0), atol=1e-12)
    # The same method without its constraints breaks them: they are what made the difference.
    free = forecast_in_scene(replace(method, limits=None), None, posed, np.random.default_rng(8), SAMPLES, scene)
    postures = postures_from_points(posed.to_torso(free.samples), initial, continuous=True, usual=False)
    assert violations(postures, initial, posed.dt, limits)[0].mean() > 0.1
    assert not scene.free(free.samples, posed.times(method.steps)).all()


def test_a_blocked_scene_is_said_and_leaves_the_samples(trained: dict[str, Method[Any]], posed: Observation) -> None:
    around = Scene((Sphere(posed.positions[-1].mean(axis=0), 2.0),))
    for name in ("kalman_constrained", "gp_constrained"):
        forecast = forecast_in_scene(trained[name], None, posed, np.random.default_rng(9), 50, around)
        assert forecast.effective_sample_size == 0
        assert forecast.effective_sample_size == 0
        np.testing.assert_array_equal(forecast.accepted, 0.0)
        assert np.isfinite(forecast.samples).all()
        assert np.isfinite(forecast.density.log_prob(forecast.mean)).all()


def test_one_sample_is_enough(trained: dict[str, Method[Any]], posed: Observation) -> None:
    for method in trained.values():
        forecast = forecast_in_scene(method, None, posed, np.random.default_rng(10), 1, Scene())
        assert forecast.samples.shape == (1, 3, 6, 3)
        assert not np.isnan(forecast.density.log_prob(forecast.mean)).any()


def test_posture_coordinates_are_continuous_from_window_to_future(windows: TrainingWindows) -> None:
    examples = posture_examples(windows.take(np.arange(40)))
    both = np.concatenate([examples.observed, examples.future], axis=1)
    angles = [3, 4, 6, 7, 12, 13]
    assert np.abs(np.diff(both, axis=1)[..., angles]).max() < math.pi


def test_posture_bounds_are_infinite_without_limits() -> None:
    lower, upper, speed, wrist = posture_bounds(None)
    assert np.isneginf(lower).all()
    assert np.isposinf([*upper, *speed, wrist]).all()
    assert posture_bounds(JointLimits(wrist_speed=1.5))[3] == 1.5
    assert posture_bounds(JointLimits())[3] == math.inf


def test_folds_of_a_single_recording_still_give_a_covariance(windows: TrainingWindows) -> None:
    one = windows.take(np.flatnonzero(windows.recording == 0)[:60])
    method = PostureGaussian.fit(lambda _w, _f, _folds: zero_velocity(6, 3), one, 0.002, None)
    assert method.cholesky.shape == (54, 54)
    assert (np.diag(method.cholesky) >= 0.99 * FLOOR).all()
