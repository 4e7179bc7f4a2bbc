"""The method `kinecast`: parts that do what they say, training that repeats itself, forecasts that hold."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from kinecast.body.limits import JointLimits, violations
from kinecast.body.posture import postures_from_points
from kinecast.prediction.kinecast.error_model import SCALES, AdaptiveScale, mixture_radius
from kinecast.prediction.kinecast.experts import DAMPED, TRIVIAL, forecasts, trivial_experts
from kinecast.prediction.kinecast.features import arm_views, time_basis
from kinecast.prediction.kinecast.fit import KinecastOptions, fitting_kinecast
from kinecast.prediction.kinecast.model import Kinecast, ablations, kinecast_from_arrays
from kinecast.prediction.kinecast.rolling_errors import RollingForecastErrors
from kinecast.prediction.kinecast.weights import HALF_LIVES, LEADS, LONG_RUN, fallback_weights
from kinecast.prediction.method import forecast_in_scene
from kinecast.prediction.model_file import ModelCard
from kinecast.prediction.observation import Observation, TrainingWindows
from kinecast.tasks.workers import Progress, Serial

SMALL = KinecastOptions(pseudo_inputs=12, network_steps=20, folds=2, networks=1)
NOISE = 0.002


def fit_kinecast(windows: TrainingWindows, options: KinecastOptions, progress: Progress | None = None) -> Kinecast:
    workers = Serial()
    fitted = fitting_kinecast(workers, windows, windows, JointLimits(), NOISE, options)
    return workers.results([fitted], progress)[0]


def card(method: Kinecast) -> ModelCard:
    assert method.limits is not None
    return ModelCard("kinecast", method.frames, method.steps, 1.0 / method.dt, limits=method.limits, noise=NOISE)


@pytest.fixture(scope="module")
def method(windows: TrainingWindows) -> Kinecast:
    return fit_kinecast(windows, SMALL)


class TestTraining:
    def test_the_same_seed_gives_the_same_model_to_the_last_bit(
        self, method: Kinecast, windows: TrainingWindows
    ) -> None:
        again = fit_kinecast(windows, SMALL).to_arrays()
        for name, array in method.to_arrays().items():
            np.testing.assert_array_equal(again[name], array, err_msg=name)

    def test_another_seed_gives_another(self, method: Kinecast, windows: TrainingWindows) -> None:
        told: list[tuple[int, int]] = []
        other = fit_kinecast(windows, replace(SMALL, seed=1), lambda done, total: told.append((done, total)))
        assert not np.array_equal(other.to_arrays()["expert2.W1"], method.to_arrays()["expert2.W1"])
        assert told == [(done, told[-1][1]) for done in range(1, told[-1][1] + 1)]

    def test_it_is_the_same_from_its_arrays(self, method: Kinecast, observation: Observation) -> None:
        again = kinecast_from_arrays(method.to_arrays(), card(method))
        one, other = (
            forecast_in_scene(each, each.init_state(), observation, np.random.default_rng(3), 50, None)
            for each in (method, again)
        )
        np.testing.assert_array_equal(one.samples, other.samples)
        np.testing.assert_array_equal(one.density.log_prob(one.mean), other.density.log_prob(other.mean))

    def test_a_model_of_other_steps_is_refused(self, method: Kinecast) -> None:
        with pytest.raises(ValueError, match="steps"):
            kinecast_from_arrays(method.to_arrays(), replace(card(method), steps=method.steps + 1))


class TestForecast:
    def test_samples_keep_the_limits(self, method: Kinecast, observation: Observation) -> None:
        forecast = forecast_in_scene(method, method.init_state(), observation, np.random.default_rng(0), 300, None)
        initial = postures_from_points(observation.points, continuous=True)[-1]
        postures = postures_from_points(observation.to_torso(forecast.samples), initial, usual=False)
        assert method.limits is not None
        assert not np.logical_or(*violations(postures, initial, observation.dt, method.limits)).any()

    def test_it_goes_along_with_whoever_stands_elsewhere_and_faces_elsewhere(
        self, method: Kinecast, observation: Observation
    ) -> None:
        turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
        shift = np.array([3.0, -2.0, 0.5])
        moved = replace(observation, positions=observation.positions @ turn.T + shift, up=turn @ observation.up)
        one = forecast_in_scene(method, method.init_state(), observation, np.random.default_rng(0), 40, None)
        other = forecast_in_scene(method, method.init_state(), moved, np.random.default_rng(0), 40, None)
        np.testing.assert_allclose(other.mean, one.mean @ turn.T + shift, atol=1e-9)
        np.testing.assert_allclose(other.samples, one.samples @ turn.T + shift, atol=1e-6)

    def test_left_and_right_are_the_same_in_a_mirror(self, method: Kinecast, observation: Observation) -> None:
        mirror = np.array([1.0, -1.0, 1.0])
        swapped = observation.positions[:, [3, 4, 5, 0, 1, 2]] * mirror
        one = forecasts(method.mixture.experts, observation.positions[None], method.steps)[0]
        other = forecasts(method.mixture.experts, swapped[None], method.steps)[0]
        np.testing.assert_allclose(other, one[:, :, [3, 4, 5, 0, 1, 2]] * mirror, atol=1e-9)

    def test_noise_given_by_the_camera_widens_it(self, method: Kinecast, observation: Observation) -> None:
        noisy = replace(observation, noise=np.full(6, 0.05))
        spread = [
            forecast_in_scene(method, method.init_state(), each, np.random.default_rng(0), 400, None)
            .samples.std(axis=0)
            .mean()
            for each in (observation, noisy)
        ]
        assert spread[1] > spread[0] + 0.01

    def test_every_stage_can_be_left_out(self, method: Kinecast, observation: Observation) -> None:
        for name, part in ablations(method).items():
            forecast = forecast_in_scene(part, part.init_state(), observation, np.random.default_rng(0), 20, None)
            assert np.isfinite(forecast.samples).all(), name
            assert np.isfinite(forecast.density.log_prob(forecast.mean)).all(), name


class TestParts:
    def test_trivial_experts_follow_a_straight_line(self) -> None:
        weights = trivial_experts(6, 15)
        line = np.arange(6) * 0.01
        forecasts = weights @ line
        np.testing.assert_allclose(forecasts[0], line[-1])
        undamped = [k for k, (degree, tau) in enumerate(DAMPED) if degree and np.isinf(tau)]
        assert undamped
        np.testing.assert_allclose(forecasts[undamped[0]], 0.05 + 0.01 * np.arange(1, 16), atol=1e-12)
        np.testing.assert_allclose(weights.sum(axis=-1), 1.0)

    def test_the_time_basis_is_orthonormal_and_smooth(self) -> None:
        basis = time_basis(15)
        np.testing.assert_allclose(basis.T @ basis, np.eye(6), atol=1e-10)
        assert time_basis(3).shape == (3, 3)

    def test_views_of_arms_come_back(self, windows: TrainingWindows) -> None:
        views = arm_views(windows.observed[:5])
        future = windows.future[:5]
        np.testing.assert_allclose(views.to_world(views.to_arms(future)[None])[0], future, atol=1e-12)

    def test_due_errors_are_means_of_what_came_due(self) -> None:
        errors = RollingForecastErrors(1, (1, 2), (1e9,))
        for k in range(6):
            errors.observe(np.full((6, 3), float(k)))
            errors.predicted(np.full((1, 2, 6, 3), float(k)))  # nothing moves: 1 behind, then 2
        np.testing.assert_allclose(errors.mean()[0, :, 0, 0], np.sqrt(3.0))
        np.testing.assert_allclose(errors.mean()[0, :, 1, 0], 2 * np.sqrt(3.0))
        errors.observe(np.full((6, 3), np.nan))
        np.testing.assert_allclose(errors.mean()[0, :, 0, 0], np.sqrt(3.0))

    @pytest.mark.parametrize("better", [0, 1, TRIVIAL])
    def test_the_fallback_goes_with_whoever_errs_least(self, better: int) -> None:
        due = np.full((TRIVIAL + 5, 6, len(LEADS), len(HALF_LIVES)), 0.03)
        due[-2 if better == 0 else better - 1, ..., LONG_RUN] = 0.02  # the mixture's own are the last but one
        weights = fallback_weights(due, 500)
        np.testing.assert_allclose(weights.sum(axis=0), 1.0)
        assert (weights[better] > 0.9).all()

    def test_the_fallback_begins_with_the_mixture(self) -> None:
        weights = fallback_weights(np.full((TRIVIAL + 5, 6, len(LEADS), len(HALF_LIVES)), np.nan), 0)
        assert (weights[0] > 0.9).all()

    def test_the_spread_grows_after_misses_and_shrinks_after_none(self, method: Kinecast) -> None:
        steps = method.steps
        for far, grows in ((10.0, True), (0.0, False)):
            scale = AdaptiveScale(method.error_model, steps)
            for _ in range(60):
                scale.observe(np.full((6, 3), far))
                scale.predicted(np.zeros((steps, 6, 3)), np.ones((steps, 6)), np.eye(3))
            assert (scale.factor > 1.2).all() if grows else (scale.factor < 0.9).all()

    def test_the_radius_of_a_unit_normal_is_known(self) -> None:
        # The 0.9 quantile of chi squared with three degrees of freedom is 6.2514.
        assert mixture_radius(np.eye(len(SCALES))[2], 0.9) == pytest.approx(np.sqrt(6.2514), abs=1e-4)
