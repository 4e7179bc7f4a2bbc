"""The protocol: every method sees the same windows of unseen recordings and is scored on what came next."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from kinecast.body.limits import JointLimits, violations
from kinecast.body.posture import postures_from_points
from kinecast.evaluation.bootstrap import block_bootstrap
from kinecast.evaluation.metrics import LEVELS, crps, energy_score, is_moving, joint_errors, kde_nll, regions
from kinecast.geometry.scene import Scene
from kinecast.prediction.forecast import Follower, Forecast, Method, forecast_with
from kinecast.prediction.observation import Observation

__all__ = ["EvaluationOptions", "TestRecording", "evaluate"]

BOOTSTRAP_BLOCK = 5.0
"""Windows within this time of one another [s] are drawn together for standard errors."""

Progress = Callable[[int, int], None]

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
class _Scores:
    """One method's scores, an entry a window."""

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


def evaluate(
    methods: Mapping[str, Method],
    recordings: Sequence[TestRecording],
    scene: Scene | None,
    options: EvaluationOptions,
    progress: Progress | None = None,
) -> tuple[dict[str, Any], dict[str, Float[np.ndarray, " K"]]]:
    """Scores methods on recordings.

    Args:
        methods: by name.
        recordings: windows of recordings that no method was trained on.
        scene: obstacles; None for none.
        options: see EvaluationOptions.
        progress: called with (done, total) predictions.

    Returns:
        The `ground_truth_violations` and `methods` entries of metrics.json, and each method's NLL per repeat.
    """
    owner = np.concatenate([np.full(len(r.observations), k) for k, r in enumerate(recordings)])
    observations = [observation for recording in recordings for observation in recording.observations]
    future = np.concatenate([recording.future for recording in recordings])
    moving = np.array([is_moving(o.positions, o.dt) for o in observations])
    again = np.linspace(0, len(observations) - 1, min(options.repeat_windows, len(observations))).astype(int)
    repeated = set(again.tolist()) if options.repeats else set()
    apart = np.concatenate([np.diff([o.stamp for o in recording.observations]) for recording in recordings])
    pace = float(np.median(apart)) if len(apart) else 0.0
    total, done = len(methods) * len(observations), 0

    truth_broken = [
        _violations(truth[None], o, scene, options.limits) for truth, o in zip(future, observations, strict=True)
    ]
    results: dict[str, Any] = {}
    histograms: dict[str, Float[np.ndarray, " K"]] = {}
    for name, method in methods.items():
        scores = _Scores()
        repeats = []
        rng = np.random.default_rng(options.seed)
        # Compiling is not predicting: the first call is not timed.
        method.forecast(observations[0], np.random.default_rng(0), options.samples, scene)
        forecasters = (forecaster for recording in recordings for forecaster in _in_turn(method, recording))
        for row, (seconds, memory) in enumerate(forecasters):
            observation, truth = observations[row], future[row]
            started = time.perf_counter()
            forecast = forecast_with(method, memory, observation, rng, options.samples, scene)
            scores.seconds.append(seconds + time.perf_counter() - started)
            _score(scores, forecast, observation, truth, scene, options)
            if row in repeated:
                again_nll = np.empty(options.repeats)
                for k in range(options.repeats):
                    fresh = np.random.default_rng([options.seed, k, row])
                    forecast = forecast_with(method, memory, observation, fresh, options.samples, scene)
                    again_nll[k] = _averages(-forecast.density.log_prob(truth)[None])[0] / NLL_JOINTS
                repeats.append(again_nll)
            done += 1
            if progress:
                progress(done, total)
        histograms[name] = _averages(np.array(repeats).T) if repeats else np.empty(0)
        results[name] = _summary(scores, owner, [r.name for r in recordings], moving, options, pace)
    names = ("position", "speed", "scene")
    return {
        "ground_truth_violations": dict(zip(names, _share(truth_broken).tolist(), strict=True)),
        "methods": results,
    }, histograms


def _in_turn(method: Method, recording: TestRecording) -> Iterator[tuple[float, Any]]:
    """For each window to be scored, in order: seconds spent on following the person, and what is remembered.

    A method that follows the person sees every frame up to the window's last, and none after it.
    """
    if not isinstance(method, Follower):
        for _ in recording.observations:
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
    scores: _Scores,
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


def _share(counts: Sequence[Int[np.ndarray, "4"]]) -> Float[np.ndarray, "3"]:
    """Shares of the known steps of all windows that break position limits, speed limits and the scene."""
    total = np.sum(counts, axis=0, initial=0) if len(counts) else np.zeros(4, dtype=int)
    return total[:3] / max(int(total[3]), 1)


