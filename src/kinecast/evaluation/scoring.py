"""Scores of one method on windows of one recording: what an evaluation does many times over, each time for itself."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from kinecast.body.limits import JointLimits, violations
from kinecast.body.posture import postures_from_points
from kinecast.evaluation.metrics import LEVELS, crps, energy_score, joint_errors, kde_nll, regions
from kinecast.geometry.scene import Scene
from kinecast.prediction.forecast import Follower, Forecast, Method, forecast_with
from kinecast.prediction.observation import Observation
from kinecast.tasks.workers import generator

__all__ = ["EvaluationOptions", "Scores", "TestRecording", "averages", "broken_by_truth", "score_windows"]

NLL_JOINTS = 6
"""NLL is reported per joint: the log density of the whole pose, six joints in m^18, divided by six."""


@dataclass(frozen=True)
class TestRecording:
    """The windows of one unseen recording.

    Attributes:
        name: of the recording.
        observations: W windows as a predictor sees them online.
        future: (W, T, 6, 3) what was measured next [m], NaN where it was not.
        frames: (W,) index of each window's last frame.
        history: every frame from the first full window on, those to be scored among them: its index, the window that
            ends with it, and (6, 3) what was measured [m], NaN where it was not.
    """

    __test__ = False  # not a pytest class

    name: str
    observations: Sequence[Observation]
    future: Float[np.ndarray, "W T 6 3"]
    frames: Int[np.ndarray, " W"]
    history: Sequence[tuple[int, Observation, Float[np.ndarray, "6 3"]]] = ()


@dataclass(frozen=True)
class EvaluationOptions:
    """How scores are taken.

    Attributes:
        samples: S, motions drawn per window.
        repeats: how often the NLL is taken again with fresh random draws, for its histogram.
        repeat_windows: windows, evenly spread over all, on which it is.
        seed: of the draws and of the bootstrap.
        limits: against which samples and truth are counted, whatever a method holds itself to.
    """

    samples: int = 1000
    repeats: int = 25
    repeat_windows: int = 60
    seed: int = 0
    limits: JointLimits = field(default_factory=JointLimits)


@dataclass
class Scores:
    """One method's scores, an entry a window; of `again` an entry a window whose NLL was taken again."""

    error: list[Float[np.ndarray, "T 6"]] = field(default_factory=list)
    nll: list[Float[np.ndarray, " T"]] = field(default_factory=list)
    kde: list[Float[np.ndarray, "T 6"]] = field(default_factory=list)
    crps: list[Float[np.ndarray, "T 6 3"]] = field(default_factory=list)
    energy: list[Float[np.ndarray, "T 6"]] = field(default_factory=list)
    inside: list[Float[np.ndarray, "L T 6"]] = field(default_factory=list)
    volume: list[Float[np.ndarray, "L T 6"]] = field(default_factory=list)
    stretch: list[Float[np.ndarray, "L T 6"]] = field(default_factory=list)
    broken: list[Int[np.ndarray, "4"]] = field(default_factory=list)
    accepted: list[float] = field(default_factory=list)
    distinct: list[int] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)
    again: list[Float[np.ndarray, " K"]] = field(default_factory=list)

    @staticmethod
    def together(parts: Sequence[Scores]) -> Scores:
        """Those of several parts, one after another."""
        return Scores(*([each for part in parts for each in getattr(part, name.name)] for name in fields(Scores)))


