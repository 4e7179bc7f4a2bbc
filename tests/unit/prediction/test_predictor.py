"""The online facade: a prediction for every frame, whatever the frame, and never an exception."""

from __future__ import annotations

import logging
import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import kinecast.predictor
from kinecast.body.skeleton import ARM_JOINTS
from kinecast.errors import OptionError
from kinecast.geometry.scene import Scene
from kinecast.geometry.shapes import Sphere
from kinecast.prediction.method import Forecast, Memoryless, Method
from kinecast.prediction.observation import Observation
from kinecast.predictor import HAND_SPEED, Predictor, PredictorOptions
from kinecast.types import Prediction, SkeletonFrame, Status

DT = 1.0 / 30.0
REST = np.array([[0, 0.2, 1.4], [0, 0.25, 1.1], [0.2, 0.2, 1.0], [0, -0.2, 1.4], [0, -0.25, 1.1], [0.2, -0.2, 1.0]])
OPTIONS = PredictorOptions(samples=60)


def frame(stamp: float, positions: np.ndarray = REST, person: str = "0") -> SkeletonFrame:
    return SkeletonFrame(stamp, ARM_JOINTS, positions, person)


def swinging(stamp: float, phase: float = 0.0) -> np.ndarray:
    """Both wrists on their way."""
    positions = REST.copy()
    positions[[2, 5], 2] += 0.1 * math.sin(4.0 * stamp + phase)
    return positions


@pytest.fixture
def predictor(trained: dict[str, Method[Any]]) -> Predictor:
    return Predictor(trained["gp_constrained"], 0.002, options=OPTIONS)


@pytest.fixture
def still(trained: dict[str, Method[Any]]) -> Predictor:
    return Predictor(trained["zero_velocity"], 0.002, options=OPTIONS)


def fill(predictor: Predictor, count: int = 8, start: float = 0.0, person: str = "0") -> Prediction:
    """The prediction after so many frames of somebody at rest."""
    return [predictor.observe(frame(start + k * DT, person=person)) for k in range(count)][-1]


def assert_whole(prediction: Prediction, samples: int = 60) -> None:
    """Every part is there and fits the others."""
    steps = len(prediction.times)
    assert 1 <= steps <= 3
    assert prediction.samples.shape == (samples, steps, 6, 3)
    assert prediction.mean.shape == (steps, 6, 3)
    assert prediction.covariance.shape == (steps, 6, 3, 3)
    assert prediction.joints == ARM_JOINTS
    assert (np.diff(prediction.times) > 0).all()
    assert prediction.diagnostics["milliseconds"] > 0
    assert prediction.status.advice


def test_it_warms_up_and_then_predicts(predictor: Predictor) -> None:
    statuses = []
    for k in range(8):
        prediction = predictor.observe(frame(k * DT, swinging(k * DT)))
        assert_whole(prediction)
        assert prediction.stamp == k * DT
        np.testing.assert_allclose(prediction.times, k * DT + DT * np.arange(1, 4))
        statuses.append(prediction.status)
    assert statuses == [Status.WARMING_UP] * 5 + [Status.OK] * 3
    assert np.isfinite(prediction.samples).all()
    assert np.isfinite(prediction.log_prob(prediction.mean)).all()


@pytest.mark.parametrize(("skill", "moves", "status"), [
    (-0.3, True, Status.UNFAMILIAR), (-0.3, False, Status.OK), (0.0, True, Status.OK),
])  # fmt: skip
def test_it_says_where_a_trivial_predictor_does_better(
    still: Predictor, monkeypatch: pytest.MonkeyPatch, skill: float, moves: bool, status: Status
) -> None:
    forecast = kinecast.predictor.forecast_in_scene
    monkeypatch.setattr(
        kinecast.predictor, "forecast_in_scene", lambda *of: replace(forecast(*of), diagnostics={"skill": skill})
    )
    for k in range(8):
        prediction = still.observe(frame(k * DT, swinging(k * DT) if moves else REST + 1e-4 * (k % 2)))
    assert prediction.status is status


def test_while_warming_up_everything_in_reach_counts(predictor: Predictor) -> None:
    prediction = predictor.observe(frame(0.0))
    distances = np.linalg.norm(prediction.samples - REST, axis=-1)
    reach = HAND_SPEED * DT * np.arange(1, 4)
    assert (distances <= reach[:, None] + 1e-12).all()
    assert (distances.max(axis=0) > 0.8 * reach[:, None]).all()
    np.testing.assert_allclose(prediction.covariance[1, 4], reach[1] ** 2 / 5 * np.eye(3))
    assert np.isneginf(prediction.log_prob(prediction.mean)).all()