def _summary(
    scores: _Scores,
    owner: Int[np.ndarray, " W"],
    names: Sequence[str],
    moving: Bool[np.ndarray, " W"],
    options: EvaluationOptions,
    pace: float,
) -> dict[str, Any]:
    error, nll, volume = np.array(scores.error), np.array(scores.nll), np.array(scores.volume)
    crps_, inside, stretch = np.array(scores.crps), np.array(scores.inside), np.array(scores.stretch)
    per_window = _averages(error)
    block = max(round(BOOTSTRAP_BLOCK / (pace or 1.0)), 1)
    broken = _share(scores.broken)
    seconds = 1e3 * np.array(scores.seconds)

    def three(select: Bool[np.ndarray, " W"]) -> dict[str, float | None]:
        return {
            "mpjpe_mm": _mean(1e3 * error[select]),
            "crps_mm": _mean(1e3 * crps_[select]),
            "nll": _mean(nll[select]),
        }

    def coverage(select: Bool[np.ndarray, " W"]) -> dict[str, float | None]:
        return {str(level): _mean(inside[select, k]) for k, level in enumerate(LEVELS)}

    everything = np.ones(len(owner), dtype=bool)
    return {
        **three(everything),
        "mpjpe_mm_by_step": [_mean(1e3 * error[:, t]) for t in range(error.shape[1])],
        "mpjpe_mm_stderr": _number(1e3 * block_bootstrap(per_window, owner, block=block, seed=options.seed).stderr),
        "moving_mpjpe_mm": _mean(1e3 * error[moving]),
        "wrist_final_mm": _mean(1e3 * error[:, -1, [2, 5]]),
        "nll_stderr": _number(block_bootstrap(_averages(nll), owner, block=block, seed=options.seed).stderr),
        "kde_nll": _mean(np.array(scores.kde)),
        "energy_score_mm": _mean(1e3 * np.array(scores.energy)),
        "coverage": coverage(everything),
        "coverage_by_step": {
            str(level): [_mean(inside[:, k, t]) for t in range(inside.shape[2])] for k, level in enumerate(LEVELS)
        },
        "region_litres": {str(level): _mean(1e3 * volume[:, k]) for k, level in enumerate(LEVELS)},
        "calibrated_region_litres": {
            str(level): _calibrated(1e3 * volume[:, k], stretch[:, k], level) for k, level in enumerate(LEVELS)
        },
        "violations": {"position": float(broken[0]), "speed": float(broken[1]), "scene": float(broken[2])},
        "accepted_fraction": float(np.mean(scores.accepted)),
        "effective_sample_size": float(np.mean(scores.distinct)),
        "blocked_windows": int(np.count_nonzero(np.array(scores.distinct) == 0)),
        "latency_ms": {"p50": float(np.percentile(seconds, 50)), "p99": float(np.percentile(seconds, 99))},
        "moving": {"windows": int(moving.sum()), **three(moving)},
        "recordings": {
            name: {"windows": int((owner == k).sum()), **three(owner == k), "coverage": coverage(owner == k)}
            for k, name in enumerate(names)
        },
    }


def _calibrated(
    volume: Float[np.ndarray, "W T 6"], stretch: Float[np.ndarray, "W T 6"], level: float
) -> dict[str, float | None]:
    """Volumes of regions whose radii are multiplied by the one factor with which they cover what they should.

    Methods are then compared at equal coverage. Wide regions govern the mean, all count alike in the typical one (the
    geometric mean).
    """
    known = stretch[~np.isnan(stretch)]
    factor = np.quantile(known, level, method="higher") if known.size else np.inf
    if not np.isfinite(factor):
        return {"mean": None, "typical": None}
    scaled = volume * factor**3
    middle = _mean(np.log(np.where(scaled > 0, scaled, np.nan)))
    return {"mean": _mean(scaled), "typical": None if middle is None else float(np.exp(middle))}


def _averages(values: Float[np.ndarray, "W ..."]) -> Float[np.ndarray, " W"]:
    """Mean of what was scored of each window; NaN where nothing was."""
    flat = values.reshape(len(values), -1)
    known = ~np.isnan(flat)
    count = known.sum(axis=1)
    return np.where(count > 0, np.where(known, flat, 0.0).sum(axis=1) / np.maximum(count, 1), np.nan)


def _number(value: float) -> float | None:
    """The value; None where it is not a number, which JSON cannot say."""
    return float(value) if np.isfinite(value) else None


def _mean(values: Float[np.ndarray, "..."]) -> float | None:
    """Mean of what was scored; None where nothing was."""
    finite = values[~np.isnan(values)]
    return float(finite.mean()) if finite.size else None
