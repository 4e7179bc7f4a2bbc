"""The method `kinecast`: parts that do what they say, training that repeats itself, forecasts that hold."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from kinecast.body.limits import JointLimits, violations
from kinecast.body.posture import postures_from_points
from kinecast.prediction.kinecast.ablation import ablations
from kinecast.prediction.kinecast.calibration import LEVEL, AdaptiveScale
from kinecast.prediction.kinecast.features import arm_views, time_basis
from kinecast.prediction.kinecast.gate import DAMPED, TRIVIAL, guard, guard_memory, trivial_experts
from kinecast.prediction.kinecast.memory import DueErrors
from kinecast.prediction.kinecast.method import Horizon, horizon_from_arrays
from kinecast.prediction.kinecast.spread import SCALES, mixture_radius
from kinecast.prediction.kinecast.training import HorizonOptions, fitting_horizon
from kinecast.prediction.observation import Observation, TrainingWindows
from kinecast.tasks.workers import Progress, Serial

SMALL = HorizonOptions(pseudo_inputs=12, network_steps=20, folds=2, networks=1)
NOISE = 0.002


def fit_horizon(windows: TrainingWindows, options: HorizonOptions, progress: Progress | None = None) -> Horizon:
    workers = Serial()
    fitted = fitting_horizon(workers, windows, windows, JointLimits(), NOISE, options)
    return workers.results([fitted], progress)[0]


@pytest.fixture(scope="module")
def horizon(windows: TrainingWindows) -> Horizon:
    return fit_horizon(windows, SMALL)


class TestTraining:
    def test_the_same_seed_gives_the_same_model_to_the_last_bit(
        self, horizon: Horizon, windows: TrainingWindows
    ) -> None:
        again = fit_horizon(windows, SMALL).to_arrays()
        for name, array in horizon.to_arrays().items():
            np.testing.assert_array_equal(again[name], array, err_msg=name)

    def test_another_seed_gives_another(self, horizon: Horizon, windows: TrainingWindows) -> None:
        told: list[tuple[int, int]] = []
        other = fit_horizon(windows, replace(SMALL, seed=1), lambda done, total: told.append((done, total)))
        assert not np.array_equal(other.to_arrays()["expert2.W1"], horizon.to_arrays()["expert2.W1"])
        assert told == [(done, told[-1][1]) for done in range(1, told[-1][1] + 1)]

    def test_it_is_the_same_from_its_arrays(self, horizon: Horizon, observation: Observation) -> None:
        again = horizon_from_arrays(
            horizon.to_arrays(), horizon.frames, horizon.steps, horizon.dt, NOISE, horizon.limits
        )
        one, other = (each.forecast(observation, np.random.default_rng(3), 50) for each in (horizon, again))
        np.testing.assert_array_equal(one.samples, other.samples)
        np.testing.assert_array_equal(one.density.log_prob(one.mean), other.density.log_prob(other.mean))

    def test_a_model_of_other_steps_is_refused(self, horizon: Horizon) -> None:
        with pytest.raises(ValueError, match="steps"):
            horizon_from_arrays(horizon.to_arrays(), horizon.frames, horizon.steps + 1, horizon.dt, NOISE, None)


class TestForecast:
    def test_samples_keep_the_limits(self, horizon: Horizon, observation: Observation) -> None:
        forecast = horizon.forecast(observation, np.random.default_rng(0), 300)
        initial = postures_from_points(observation.points, continuous=True)[-1]
        postures = postures_from_points(observation.to_torso(forecast.samples), initial, usual=False)
        assert horizon.limits is not None
        assert not np.logical_or(*violations(postures, initial, observation.dt, horizon.limits)).any()

    def test_it_goes_along_with_whoever_stands_elsewhere_and_faces_elsewhere(
        self, horizon: Horizon, observation: Observation
    ) -> None:
        turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
        shift = np.array([3.0, -2.0, 0.5])
        moved = replace(observation, positions=observation.positions @ turn.T + shift, up=turn @ observation.up)
        one = horizon.forecast(observation, np.random.default_rng(0), 40)
        other = horizon.forecast(moved, np.random.default_rng(0), 40)
        np.testing.assert_allclose(other.mean, one.mean @ turn.T + shift, atol=1e-9)
        np.testing.assert_allclose(other.samples, one.samples @ turn.T + shift, atol=1e-6)

    def test_left_and_right_are_the_same_in_a_mirror(self, horizon: Horizon, observation: Observation) -> None:
        mirror = np.array([1.0, -1.0, 1.0])
        swapped = observation.positions[:, [3, 4, 5, 0, 1, 2]] * mirror
        one = horizon.mixture.forecasts(observation.positions[None])[0]
        other = horizon.mixture.forecasts(swapped[None])[0]
        np.testing.assert_allclose(other, one[:, :, [3, 4, 5, 0, 1, 2]] * mirror, atol=1e-9)

    def test_noise_given_by_the_camera_widens_it(self, horizon: Horizon, observation: Observation) -> None:
        noisy = replace(observation, noise=np.full(6, 0.05))
        spread = [
            horizon.forecast(each, np.random.default_rng(0), 400).samples.std(axis=0).mean()
            for each in (observation, noisy)
        ]
        assert spread[1] > spread[0] + 0.01

    def test_every_stage_can_be_left_out(self, horizon: Horizon, observation: Observation) -> None:
        for name, part in ablations(horizon).items():
            forecast = part.forecast(observation, np.random.default_rng(0), 20)
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
        np.testing.assert_allclose(views.to_world(views.to_arms(future)), future, atol=1e-12)

    def test_due_errors_are_means_of_what_came_due(self) -> None:
        errors = DueErrors(1, (1, 2), (1e9,))
        for k in range(6):
            errors.observe(np.full((6, 3), float(k)))
            errors.predicted(np.full((1, 2, 6, 3), float(k)))  # nothing moves: 1 behind, then 2
        np.testing.assert_allclose(errors.mean()[0, :, 0, 0], np.sqrt(3.0))
        np.testing.assert_allclose(errors.mean()[0, :, 1, 0], 2 * np.sqrt(3.0))
        errors.observe(np.full((6, 3), np.nan))
        np.testing.assert_allclose(errors.mean()[0, :, 0, 0], np.sqrt(3.0))

    @pytest.mark.parametrize("better", [0, 1, TRIVIAL])
    def test_the_guard_goes_with_whoever_errs_least(self, better: int) -> None:
        memory = guard_memory(15)
        due = np.full((1 + TRIVIAL, 6, len(memory.leads), 1), 0.03)
        due[better] = 0.02
        weights = guard(due, 500)
        np.testing.assert_allclose(weights.sum(axis=0), 1.0)
        assert (weights[better] > 0.9).all()

    def test_the_guard_begins_with_the_mixture(self) -> None:
        weights = guard(np.full((1 + TRIVIAL, 6, 5, 1), np.nan), 0)
        assert (weights[0] > 0.9).all()

    def test_the_spread_grows_after_misses_and_shrinks_after_none(self) -> None:
        for far, grows in ((10.0, True), (0.0, False)):
            scale = AdaptiveScale(3, mixture_radius(np.eye(len(SCALES))[2], LEVEL))
            for _ in range(60):
                scale.observe(np.full((6, 3), far))
                scale.predicted(np.zeros((3, 6, 3)), np.tile(np.eye(3), (3, 6, 1, 1)))
            assert (scale.factor > 1.2).all() if grows else (scale.factor < 0.9).all()

    def test_the_radius_of_a_unit_normal_is_known(self) -> None:
        # The 0.9 quantile of chi squared with three degrees of freedom is 6.2514.
        assert mixture_radius(np.eye(len(SCALES))[2], 0.9) == pytest.approx(np.sqrt(6.2514), abs=1e-4)
