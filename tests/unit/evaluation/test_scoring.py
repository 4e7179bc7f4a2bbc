"""The protocol on motions whose scores are known in closed form."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.stats import chi2

from kinecast.body.limits import AngleLimit, JointLimits
from kinecast.body.posture import points_from_postures
from kinecast.evaluation import report
from kinecast.evaluation.metrics import LEVELS
from kinecast.evaluation.scoring import EvaluationOptions, TestRecording, evaluate
from kinecast.geometry.scene import Scene
from kinecast.geometry.shapes import Sphere
from kinecast.prediction.density import PoseDensity
from kinecast.prediction.gaussian import PositionGaussian
from kinecast.prediction.linear import constant_velocity, zero_velocity
from kinecast.prediction.method import Forecast, Memoryless
from kinecast.prediction.observation import Observation

DT, N, T = 0.1, 4, 3
UP = np.array([0.0, 0.0, 1.0])
POSTURE = np.array([0, 0, 0, 0, 0, 0.36, 0.4, 0.3, -0.5, 1.2, 0.30, 0.26, 0.5, 0.2, -0.4, 1.4, 0.28, 0.24])
ARMS = points_from_postures(POSTURE) + np.array([0.0, 0.0, 1.4])
QUICK = EvaluationOptions(samples=200, repeats=0)


def gliding(speed: float, windows: int = 12, name: str = "a", noise: float = 0.0) -> TestRecording:
    """Somebody who glides along a straight line; what is measured next may be noisy."""
    rng = np.random.default_rng(0)
    step = speed * DT * np.array([0.6, 0.0, 0.8])
    seen, future = [], []
    for k in range(windows):
        frames = ARMS + step * (k + np.arange(1 - N, T + 1))[:, None, None]
        seen.append(Observation(frames[:N], UP, DT, k * DT))
        future.append(frames[N:] + noise * rng.standard_normal((T, 6, 3)))
    return recorded(name, seen, np.array(future).reshape(-1, T, 6, 3))


def recorded(name: str, seen: list[Observation], future: np.ndarray) -> TestRecording:
    """A recording of which every frame is scored."""
    history = [(k, each, each.positions[-1]) for k, each in enumerate(seen)]
    return TestRecording(name, future, np.arange(len(seen)), history)


def gaussian(moving: bool, spread: float) -> PositionGaussian:
    """Zero or constant velocity, with the same independent spread everywhere."""
    mean = constant_velocity(N, T) if moving else zero_velocity(N, T)
    return PositionGaussian(N, T, DT, mean, spread * np.eye(18 * T))


@dataclass(frozen=True)
class Fixed(Memoryless):
    """A method that always says the same, whatever it sees."""

    motions: Callable[[Observation], np.ndarray]
    frames: int = N
    steps: int = T
    dt: float = DT

    def forecast(self, state: None, observation: Observation, rng: np.random.Generator, samples: int) -> Forecast:
        motions = self.motions(observation)
        density = gaussian(False, 0.1).forecast(None, observation, np.random.default_rng(0), 1).density
        assert isinstance(density, PoseDensity)
        accepted = np.linspace(1.0, 0.5, T)
        return Forecast(motions, motions.mean(axis=0), density, accepted=accepted, distinct=7)

    def to_arrays(self) -> dict[str, np.ndarray]:
        return {}


def test_errors_on_a_straight_line_are_known() -> None:
    speed = 0.5
    methods = {"zero": gaussian(False, 0.01), "constant": gaussian(True, 0.01)}
    results, _ = evaluate(methods, [gliding(speed)], None, QUICK)
    zero, constant = results["methods"]["zero"], results["methods"]["constant"]
    steps = 1e3 * speed * DT * np.arange(1, T + 1)
    np.testing.assert_allclose(zero["mpjpe_mm_by_step"], steps, atol=1e-9)
    assert zero["mpjpe_mm"] == pytest.approx(steps.mean())
    assert zero["wrist_final_mm"] == pytest.approx(steps[-1])
    assert zero["mpjpe_mm_stderr"] == pytest.approx(0.0, abs=1e-9)
    assert constant["mpjpe_mm"] == pytest.approx(0.0, abs=1e-9)
    # At its own mean a Gaussian's CRPS is σ (√2 − 1) / √π; 200 samples, 54 numbers a window.
    assert constant["crps_mm"] == pytest.approx(10.0 * (math.sqrt(2) - 1) / math.sqrt(math.pi), rel=0.03)
    # NLL per joint: three coordinates of spread 10 mm, but for the share of tracker's faults.
    nll = 3 * (math.log(0.01) + 0.5 * math.log(2 * math.pi)) - 3 * math.log(0.99) / 6
    assert constant["nll"] == pytest.approx(nll, abs=1e-6)
    assert 0.0 < zero["latency_ms"]["p50"] <= zero["latency_ms"]["p99"] < 5000.0


@pytest.mark.parametrize(("speed", "moving"), [(0.2, 0), (0.5, 12)])
def test_moving_windows_are_those_with_a_fast_wrist(speed: float, moving: int) -> None:
    score = evaluate({"zero": gaussian(False, 0.01)}, [gliding(speed)], None, QUICK)[0]["methods"]["zero"]
    assert score["moving"]["windows"] == moving
    assert score["moving_mpjpe_mm"] == (pytest.approx(score["mpjpe_mm"]) if moving else None)
    assert score["moving"]["nll"] == (pytest.approx(score["nll"]) if moving else None)


@pytest.mark.parametrize("claimed", [0.01, 0.02])
def test_coverage_is_the_share_of_truths_inside(claimed: float) -> None:
    windows = 60
    recording = gliding(0.5, windows, noise=0.01)
    score = evaluate({"m": gaussian(True, claimed)}, [recording], None, QUICK)[0]["methods"]["m"]
    for level in LEVELS:
        # A ball of the claimed spread that holds the level, asked of truths of spread 10 mm.
        expected = chi2(3).cdf(chi2(3).ppf(level) * (claimed / 0.01) ** 2)
        # Windows share nothing, six joints and three steps each; the samples' own region adds some error.
        error = math.sqrt(expected * (1 - expected) / (windows * 18)) + 0.012
        assert score["coverage"][str(level)] == pytest.approx(expected, abs=4 * error)
    by_step = score["coverage_by_step"]["0.9"]
    assert len(by_step) == T
    assert np.mean(by_step) == pytest.approx(score["coverage"]["0.9"])
    volume = 4 / 3 * math.pi * (claimed * math.sqrt(chi2(3).ppf(0.9))) ** 3 * 1e3
    assert score["region_litres"]["0.9"] == pytest.approx(volume, rel=0.2)


def bent(elbow: float, lift: float) -> np.ndarray:
    """(6, 3) arms with another right elbow, or lifted as a whole."""
    posture = POSTURE.copy()
    posture[15] = elbow
    return points_from_postures(posture) + np.array([0.0, 0.0, 1.4 + lift])


def test_violations_are_counted_from_positions() -> None:
    limits = JointLimits(elbow=AngleLimit(0.0, 1.6, 4.0))
    ball = Sphere(bent(1.4, 0.5)[2], 0.05)

    def motions(_: Observation) -> np.ndarray:
        still = np.repeat(bent(1.4, 0.0)[None], T, axis=0)
        slow = np.stack([bent(1.5, 0.0), bent(1.55, 0.0), bent(1.5, 0.0)])
        beyond = np.stack([bent(1.5, 0.0), bent(1.7, 0.0), bent(1.8, 0.0)])  # two steps out of range
        fast = np.stack([bent(1.4, 0.0), bent(0.5, 0.0), bent(0.5, 0.0)])  # one step of 9 rad/s
        hitting = np.stack([bent(1.4, 0.0), bent(1.4, 0.5), bent(1.4, 0.5)])  # two steps inside the ball
        return np.stack([still, slow, beyond, fast, hitting])

    seen = Observation(np.repeat(ARMS[None], N, axis=0), UP, DT)
    still = recorded("still", [seen] * 3, np.full((3, T, 6, 3), np.nan))
    still.future[0] = motions(seen)[2]
    still.future[1] = motions(seen)[0]
    results, _ = evaluate(
        {"m": Fixed(motions)}, [still], Scene((ball,)), EvaluationOptions(samples=5, repeats=0, limits=limits)
    )
    found = results["methods"]["m"]["violations"]
    assert found == {"position": pytest.approx(2 / 15), "speed": pytest.approx(1 / 15), "scene": pytest.approx(2 / 15)}
    # Of the six steps that were measured two are out of range; the window that was not measured does not count.
    assert results["ground_truth_violations"] == {"position": pytest.approx(2 / 6), "speed": 0.0, "scene": 0.0}
    assert results["methods"]["m"]["accepted_fraction"] == 0.5
    assert results["methods"]["m"]["effective_sample_size"] == 7


def test_what_was_not_measured_is_not_scored() -> None:
    whole, holed = gliding(0.5), gliding(0.5)
    holed.future[:, :, 2] = np.nan
    holed.future[3] = np.nan
    methods = {"zero": gaussian(False, 0.02)}
    options = EvaluationOptions(samples=100, repeats=2)
    results, histograms = evaluate(methods, [holed], None, options)
    score = results["methods"]["zero"]
    # Zero velocity errs alike everywhere, so what is left has the same mean.
    expected, _ = evaluate(methods, [whole], None, QUICK)
    assert score["mpjpe_mm"] == pytest.approx(expected["methods"]["zero"]["mpjpe_mm"])
    assert score["nll"] is None  # a pose without one joint has no density
    assert score["nll_stderr"] is None
    assert np.isnan(histograms["zero"]).all()
    assert 0.0 <= score["coverage"]["0.9"] <= 1.0
    json.dumps(results, allow_nan=False)


def test_a_nan_costs_its_own_step_alone() -> None:
    holed = gliding(0.5)
    holed.future[3, 1, 4, 0] = np.nan
    score = evaluate({"zero": gaussian(False, 0.02)}, [holed], None, QUICK)[0]["methods"]["zero"]
    whole = evaluate({"zero": gaussian(False, 0.02)}, [gliding(0.5)], None, QUICK)[0]["methods"]["zero"]
    assert score["mpjpe_mm_by_step"] == pytest.approx(whole["mpjpe_mm_by_step"])
    assert score["nll"] == pytest.approx(whole["nll"], abs=0.1)


def test_recordings_are_reported_apart_and_together() -> None:
    parts = [gliding(0.2, 10, "slow"), gliding(0.8, 30, "fast"), gliding(0.4, 0, "empty")]
    score = evaluate({"zero": gaussian(False, 0.02)}, parts, None, QUICK)[0]["methods"]["zero"]
    slow, fast, empty = (score["recordings"][name] for name in ("slow", "fast", "empty"))
    assert (slow["windows"], fast["windows"], empty["windows"]) == (10, 30, 0)
    assert fast["mpjpe_mm"] == pytest.approx(4 * slow["mpjpe_mm"])
    assert empty["mpjpe_mm"] is None
    assert score["mpjpe_mm"] == pytest.approx((10 * slow["mpjpe_mm"] + 30 * fast["mpjpe_mm"]) / 40)
    assert score["moving"]["windows"] == 30
    assert score["mpjpe_mm_stderr"] > 0


def test_the_histogram_repeats_the_nll_with_fresh_draws() -> None:
    options = EvaluationOptions(samples=50, repeats=3)
    methods = {"exact": gaussian(True, 0.01)}
    seen: list[tuple[int, int]] = []
    results, histograms = evaluate(methods, [gliding(0.5)], None, options, lambda *told: seen.append(told))
    assert [done for done, _ in seen] == list(range(1, seen[-1][1] + 1))
    # A closed form does not depend on the draws.
    np.testing.assert_allclose(histograms["exact"], results["methods"]["exact"]["nll"], atol=1e-9)
    assert histograms["exact"].shape == (3,)
    assert evaluate(methods, [gliding(0.5)], None, QUICK)[1]["exact"].shape == (0,)


def test_scores_do_not_depend_on_which_other_methods_are_scored() -> None:
    methods = {"a": gaussian(False, 0.02), "b": gaussian(True, 0.03)}
    together = evaluate(methods, [gliding(0.5)], None, QUICK)[0]["methods"]
    alone = evaluate({"b": methods["b"]}, [gliding(0.5)], None, QUICK)[0]["methods"]
    for name in ("mpjpe_mm", "crps_mm", "nll", "kde_nll", "energy_score_mm", "coverage"):
        assert together["b"][name] == alone["b"][name]


class Remembering(Fixed):
    """Remembers which frames it was shown."""

    def init_state(self) -> list[float]:
        return []

    def update(self, state: list[float], observation: Observation, measured: np.ndarray) -> list[float]:
        assert np.isnan(measured).all() or np.array_equal(measured, observation.positions[-1])
        return [*state, observation.stamp]

    def forecast(
        self, state: list[float], observation: Observation, rng: np.random.Generator, samples: int
    ) -> Forecast:
        # Every frame up to this window's last, in order, and none after it.
        assert state == [k * DT for k in range(round(observation.stamp / DT) + 1)]
        return super().forecast(None, observation, rng, samples)


def test_methods_see_every_frame_and_none_too_many() -> None:
    every = gliding(0.5, 12)
    history = [(k, seen, seen.positions[-1]) for k, seen in enumerate(every.observations)]
    third = TestRecording("a", every.future[2::3], np.arange(2, 12, 3), history)
    still = Remembering(lambda o: np.repeat(np.repeat(o.positions[-1:], T, axis=0)[None], 3, axis=0))
    score = evaluate({"m": still}, [third, third], None, QUICK)[0]["methods"]["m"]
    assert score["mpjpe_mm"] == pytest.approx(100.0)
    assert score["recordings"]["a"]["windows"] == 4


def test_what_is_drawn_shows_the_truth_and_no_more_was_seen(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    drawn: dict[str, Any] = {}

    def keep(path: Path, what: Any, *_: object) -> None:
        drawn[path.suffix] = what
        path.touch()

    monkeypatch.setattr(report, "draw_prediction", keep)
    monkeypatch.setattr(report, "animate_predictions", keep)
    monkeypatch.setattr(report, "write_report", lambda *_: None)
    recording = gliding(0.5, windows=30)
    report.run_evaluation(tmp_path / "out", {"still": gaussian(False, 1e-4)}, [recording], None, QUICK, {})
    still, film = drawn[".png"], drawn[".gif"]
    at = [moment.stamp for moment in film].index(still.stamp)
    assert np.allclose(np.diff([moment.stamp for moment in film]), DT)
    assert 1 + report.FILM / DT <= len(film) <= 1 + 2 * report.FILM / DT
    assert film[at] is still
    for moment in film:
        row = round(moment.stamp / DT)
        np.testing.assert_array_equal(moment.truth, recording.future[row])
        np.testing.assert_array_equal(moment.observed, recording.observations[row].positions)
        np.testing.assert_allclose(moment.mean, np.tile(moment.now, (T, 1, 1)), atol=0.01)