def test_zero_velocity_stays_put(still: Predictor) -> None:
    prediction = fill(still)
    assert prediction.status in (Status.OK, Status.REPEATED)
    np.testing.assert_allclose(prediction.mean, np.repeat(REST[None], 3, axis=0), atol=1e-9)


def test_covariance_is_that_of_the_samples(predictor: Predictor) -> None:
    prediction = fill(predictor)
    for t, j in ((0, 2), (2, 5)):
        expected = np.cov(prediction.samples[:, t, j].T, bias=True)
        np.testing.assert_allclose(prediction.covariance[t, j], expected, atol=1e-12)


def run(predictor: Predictor, frames: Sequence[SkeletonFrame]) -> list[Prediction]:
    return [predictor.observe(each) for each in frames]


def test_equal_frames_and_seeds_give_equal_predictions(trained: dict[str, Method[Any]]) -> None:
    frames = [frame(k * DT, swinging(k * DT)) for k in range(8)]
    first, second, other = (
        run(Predictor(trained["gp_constrained"], 0.002, options=replace(OPTIONS, seed=seed)), frames)
        for seed in (1, 1, 2)
    )
    for a, b in zip(first, second, strict=True):
        np.testing.assert_array_equal(a.samples, b.samples)
    assert not np.array_equal(first[-1].samples, other[-1].samples)


def test_two_persons_at_once_are_predicted_as_each_alone(trained: dict[str, Method[Any]]) -> None:
    frames = {
        person: [frame(k * DT + shift, swinging(k * DT, phase) + phase, person) for k in range(9)]
        for person, phase, shift in (("ada", 0.0, 0.0), ("bob", 1.0, 0.01))
    }
    alone = {name: run(Predictor(trained["gp_constrained"], 0.0, options=OPTIONS), frames[name]) for name in frames}
    together = Predictor(trained["gp_constrained"], 0.0, options=OPTIONS)
    for k in range(9):
        for name in frames:
            prediction = together.observe(frames[name][k])
            assert prediction.person == name
            assert prediction.status is alone[name][k].status
            np.testing.assert_array_equal(prediction.samples, alone[name][k].samples)


def test_fifty_persons_at_once_are_all_followed(still: Predictor) -> None:
    for k in range(7):
        statuses = {still.observe(frame(k * DT, swinging(k * DT) + 0.1 * p, f"person-{p}")).status for p in range(50)}
    assert statuses == {Status.OK}


