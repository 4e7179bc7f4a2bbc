"""The method `kinecast`: parts that do what they say, training that repeats itself, forecasts that hold."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from kinecast.body.limits import JointLimits, violations
from kinecast.body.posture import postures_from_points
from kinecast.errors import ModelError
from kinecast.prediction.density import PoseDensity
from kinecast.prediction.kinecast import fit, objectives
from kinecast.prediction.kinecast.error_model import (
    BROAD,
    CEILING,
    LEVEL,
    SCALES,
    SHARP,
    AdaptiveScale,
    ErrorModel,
    share_within,
)
from kinecast.prediction.kinecast.experts import (
    DAMPED,
    NEWEST,
    TRIVIAL,
    FeatureScale,
    Networks,
    PersonView,
    arm_views,
    forecasts,
    time_basis,
    trivial_experts,
    yaw_frame,
)
from kinecast.prediction.kinecast.fit import fitting_kinecast
from kinecast.prediction.kinecast.model import LONGEST_PAUSE, Kinecast, MixtureBlocks, ablations, kinecast_from_arrays
from kinecast.prediction.kinecast.objectives import fit_error_model, fit_gate, fit_network
from kinecast.prediction.kinecast.weights import (
    HALF_LIVES,
    JOINT_TYPE,
    LEADS,
    LONG_RUN,
    Gate,
    GateInputs,
    OnlineRegression,
    RollingForecastErrors,
    corrected_share,
    skill,
)
from kinecast.prediction.method import forecast_in_scene, shortened
from kinecast.prediction.model_file import ModelCard
from kinecast.prediction.observation import Observation
from kinecast.prediction.training_windows import TrainingWindows
from kinecast.tasks import Progress, Serial

pytestmark = pytest.mark.usefixtures("compiled_once")

SWAP = [3, 4, 5, 0, 1, 2]
MIRROR = np.array([1.0, -1.0, 1.0])
NOISE = 0.002
UNIT = (SCALES == 1.0).astype(float)
"""Weights of the common factor that is one."""
REST = np.zeros(6)


def fit_kinecast(windows: TrainingWindows, progress: Progress | None = None) -> Kinecast:
    """Everything descends for less long: whether it does so alike takes no more."""
    workers = Serial()
    with pytest.MonkeyPatch.context() as patch:
        for module, name, value in (
            (fit, "NETWORK_STEPS", 20), (fit, "FOLDS", 2), (objectives, "ERROR_STEPS", 100),
            (objectives, "GATE_STEPS", 100),
        ):  # fmt: skip
            patch.setattr(module, name, value)
        fitted = fitting_kinecast(workers, windows, windows, JointLimits(), NOISE, seed=0)
        return workers.results([fitted], progress)[0]


def card(method: Kinecast) -> ModelCard:
    assert method.limits is not None
    return ModelCard("kinecast", method.frames, method.steps, 1.0 / method.dt, limits=method.limits, noise=NOISE)


@pytest.fixture(scope="module")
def method(windows: TrainingWindows) -> Kinecast:
    return fit_kinecast(windows)


class TestTraining:
    def test_the_same_seed_gives_the_same_model_to_the_last_bit(
        self, method: Kinecast, windows: TrainingWindows
    ) -> None:
        told: list[tuple[int, int]] = []
        again = fit_kinecast(windows, lambda done, total: told.append((done, total))).to_arrays()
        for name, array in method.to_arrays().items():
            np.testing.assert_array_equal(again[name], array, err_msg=name)
        assert told == [(done, told[-1][1]) for done in range(1, told[-1][1] + 1)]

    def test_another_seed_gives_another(self, learned: Networks) -> None:
        assert not np.array_equal(learned.W1[0], learned.W1[1])

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
        swapped = observation.positions[:, SWAP] * MIRROR
        [one], _ = forecasts(method.experts, observation.positions[None], method.steps)
        [other], _ = forecasts(method.experts, swapped[None], method.steps)
        np.testing.assert_allclose(other, one[:, :, SWAP] * MIRROR, atol=1e-9)

    def test_a_shorter_horizon_says_the_same_of_what_is_left(self, method: Kinecast, observation: Observation) -> None:
        near, far = shortened(method, 2 * method.dt), method
        window, rng = observation.positions, np.random.default_rng
        states = [each.update(each.init_state(), observation, window[-1]) for each in (near, far)]
        short, whole = (m.forecast(s, observation, rng(0), 50) for m, s in zip((near, far), states, strict=True))
        np.testing.assert_array_equal(short.mean, whole.mean[:2])
        assert short.samples.shape == (50, 2, 6, 3)
        np.testing.assert_allclose(short.density.log_prob(short.mean), whole.density.log_prob(whole.mean)[:2], atol=0.5)

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

    def test_equal_seeds_and_histories_give_equal_forecasts(self, method: Kinecast, windows: TrainingWindows) -> None:
        def after(seed: int) -> np.ndarray:
            state = method.init_state()
            for row in range(4):
                seen = Observation(windows.observed[row], windows.up[row], windows.dt, row * 4 * windows.dt)
                state = method.update(state, seen, windows.observed[row, -1])
            return method.forecast(state, seen, np.random.default_rng(seed), 20).samples

        np.testing.assert_array_equal(after(1), after(1))
        assert not np.array_equal(after(1), after(2))

    def test_free_samples_and_density_are_one_law(self, method: Kinecast, observation: Observation) -> None:
        free = replace(method, limits=None)
        forecast = forecast_in_scene(free, free.init_state(), observation, np.random.default_rng(0), 6000, None)
        assert isinstance(forecast.density, PoseDensity)
        assert isinstance(forecast.density.blocks, MixtureBlocks)
        law = forecast.density.blocks.mixture
        drawn = observation.to_torso(forecast.samples)[:, :, [0, 3, 1, 2, 4, 5]].reshape(6000, -1, 18)
        variance = (law.factor[0] ** 2).sum(axis=-1) * float(law.scale_weights @ law.scales**2)
        np.testing.assert_allclose(drawn.std(axis=0), np.sqrt(variance), rtol=0.15)
        np.testing.assert_allclose(drawn.mean(axis=0), law.mean[0], atol=6 * np.sqrt(variance.max() / 6000))
        # Half of all samples lie where the density is above its median, by whatever samples it is taken.
        log_prob = np.array([forecast.density.log_prob(pose) for pose in forecast.samples[::10]])
        above = (log_prob[::2] > np.median(log_prob[1::2], axis=0)).mean(axis=0)
        assert (np.abs(above - 0.5) < 4 * 0.5 * np.sqrt(2 / 300)).all()

    def test_somebody_who_stands_still_is_left_where_they_are(self, method: Kinecast, observation: Observation) -> None:
        rng, state = np.random.default_rng(0), method.init_state()
        pose = observation.positions[-1]
        for frame in range(60):
            window = pose + 0.001 * rng.standard_normal(observation.positions.shape)
            seen = replace(observation, positions=window, stamp=frame * method.dt)
            state = method.update(state, seen, window[-1])
        mean = method.forecast(state, seen, rng, 10).mean
        assert np.linalg.norm(mean - pose, axis=-1).max() < 0.01


class TestState:
    def seen(self, method: Kinecast, observation: Observation, frames: list[int]) -> int:
        """How many frames are remembered after some were seen."""
        state = method.init_state()
        for frame in frames:
            at = replace(observation, stamp=frame * method.dt)
            state = method.update(state, at, observation.positions[-1])
        return state.mixture.errors.frames

    def test_pauses_are_bridged_until_they_are_too_long(self, method: Kinecast, observation: Observation) -> None:
        assert self.seen(method, observation, [0, 1, 2]) == 3
        assert self.seen(method, observation, [0, 1, 5]) == 6  # the three between count as seen without a joint
        assert self.seen(method, observation, [0, 1, 2 + LONGEST_PAUSE]) == 3 + LONGEST_PAUSE
        assert self.seen(method, observation, [0, 1, 3 + LONGEST_PAUSE]) == 1
        assert self.seen(method, observation, [0, 9, 4]) == 1  # time went back

    def test_without_memory_every_frame_is_the_first(self, method: Kinecast, observation: Observation) -> None:
        assert self.seen(replace(method, remembers=False), observation, [0, 1, 2]) == 1

    def test_frames_with_missing_joints_judge_nothing(self, method: Kinecast, observation: Observation) -> None:
        state = method.init_state()
        hidden = observation.positions[-1].copy()
        hidden[4] = np.nan
        for frame in range(8):
            state = method.update(state, replace(observation, stamp=frame * method.dt), hidden)
        assert state.mixture.errors.frames == 8
        assert np.isnan(state.mixture.errors.mean()).all()
        assert state.adaptive is not None
        np.testing.assert_array_equal(state.adaptive.factor(REST), 1.0)


def lines(seed: int, count: int = 240) -> tuple[np.ndarray, np.ndarray]:
    """Windows (W, 6, 6, 3) and futures (W, 3, 6, 3) of arms whose joints go straight on, each at its own speed [m]."""
    rng = np.random.default_rng(seed)
    left = np.array([[0.0, 0.2, 1.4], [0.0, 0.25, 1.1], [0.2, 0.2, 1.0]])
    pose = np.concatenate([left, left * MIRROR])
    track = pose + 0.02 * rng.standard_normal((count, 1, 6, 3))
    track = track + 0.02 * rng.standard_normal((count, 1, 6, 3)) * np.arange(9)[:, None, None]
    return track[:, :6], track[:, 6:]


def restored(arrays: dict[str, np.ndarray]) -> Networks:
    return Networks.from_arrays(arrays, scale=FeatureScale.from_arrays(arrays, "scale."))


@pytest.fixture(scope="module")
def learned() -> Networks:
    """Two networks, fitted to straight lines."""
    observed, future = lines(0)
    scale = FeatureScale.of(arm_views(observed))
    return Networks.joined([fit_network(scale, observed, future, 150, seed) for seed in (0, 1)])


class TestFeatures:
    def test_the_yaw_frame_turns_with_the_shoulders(self) -> None:
        observed, _ = lines(1, 20)
        frame = yaw_frame(observed[:, -1])
        np.testing.assert_allclose(frame.transpose(0, 2, 1) @ frame, np.broadcast_to(np.eye(3), (20, 3, 3)), atol=1e-12)
        line = (observed[:, -1, 0] - observed[:, -1, 3])[:, None] @ frame
        np.testing.assert_allclose(line[:, 0, 0], 0.0, atol=1e-12)  # all of it along y and z
        assert (line[:, 0, 1] > 0).all()
        np.testing.assert_array_equal(yaw_frame(np.zeros((6, 3))), np.eye(3))

    def test_they_do_not_tell_where_a_person_stands_and_faces(self) -> None:
        observed, _ = lines(2, 10)
        c, s = np.cos(0.7), np.sin(0.7)
        moved = observed @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]).T + np.array([3.0, -1.0, 0.2])
        one, other = arm_views(observed), arm_views(moved)
        for name in ("steps", "pose", "level", "amplitude"):
            np.testing.assert_allclose(getattr(other, name), getattr(one, name), atol=1e-10, err_msg=name)

    def test_the_right_arm_is_the_left_one_in_a_mirror(self) -> None:
        observed, _ = lines(3, 10)
        one, other = arm_views(observed), arm_views(observed[:, :, SWAP] * MIRROR)
        for name in ("steps", "pose", "level"):
            left, right = np.split(getattr(one, name), 2)
            np.testing.assert_allclose(getattr(other, name), np.concatenate([right, left]), atol=1e-12, err_msg=name)

    def test_slow_and_fast_motion_differ_in_amplitude_alone(self) -> None:
        observed, _ = lines(4, 10)
        last = observed[:, -1:]
        one, other = arm_views(observed), arm_views(last + 5.0 * (observed - last))
        np.testing.assert_allclose(other.amplitude / one.amplitude, 5.0, rtol=0.05)
        np.testing.assert_allclose(other.steps, one.steps, atol=0.05)
        np.testing.assert_allclose(other.pose, one.pose, atol=1e-12)


class TestExperts:
    def test_they_learn_that_straight_motion_goes_on(self, learned: Networks) -> None:
        observed, future = lines(5, 60)
        made, _ = forecasts(learned, observed, 3)
        error = np.linalg.norm(made - future[:, None], axis=-1).mean(axis=(0, 2, 3))
        assert (error[TRIVIAL:] < 0.2 * error[0]).all()  # the first of the trivial ones stands still

    def test_each_gives_alone_what_it_gives_beside_others(self, learned: Networks) -> None:
        observed, _ = lines(6, 5)
        both, _ = forecasts(learned, observed, 3)
        for k in range(2):
            alone, _ = forecasts(learned.take([k]), observed, 3)
            np.testing.assert_allclose(alone[:, TRIVIAL], both[:, TRIVIAL + k], atol=1e-12)
        assert forecasts(learned.take([]), observed, 3)[0].shape[1] == TRIVIAL

    def test_they_come_back_from_their_arrays(self, learned: Networks) -> None:
        observed, _ = lines(6, 5)
        arrays = learned.to_arrays()
        again = restored(arrays)
        np.testing.assert_array_equal(forecasts(again, observed, 3)[0], forecasts(learned, observed, 3)[0])
        del arrays["scale.pose_mean"]
        with pytest.raises(ModelError, match=r"scale\.pose_mean"):
            restored(arrays)


class TestGate:
    def test_weights_sum_to_one_and_go_with_lower_errors(self) -> None:
        rng = np.random.default_rng(0)
        gate = Gate(0.3 * rng.standard_normal((8, 3, 3)), np.zeros((5, 3)), 0.3 * rng.standard_normal((8, 5, 3)))
        gate.share[:, 0] = 1.0
        inputs = GateInputs(rng.standard_normal((8, 6, 5)), rng.standard_normal((6, 5)))
        weights = gate.weights(inputs, 15)
        np.testing.assert_allclose(weights.sum(axis=0), 1.0)
        assert (weights > 0).all()
        inputs.errors[3, 2] -= 1.0  # one expert does better on one joint
        better = gate.weights(inputs, 15)
        assert (better[3, :, 2] > weights[3, :, 2]).all()
        np.testing.assert_array_equal(np.delete(better, 2, axis=2), np.delete(weights, 2, axis=2))

    def test_it_learns_whom_to_trust(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(objectives, "GATE_STEPS", 300)
        rng = np.random.default_rng(1)
        futures = 0.1 * rng.standard_normal((300, 3, 6, 3))
        made = futures[:, None] + 0.3 * rng.standard_normal((300, 4, 3, 6, 3))
        made[:, 2] = futures + 0.001
        gate = fit_gate(np.zeros((300, 4, 6, 4)), np.zeros((300, 6, 5)), made, futures, 3, slice(None), seed=0)
        found = gate.weights(GateInputs(np.zeros((4, 6, 4)), np.zeros((6, 5))), 3)
        assert (found[2] > 0.8).all()


def heavy_tailed(seed: int, count: int = 1500) -> tuple[np.ndarray, np.ndarray]:
    """Errors (B, T, 6, 3) whose size follows a feature and whose axes differ; features (B, 6, F)."""
    rng = np.random.default_rng(seed)
    features = np.concatenate([np.ones((count, 6, 1)), rng.uniform(-1.0, 1.0, (count, 6, 1))], axis=2)
    scale = 0.02 * np.exp(features[..., 1]) * rng.choice(SCALES[1:5], (count, 1))
    errors = scale[:, None, :, None] * rng.standard_normal((count, 3, 6, 3)) * np.array([1.0, 0.5, 2.0])
    return errors, features


@pytest.fixture(scope="module")
def model() -> ErrorModel:
    """Fitted to heavy-tailed errors."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(objectives, "ERROR_STEPS", 400)
        return fit_error_model(*heavy_tailed(0))