def score_windows(
    method: Method,
    recording: TestRecording,
    place: int,
    rows: range,
    repeated: frozenset[int],
    scene: Scene | None,
    options: EvaluationOptions,
) -> Scores:
    """Scores a method on some windows of a recording; draws depend on the window alone.

    Args:
        method: which.
        recording: of the windows.
        place: of the recording among all.
        rows: of the windows in it; all of them where the method follows the person.
        repeated: rows of those whose NLL is taken again.
        scene: obstacles; None for none.
        options: see EvaluationOptions.
    """
    scores = Scores()
    # Compiling is not predicting: the first call is not timed.
    method.forecast(recording.observations[rows[0]], np.random.default_rng(0), options.samples, scene)
    for row, (seconds, memory) in zip(rows, _in_turn(method, recording, rows), strict=True):
        observation, truth = recording.observations[row], recording.future[row]
        rng = generator(options.seed, place, row)
        started = time.perf_counter()
        forecast = forecast_with(method, memory, observation, rng, options.samples, scene)
        scores.seconds.append(seconds + time.perf_counter() - started)
        _score(scores, forecast, observation, truth, scene, options)
        if row in repeated:
            nll = np.empty(options.repeats)
            for k in range(options.repeats):
                fresh = generator(options.seed, place, row, k)
                forecast = forecast_with(method, memory, observation, fresh, options.samples, scene)
                nll[k] = averages(-forecast.density.log_prob(truth)[None])[0] / NLL_JOINTS
            scores.again.append(nll)
    return scores


def broken_by_truth(recording: TestRecording, scene: Scene | None, limits: JointLimits) -> Int[np.ndarray, "W 4"]:
    """Steps in which what was measured breaks position limits, speed limits and the scene; and all known steps."""
    return np.array(
        [
            _violations(truth[None], observation, scene, limits)
            for truth, observation in zip(recording.future, recording.observations, strict=True)
        ],
        dtype=int,
    ).reshape(-1, 4)


def _in_turn(method: Method, recording: TestRecording, rows: range) -> Iterator[tuple[float, Any]]:
    """For each window to be scored, in order: seconds spent on following the person, and what is remembered.

    A method that follows the person sees every frame up to the window's last, and none after it.
    """
    if not isinstance(method, Follower):
        for _ in rows:
            yield 0.0, None
        return
    memory = method.memory()
    scored = set(recording.frames.tolist())
    for frame, observation, measured in recording.history:
        started = time.perf_counter()
        method.follow(memory, observation, measured)
        if frame in scored:
            yield time.perf_counter() - started, memory


def _score(
    scores: Scores,
    forecast: Forecast,
    observation: Observation,
    truth: Float[np.ndarray, "T 6 3"],
    scene: Scene | None,
    options: EvaluationOptions,
) -> None:
    scores.error.append(joint_errors(forecast.mean, truth))
    scores.nll.append(-forecast.density.log_prob(truth) / NLL_JOINTS)
    scores.kde.append(kde_nll(forecast.samples, truth))
    scores.crps.append(crps(forecast.samples, truth))
    scores.energy.append(energy_score(forecast.samples, truth))
    inside, volume, stretch = regions(forecast.samples, truth, LEVELS)
    known = np.isfinite(truth).all(axis=-1)
    scores.inside.append(np.where(known, inside, np.nan))
    scores.volume.append(volume)
    scores.stretch.append(np.where(known, stretch, np.nan))
    scores.broken.append(_violations(forecast.samples, observation, scene, options.limits))
    scores.accepted.append(float(forecast.accepted[-1]))
    scores.distinct.append(forecast.distinct)


def _violations(
    positions: Float[np.ndarray, "S T 6 3"],
    observation: Observation,
    scene: Scene | None,
    limits: JointLimits,
) -> Int[np.ndarray, "4"]:
    """Steps that break position limits, speed limits and the scene, from positions alone; and all known steps."""
    initial = postures_from_points(observation.points, continuous=True)[-1]
    postures = postures_from_points(observation.to_torso(positions), initial, continuous=True, usual=False)
    position, speed = violations(postures, initial, observation.dt, limits)
    known = np.isfinite(positions).all(axis=(-1, -2))
    hit = np.zeros_like(known)
    if scene is not None:
        hit = known & ~scene.free(positions, observation.times(positions.shape[1]))
    return np.array([np.count_nonzero(broken & known) for broken in (position, speed, hit, known)])


def averages(values: Float[np.ndarray, "W ..."]) -> Float[np.ndarray, " W"]:
    """Mean of what was scored of each window; NaN where nothing was."""
    flat = values.reshape(len(values), -1)
    known = ~np.isnan(flat)
    count = known.sum(axis=1)
    return np.where(count > 0, np.where(known, flat, 0.0).sum(axis=1) / np.maximum(count, 1), np.nan)