def test_too_many_persons_are_followed_in_bounded_memory(
    trained: dict[str, Method[Any]], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(kinecast.predictor, "MOST_PERSONS", 3)
    few = Predictor(trained["zero_velocity"], options=replace(OPTIONS, samples=5))
    for p in range(20):
        assert few.observe(frame(0.01 * p, REST, f"p{p}")).status is Status.WARMING_UP
        assert len(few._tracks) <= 3
    assert set(few._tracks) == {"p17", "p18", "p19"}


def test_persons_long_gone_are_forgotten(still: Predictor) -> None:
    fill(still, person="gone")
    fill(still, start=100.0, person="here")
    assert set(still._tracks) == {"here"}


def test_useless_frames_of_many_persons_do_not_block_new_ones(
    trained: dict[str, Method[Any]], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(kinecast.predictor, "MOST_PERSONS", 3)
    few = Predictor(trained["zero_velocity"], options=replace(OPTIONS, samples=5))
    for p in range(5):
        bad = frame(0.0, REST, f"bad-{p}")
        object.__setattr__(bad, "positions", REST[:, :2])
        assert few.observe(bad).status is Status.FAULT
    assert fill(few).status in (Status.OK, Status.REPEATED)


def test_jittered_stamps_are_no_trouble(predictor: Predictor) -> None:
    rng = np.random.default_rng(0)
    stamps = DT * (np.arange(20) + rng.uniform(-0.3, 0.3, 20))
    predictions = run(predictor, [frame(t, swinging(t)) for t in stamps])
    assert {p.status for p in predictions[8:]} == {Status.OK}


def test_gaps_repeats_late_frames_and_jumps_have_their_status(predictor: Predictor) -> None:
    for k in range(8):
        predictor.observe(frame(k * DT, swinging(k * DT)))
    assert predictor.observe(frame(11 * DT, swinging(11 * DT))).status is Status.GAP
    assert predictor.observe(frame(9 * DT, swinging(9 * DT))).status is Status.LATE
    newest = predictor.observe(frame(10 * DT, swinging(10 * DT)))
    assert newest.stamp == 11 * DT  # what is newest goes on counting
    predictor.observe(frame(12 * DT, swinging(12 * DT)))
    repeated = predictor.observe(frame(13 * DT, swinging(12 * DT)))
    assert repeated.status in (Status.REPEATED, Status.GAP)
    for k in range(14, 22):
        predictor.observe(frame(k * DT, swinging(k * DT)))
    thrown = swinging(22 * DT)
    thrown[2] += 0.8
    jump = predictor.observe(frame(22 * DT, thrown))
    assert jump.status is Status.JUMP
    assert np.linalg.norm(jump.mean[0, 2] - swinging(22 * DT)[2]) < 0.1
    for prediction in (newest, repeated, jump):
        assert_whole(prediction)
        assert np.isfinite(prediction.samples).all()


def test_an_occluded_wrist_is_predicted_ever_more_widely(predictor: Predictor) -> None:
    for k in range(8):
        predictor.observe(frame(k * DT, swinging(k * DT)))
    spreads = []
    for k in range(8, 20):
        hidden = swinging(k * DT)
        hidden[2] = np.nan
        prediction = predictor.observe(frame(k * DT, hidden))
        assert prediction.status is Status.OCCLUDED
        assert np.isfinite(prediction.samples).all()
        spreads.append(prediction.samples[:, 0, 2].std(axis=0).mean())
    # Once no frame of the window shows it: all that it can have reached since it was last seen.
    away = np.linalg.norm(prediction.samples[:, 0, 2] - swinging(7 * DT)[2], axis=-1)
    assert away.max() == pytest.approx(HAND_SPEED * 13 * DT, rel=0.05)
    assert spreads[-1] > spreads[-3] > spreads[0]


def test_nobody_seen_at_all(predictor: Predictor) -> None:
    for k in range(10):
        prediction = predictor.observe(frame(k * DT, np.full((6, 3), np.nan)))
        assert_whole(prediction)
        assert np.isnan(prediction.samples).all()
        assert prediction.status in (Status.WARMING_UP, Status.OCCLUDED)
        # Somebody who may be anywhere may be there too.
        np.testing.assert_array_equal(prediction.probability_of_hitting(Sphere(np.zeros(3), 0.1)), 1.0)


@pytest.mark.parametrize("joints", [("nose",), ("left_wrist",), ()])
def test_unknown_or_missing_joints(predictor: Predictor, joints: tuple[str, ...]) -> None:
    for k in range(8):
        prediction = predictor.observe(SkeletonFrame(k * DT, joints, np.zeros((len(joints), 3))))
        assert_whole(prediction)
        assert prediction.status in (Status.WARMING_UP, Status.OCCLUDED)


def test_a_clock_that_jumps_back_is_followed(predictor: Predictor) -> None:
    fill(predictor, start=1e6)
    statuses = [predictor.observe(frame(k * DT, swinging(k * DT))).status for k in range(8)]
    assert statuses == [Status.WARMING_UP] * 5 + [Status.OK] * 3


@pytest.mark.parametrize("stamp", [math.nan, math.inf, -math.inf])
def test_stamps_that_are_no_times_are_faults(predictor: Predictor, stamp: float) -> None:
    fill(predictor)
    prediction = predictor.observe(frame(stamp))
    assert prediction.status is Status.FAULT
    assert_whole(prediction)
    assert np.isnan(prediction.samples).all()
    assert predictor.observe(frame(8 * DT, swinging(8 * DT))).status is not Status.FAULT
    assert predictor.observe(frame(9 * DT), now=stamp).status is Status.FAULT


@pytest.mark.parametrize("stamp", [1e300, -1e300, 1e18, 1.7e9])
def test_huge_stamps_never_raise(predictor: Predictor, stamp: float) -> None:
    fill(predictor)
    for k in range(8):
        prediction = predictor.observe(frame(stamp + k * DT, swinging(k * DT)))
        assert prediction.samples.shape[0] == 60
    if stamp == 1.7e9:
        assert prediction.status is Status.OK
    assert fill(predictor, start=50.0).status in (Status.OK, Status.REPEATED)


@pytest.mark.parametrize(
    "change",
    [
        {"positions": REST[:5]},
        {"positions": REST[:, :2]},
        {"positions": REST[None]},
        {"positions": None},
        {"positions": REST.astype(str)},
        {"std": np.zeros(4)},
        {"stamp": "now"},
        {"stamp": 10**400},
        {"stamp": None},
        {"joints": None},
    ],
    ids=str,
)
def test_broken_frames_are_faults_and_nothing_more(
    predictor: Predictor, change: dict[str, object], caplog: pytest.LogCaptureFixture
) -> None:
    fill(predictor)
    bad = frame(8 * DT)
    for name, value in change.items():
        object.__setattr__(bad, name, value)
    with caplog.at_level(logging.CRITICAL, "kinecast"):
        prediction = predictor.observe(bad)
    assert prediction.status is Status.FAULT
    assert np.isnan(prediction.samples).all()
    assert predictor.observe(frame(9 * DT, swinging(9 * DT))).status in (Status.OK, Status.GAP)


def test_nothing_of_impossible_frames_is_remembered() -> None:
    shipped = Predictor.shipped(options=OPTIONS)
    for k in range(60):
        pose = swinging(k * DT)
        prediction = shipped.observe(frame(k * DT, 1e200 * pose if 20 <= k < 30 else pose))
    assert prediction.status is Status.OK
    assert np.isfinite(prediction.samples).all()


@pytest.mark.parametrize("scale", [1e-3, 1e3, 1e200])
def test_impossible_sizes_are_said_or_faults(predictor: Predictor, scale: float) -> None:
    for k in range(8):
        prediction = predictor.observe(frame(k * DT, scale * swinging(k * DT)))
        assert_whole(prediction)
    assert prediction.status in (Status.IMPLAUSIBLE, Status.FAULT, Status.JUMP)


def test_degenerate_bodies_never_raise(predictor: Predictor) -> None:
    lying = REST[:, [0, 2, 1]].copy()  # the shoulder line upright
    straight = REST.copy()
    straight[[1, 2]] = REST[0] + [[0.0, 0.3, 0.0], [0.0, 0.55, 0.0]]  # straight out sideways
    point = np.zeros((6, 3))
    for n, body in enumerate((lying, straight, point)):
        for k in range(8):
            prediction = predictor.observe(frame(k * DT, body + 1e-3 * k, f"body-{n}"))
            assert_whole(prediction)
            assert np.isfinite(prediction.samples).all() or prediction.status is Status.FAULT
    assert prediction.status in (Status.FAULT, Status.IMPLAUSIBLE)


def test_delay_leaves_out_the_steps_that_have_passed(still: Predictor) -> None:
    fill(still)
    stamp = 8 * DT
    for delay, expected in ((0.0, 3), (0.9 * DT, 3), (1.0 * DT, 2), (1.5 * DT, 2), (2.5 * DT, 1)):
        stamp += DT
        prediction = still.observe(frame(stamp, swinging(stamp)), now=stamp + delay)
        assert len(prediction.times) == expected
        assert (prediction.times > stamp + delay).all()
        assert prediction.status is not Status.LATE
        assert prediction.diagnostics["delay"] == pytest.approx(delay)
        assert np.isfinite(prediction.log_prob(prediction.mean)).all()
        assert_whole(prediction)


def test_a_prediction_wholly_in_the_past_is_late(still: Predictor) -> None:
    fill(still)
    for delay in (3 * DT, 0.29, 1.0, 1e9):
        prediction = still.observe(frame(9 * DT + delay, swinging(delay)), now=9 * DT + 2 * delay)
        if prediction.status is not Status.WARMING_UP:
            assert prediction.status is Status.LATE
        assert len(prediction.times) == 1


def test_a_frame_from_the_future_is_late_too(still: Predictor) -> None:
    fill(still)
    assert still.observe(frame(8 * DT, swinging(0.0)), now=0.0).status is Status.LATE


def test_delay_counts_while_warming_up_as_well(still: Predictor) -> None:
    prediction = still.observe(frame(0.0), now=1.5 * DT)
    np.testing.assert_allclose(prediction.times, [2 * DT, 3 * DT])
    assert prediction.samples.shape == (60, 2, 6, 3)


def test_later_steps_keep_their_own_law(still: Predictor) -> None:
    fill(still)
    whole = still.observe(frame(8 * DT, swinging(8 * DT)))
    pose = whole.mean + 0.01
    late = still.observe(frame(9 * DT, swinging(8 * DT + 1e-9)), now=10 * DT)
    np.testing.assert_allclose(late.log_prob(late.mean + 0.01), whole.log_prob(pose)[1:], atol=0.5)


def test_noise_given_per_joint_widens_that_joint(still: Predictor) -> None:
    spreads = []
    for std in (None, np.array([0.0, 0.0, 0.08, 0.0, 0.0, 0.0])):
        for k in range(7):
            seen = SkeletonFrame(k * DT, ARM_JOINTS, swinging(k * DT), person=str(std), std=std)
            prediction = still.observe(seen)
        spreads.append(np.sqrt(np.trace(prediction.covariance[0], axis1=1, axis2=2) / 3))
    assert spreads[1][2] > 0.05
    np.testing.assert_allclose(spreads[1][[3, 4, 5]], spreads[0][[3, 4, 5]], rtol=0.5)


def test_a_blocked_scene_is_said(trained: dict[str, Method[Any]]) -> None:
    scene = Scene((Sphere(REST.mean(axis=0), 2.0),))
    blocked = Predictor(trained["gp_constrained"], 0.002, scene, OPTIONS)
    assert fill(blocked).status is Status.BLOCKED


def test_a_scene_holds_online(trained: dict[str, Method[Any]]) -> None:
    ball = Sphere(REST[2] + np.array([0.08, 0.0, 0.0]), 0.075)
    held = Predictor(trained["gp_constrained"], 0.002, Scene((ball,)), OPTIONS)
    free = Predictor(trained["gp_angles"], 0.002, Scene((ball,)), OPTIONS)
    inside = fill(held), fill(free)
    np.testing.assert_array_equal(inside[0].probability_of_hitting(ball), 0.0)
    assert inside[1].probability_of_hitting(ball).max() > 0.0
    assert inside[0].diagnostics["accepted_fraction"] < 1.0
    assert inside[0].diagnostics["effective_sample_size"] == round(60 * inside[0].diagnostics["accepted_fraction"])


class Failing(Memoryless):
    """A method that works until it is broken, in one of two ways."""

    frames, steps, dt = 6, 3, DT

    def __init__(self, method: Method[Any], nan: bool) -> None:
        self.method, self.nan, self.broken = method, nan, False

    def forecast(self, state: None, observation: Observation, rng: np.random.Generator, samples: int) -> Forecast:
        if self.broken and not self.nan:
            raise np.linalg.LinAlgError("not positive definite")
        forecast = self.method.forecast(state, observation, rng, samples)
        return replace(forecast, samples=forecast.samples * (np.nan if self.broken else 1.0))

    def to_arrays(self) -> dict[str, np.ndarray]:
        return {}


@pytest.mark.parametrize("nan", [False, True])
def test_a_method_that_fails_is_a_fault(trained: dict[str, Method[Any]], nan: bool) -> None:
    method = Failing(trained["zero_velocity"], nan)
    predictor = Predictor(method, options=OPTIONS)
    method.broken = True
    prediction = fill(predictor)
    assert prediction.status is Status.FAULT
    assert_whole(prediction)
    assert prediction.stamp == pytest.approx(7 * DT)
    method.broken = False
    assert fill(predictor, start=1.0).status in (Status.OK, Status.REPEATED)


@pytest.mark.parametrize("samples", [0, 10**6])
def test_samples_out_of_range(samples: int) -> None:
    with pytest.raises(OptionError, match="samples"):
        PredictorOptions(samples=samples)


@pytest.mark.parametrize("name", ["zero_velocity", "gp_xyz", "gp_constrained", "ridge_angles"])
def test_a_shorter_horizon_changes_nothing_of_what_is_left(trained: dict[str, Method[Any]], name: str) -> None:
    method = trained[name]
    whole, short = Predictor(method, options=OPTIONS), Predictor(method, options=replace(OPTIONS, horizon=2 * DT))
    far, near = fill(whole), fill(short)
    assert near.samples.shape == (60, 2, 6, 3)
    np.testing.assert_allclose(near.mean, far.mean[:2], atol=0.02)
    assert_whole(near)
    np.testing.assert_allclose(near.log_prob(near.mean), far.log_prob(far.mean)[:2], atol=2.0)


@pytest.mark.parametrize("horizon", [0.0, -1.0, 9.9, math.nan])
def test_a_horizon_out_of_range(trained: dict[str, Method[Any]], horizon: float) -> None:
    with pytest.raises(OptionError, match=r"horizon .* is outside 0.0333..0.1 s"):
        Predictor(trained["zero_velocity"], options=replace(OPTIONS, horizon=horizon))