class TestErrorModel:
    def test_regions_hold_what_they_say_on_new_errors(self, model: ErrorModel) -> None:
        errors, features = heavy_tailed(1)
        steps, turns = np.arange(3), np.broadcast_to(np.eye(3), (3, 3, 3))
        z = []
        for error, feature in zip(errors, features, strict=True):
            own = np.einsum("tjd,d->tjd", error, np.ones(3))
            own[:, 3:] *= MIRROR  # errors were in each arm's own axes
            z.append(model.whitened(own, model.scale(feature), turns, steps))
        weights = np.repeat([model.weights(feature) for feature in features], 3, axis=0)
        inside = share_within(np.linalg.norm(z, axis=-1).reshape(-1, 6), weights).reshape(-1, 3, 6)
        for level in (SHARP, LEVEL, 0.9, BROAD):
            np.testing.assert_allclose((inside < level).mean(axis=(0, 2)), level, atol=0.03)
        spread = np.reshape(z, (-1, 3)).std(axis=0)
        np.testing.assert_allclose(spread / spread.mean(), 1.0, atol=0.1)  # the axes' own sizes are gone

    def test_the_scale_follows_its_feature(self, model: ErrorModel) -> None:
        low, high = (model.scale(np.tile([1.0, value], (6, 1))) for value in (-1.0, 1.0))
        np.testing.assert_allclose(np.log(high / low), 2.0, atol=0.15)
        highest = model.scale(np.tile([1.0, 1e3], (6, 1))) * np.cbrt(np.linalg.det(model.shape[JOINT_TYPE])).T
        np.testing.assert_allclose(highest, CEILING * model.reach[JOINT_TYPE].T)  # and knows a ceiling

    def test_every_number_keeps_unit_spread_and_whole_motions_hang_together(
        self, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setattr(objectives, "ERROR_STEPS", 20)  # of the scale, which is not looked at
        rng = np.random.default_rng(3)
        errors = 0.02 * (rng.standard_normal((800, 1, 6, 3)) + 0.1 * rng.standard_normal((800, 5, 6, 3)))
        model = fit_error_model(errors, np.ones((800, 6, 1)))
        np.testing.assert_allclose(np.linalg.norm(model.factor, axis=-1), 1.0)
        correlation = np.einsum("jdr,jdr->jd", model.factor[0], model.factor[-1])
        assert (correlation > 0.9).all()

    def test_drawn_errors_have_the_stated_covariance_and_whiten_to_unit_spread(self, method: Kinecast) -> None:
        model, rng = method.error_model, np.random.default_rng(4)
        scale, turn = np.full((method.steps, 6), 0.03), yaw_frame(np.array([[0.3, 0.4, 0]] + [[0, 0, 0]] * 5))
        factor = model.factor_in(scale, turn)
        draws = np.tensordot(rng.standard_normal((factor.shape[-1], 3000)), factor, axes=(0, 3))
        turns = np.broadcast_to(turn, (method.steps, 3, 3))
        z = np.array([model.whitened(draw, scale, turns, np.arange(method.steps)) for draw in draws])
        np.testing.assert_allclose(z.std(axis=0), 1.0, atol=5 / np.sqrt(2 * 3000))


BLIND = PersonView(np.zeros((2, NEWEST + 1)), np.full(2, 0.02), np.eye(3))
SEEING = PersonView(np.ones((2, NEWEST + 1)), np.full(2, 0.02), np.eye(3))


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
        basis = time_basis(15, 6)
        np.testing.assert_allclose(basis.T @ basis, np.eye(6), atol=1e-10)
        assert time_basis(3, 3).shape == (3, 3)

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

    def test_old_errors_are_forgotten_and_pauses_judge_nothing(self) -> None:
        errors = RollingForecastErrors(1, (2,), (5.0, 1e9))
        assert np.isnan(errors.mean()).all()

        def frame(error: float) -> None:
            errors.observe(np.zeros((6, 3)))
            errors.predicted(np.full((1, 2, 6, 3), error / np.sqrt(3.0)))

        for error in (1.0, 1.0, 1.0, 0.0, 0.0, 0.0):
            frame(error)
        quick, slow = errors.mean()[0, 0, 0]
        assert quick < slow == pytest.approx(3 / 4)
        errors.skip(2)  # of the four predictions that could come due, none does
        np.testing.assert_allclose(errors.mean()[0, 0, 0], [quick, slow])
        frame(9.0)
        frame(9.0)
        np.testing.assert_allclose(errors.mean()[0, 0, 0], [quick, slow])
        frame(9.0)
        assert errors.mean()[0, 0, 0, 1] == pytest.approx(12 / 5)

    def test_after_a_pause_of_the_horizon_the_spread_is_judged_by_nothing(self, method: Kinecast) -> None:
        steps = method.steps
        scale = AdaptiveScale(method.error_model, steps, method.dt)
        scale.predicted(np.zeros((steps, 6, 3)), np.ones((steps, 6)), np.eye(3), UNIT, REST)
        scale.skip(steps)
        scale.observe(np.full((6, 3), 10.0))
        np.testing.assert_array_equal(scale.factor(REST), 1.0)

    def test_a_regression_learns_what_experts_leave_over_on_a_person_and_nothing_from_one_without_errors(self) -> None:
        rng, steps = np.random.default_rng(0), 6
        pose = np.cumsum(rng.normal(0.0, 0.02, (400, 6, 3)), axis=0)
        for share in (0.5, 0.0):  # the truth lies so far from the mixture towards the second expert
            regression, errors = OnlineRegression(2, steps), []
            for k in range(300):
                regression.observe(pose[k])
                to_come = pose[k + 1 : k + 1 + steps]
                second = to_come + (1.0 - share) * np.array([0.1, 0.0, 0.0])
                mixed = second - np.array([0.1, 0.0, 0.0])
                corrected = regression.by_experts(mixed, np.stack([mixed, second]), pose[k])
                regression.by_window(mixed, BLIND, pose[k])
                errors.append(np.abs(corrected - to_come).max())
            assert errors[0] == pytest.approx(0.1 * share)
            assert max(errors[-50:]) < 0.02

    def test_a_regression_learns_that_somebody_goes_home(self) -> None:
        steps, regression, stays, goes = 6, OnlineRegression(1, 6), 0.0, 0.0
        pose, rng = np.zeros((3000, 6, 3)), np.random.default_rng(0)
        for k in range(1, len(pose)):  # a tenth of the way back in each frame, and a push
            pose[k] = 0.9 * pose[k - 1] + rng.normal(0.0, 0.02, (6, 3))
        for k in range(len(pose) - steps):
            regression.observe(pose[k])
            mixed = np.repeat(pose[k][None], steps, axis=0)
            corrected = regression.by_experts(mixed, mixed[None], pose[k])
            regression.by_window(mixed, BLIND, pose[k])
            if k > 1000:
                stays += np.linalg.norm(pose[k + steps] - pose[k], axis=1).mean()
                goes += np.linalg.norm(pose[k + steps] - corrected[-1], axis=1).mean()
        best = np.sqrt((1.0 - 0.9**12) / (2.0 * (1.0 - 0.9**6)))  # of forecasts that know all that
        assert goes / stays == pytest.approx(best, abs=0.02)

    def test_a_regression_learns_what_a_person_makes_of_a_window(self) -> None:
        steps, regression, rng = 3, OnlineRegression(1, 3), np.random.default_rng(0)
        habit = rng.normal(0.0, 0.3, (NEWEST + 1, 9))
        turn = yaw_frame(np.array([[0.3, 0.4, 0]] + [[0, 0, 0]] * 5))
        left, pose = [], rng.normal(0.0, 0.01, (1000, 6, 3))
        for k in range(900):
            regression.observe(pose[k])
            view = PersonView(rng.standard_normal((2, NEWEST + 1)), rng.uniform(0.1, 0.3, 2), turn)
            mean = pose[k + 1 : k + 1 + steps] - view.to_world(np.repeat((view.features @ habit)[None], steps, axis=0))
            regression.by_experts(mean, mean[None], mean[0])
            corrected = regression.by_window(mean, view, mean[0])
            left.append(np.abs(corrected - pose[k + 1 : k + 1 + steps]).max())
        assert np.mean(left[-100:]) < 0.3 * np.mean(left[:20])

    def test_a_persons_view_turns_errors_to_arms_and_back(self) -> None:
        rng = np.random.default_rng(1)
        view = PersonView(np.zeros((2, NEWEST + 1)), np.array([0.01, 0.02]), yaw_frame(rng.standard_normal((6, 3))))
        errors = rng.standard_normal((4, 6, 3))
        np.testing.assert_allclose(view.to_world(view.to_arms(errors)), errors, atol=1e-12)
        alike = np.repeat(rng.standard_normal((1, 1, 9)), 2, axis=1)  # both arms alike: each to its own side
        both = view.to_world(alike / view.amplitude[:, None]) @ view.rotation
        np.testing.assert_allclose(both[:, 3:], both[:, :3] * MIRROR, atol=1e-12)

    def test_a_regression_learns_nothing_from_frames_that_were_not_seen_or_not_shown(self) -> None:
        def after(pose: np.ndarray, skipped: int) -> np.ndarray:
            regression, last = OnlineRegression(2, 3), np.zeros((6, 3))
            mixed, made = np.zeros((3, 6, 3)), np.stack([np.zeros((3, 6, 3)), np.ones((3, 6, 3))])
            for _ in range(50):
                regression.by_experts(mixed, made, last)
                regression.by_window(mixed, SEEING, last)
                regression.skip(skipped)
                regression.observe(pose)
            corrected = regression.by_experts(mixed, made, last)
            return np.stack([corrected, regression.by_window(mixed, SEEING, last)])

        assert after(np.ones((6, 3)), 0)[..., 0].min() > 0.1
        np.testing.assert_array_equal(after(np.full((6, 3), np.nan), 0), 0.0)
        np.testing.assert_array_equal(after(np.ones((6, 3)), 3), 0.0)

    @pytest.mark.parametrize("better", [0, 1])
    def test_a_correction_is_taken_where_it_errs_less(self, better: int) -> None:
        due = np.full((2, 6, len(LEADS), len(HALF_LIVES)), 0.03)
        due[better, ..., LONG_RUN] = 0.02
        np.testing.assert_allclose(corrected_share(due, 500), better, atol=0.05)
        assert (corrected_share(due * np.nan, 0) < 0.5).all()

    def test_skill_is_measured_against_the_best_trivial_expert(self) -> None:
        due = np.full((TRIVIAL + 4, 6, len(LEADS), len(HALF_LIVES)), 0.04)
        due[1] = 0.02
        assert skill(due, 10**6) == pytest.approx(-1.0, abs=0.1)
        due[-1] = 0.01
        assert skill(due, 10**6) == pytest.approx(0.5, abs=0.05)
        assert skill(due, 3) < 0.1
        assert skill(due * np.nan, 0) == 0.0

    def test_the_spread_grows_after_misses_and_shrinks_after_none(self, method: Kinecast) -> None:
        steps = method.steps
        for far, grows in ((10.0, True), (0.0, False)):
            scale = AdaptiveScale(method.error_model, steps, method.dt)
            for _ in range(60):
                scale.observe(np.full((6, 3), far))
                scale.predicted(np.zeros((steps, 6, 3)), np.ones((steps, 6)), np.eye(3), UNIT, REST)
            assert (scale.factor(REST) > 1.2).all() if grows else (scale.factor(REST) < 0.9).all()
            np.testing.assert_array_equal(scale.factor(np.full(6, 0.02)), 1.0)  # of fast joints nothing is known

    @pytest.mark.parametrize("even", [True, False])
    def test_the_common_factors_part_for_who_rests_or_leaps_and_meet_for_who_moves_evenly(
        self, method: Kinecast, even: bool
    ) -> None:
        steps, rng = method.steps, np.random.default_rng(0)
        scale = AdaptiveScale(method.error_model, steps, method.dt)
        weights = np.full(len(SCALES), 1.0 / len(SCALES))
        for _ in range(200):
            common = 1.0 if even else rng.choice([0.01, 5.0], p=[0.7, 0.3])
            z = common * rng.standard_normal((6, 3, 1))
            scale.observe((method.error_model._axes[0] @ z)[..., 0])
            scale.predicted(np.zeros((steps, 6, 3)), np.ones((steps, 6)), np.eye(3), weights, REST)
        spread = np.log(scale.scales[-1] / scale.scales[0]) / np.log(SCALES[-1] / SCALES[0])
        assert spread < 0.8 if even else spread > 1.2

    def test_the_share_of_a_unit_normal_within_a_radius_is_known(self) -> None:
        # The 0.9 quantile of chi squared with three degrees of freedom is 6.2514.
        radius = np.full((1, 6), np.sqrt(6.2514))
        np.testing.assert_allclose(share_within(radius, UNIT[None]), 0.9, atol=1e-5)
        np.testing.assert_allclose(share_within(2.0 * radius, UNIT[None], 2.0 * SCALES), 0.9, atol=1e-5)
