"""Every method sees the same windows of unseen recordings and is scored on what came next."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from kinecast.body.limits import JointLimits, violations
from kinecast.body.posture import postures_from_points
from kinecast.datasets.recording import Recording
from kinecast.datasets.windows import WindowOptions, all_windows
from kinecast.evaluation.metrics import (
    LEVELS,
    WRISTS,
    block_bootstrap,
    crps,
    energy_score,
    is_moving,
    joint_errors,
    kde_nll,
    regions,
    scored,
)
from kinecast.geometry.scene import Scene
from kinecast.pipeline import every_frame, followed
from kinecast.prediction.method import Forecast, Method, forecast_in_scene
from kinecast.prediction.observation import Observation
from kinecast.tasks import Progress, Serial, Workers, generator, scatter

NLL_JOINTS = 6
"""NLL is reported per joint: the log density of the whole pose, six joints in m^18, divided by six."""

LIMITS = ("position", "speed", "scene")

Scores = dict[str, Any]
"""Of one window, by name."""

REPEATED = 60
"""Windows, evenly spread over all, whose NLL is taken again and again."""

BOOTSTRAP_BLOCK = 5.0
"""Windows within this time of one another [s] are drawn together for standard errors."""


@dataclass(frozen=True)
class TestRecording:
    """The windows of one unseen recording.

    Attributes:
        name: of the recording.
        future: (W, T, 6, 3) what was measured after each window [m], NaN where it was not.
        frames: (W,) index of each window's last frame.
        history: every frame from the first full window on, those to be scored among them: its index, the window that
            ends with it, and (6, 3) what was measured [m], NaN where it was not.
        left_out: windows in which an arm joint was lost or not measured.
    """

    __test__ = False  # not a pytest class

    name: str
    future: Float[np.ndarray, "W T 6 3"]
    frames: Int[np.ndarray, " W"]
    history: Sequence[tuple[int, Observation, Float[np.ndarray, "6 3"]]]
    left_out: int = 0

    @classmethod
    def of(
        cls, recordings: Sequence[Recording], options: WindowOptions, workers: Workers | None = None
    ) -> list[TestRecording]:
        """Recordings cut into windows; those without one are passed over. Raises as `all_windows`."""
        parts = all_windows(recordings, options, workers=workers)
        every = {each.name: followed(each) for each in all_windows(recordings, every_frame(options), workers=workers)}
        return [cls(part.name, part.future, part.frames, every[part.name], part.left_out) for part in parts]

    @cached_property
    def observations(self) -> list[Observation]:
        """W windows as a predictor sees them online."""
        seen = {frame: observation for frame, observation, _ in self.history}
        return [seen[frame] for frame in self.frames.tolist()]


@dataclass(frozen=True)
class EvaluationOptions:
    """How scores are taken.

    Attributes:
        samples: S, motions drawn per window.
        repeats: how often the NLL of `REPEATED` windows is taken again with fresh random draws, for its histogram.
        seed: of the draws and of the bootstrap.
        limits: against which samples and truth are counted, whatever a method holds itself to.
    """

    samples: int = 1000
    repeats: int = 25
    seed: int = 0
    limits: JointLimits = field(default_factory=JointLimits)


def evaluate(
    methods: Mapping[str, Method[Any]],
    recordings: Sequence[TestRecording],
    scene: Scene | None,
    options: EvaluationOptions,
    progress: Progress | None = None,
    workers: Workers | None = None,
) -> tuple[dict[str, Any], dict[str, Float[np.ndarray, " K"]]]:
    """Scores methods on recordings.

    Args:
        methods: by name.
        recordings: windows of recordings that no method was trained on.
        scene: obstacles; None for none.
        options: see EvaluationOptions.
        progress: called with (done, total) tasks.
        workers: that do them; None for this process. But for latencies, results are the same to the last bit.

    Returns:
        The `ground_truth_violations` and `methods` entries of metrics.json, and each method's NLL per repeat.
    """
    workers = workers or Serial()
    owner = np.concatenate([np.full(len(r.observations), k) for k, r in enumerate(recordings)])
    repeated = _repeated(owner, len(recordings), options)
    shared = [workers.submit(scatter, recording) for recording in recordings]
    truth = [workers.submit(_broken_by_truth, each, scene, options.limits) for each in shared]
    tasks = {
        name: [
            workers.submit(score_recording, method, recording, place, repeated[place], scene, options)
            for place, recording in enumerate(shared)
        ]
        for name, method in ((name, workers.submit(scatter, method)) for name, method in methods.items())
    }
    results = iter(workers.results([*truth, *(task for each in tasks.values() for task in each)], progress))
    broken = [row for _ in truth for row in next(results)]
    scores = {name: [window for _ in each for window in next(results)] for name, each in tasks.items()}
    again = {name: [window["again"] for window in each if "again" in window] for name, each in scores.items()}
    return {
        "ground_truth_violations": _shares(broken),
        "methods": {name: _summary(each, recordings, owner, options) for name, each in scores.items()},
    }, {name: _averages(np.array(each).T) if each else np.empty(0) for name, each in again.items()}


def warm_up(
    methods: Mapping[str, Method[Any]],
    recordings: Sequence[TestRecording],
    scene: Scene | None,
    options: EvaluationOptions,
) -> None:
    """Scores each method on the first window, which there must be, so that everything is compiled."""
    for method in methods.values():
        first = recordings[0].observations[0]
        state = method.update(method.init_state(), first, first.positions[-1])
        forecast = forecast_in_scene(method, state, first, generator(0), options.samples, scene)
        score_window(forecast, first, recordings[0].future[0], scene, options)


# One method on windows of one recording: what an evaluation does many times over, each time for itself


def score_window(
    forecast: Forecast,
    observation: Observation,
    truth: Float[np.ndarray, "T 6 3"],
    scene: Scene | None,
    options: EvaluationOptions,
) -> Scores:
    """Scores of one forecast: arrays (T, 6), (T,) of the NLL, (T, 6, 3) of CRPS, (L, T, 6) of regions."""
    inside, volume, stretch = regions(forecast.samples, truth)
    return {
        "error": joint_errors(forecast.mean, truth),
        "nll": -forecast.density.log_prob(truth) / NLL_JOINTS,
        "kde": kde_nll(forecast.samples, truth),
        "crps": crps(forecast.samples, truth),
        "energy": energy_score(forecast.samples, truth),
        "inside": np.where(scored(truth), inside, np.nan),
        "volume": volume,
        "stretch": stretch,
        "broken": _violations(forecast.samples, observation, scene, options.limits),
        "accepted": forecast.accepted_fraction,
        "distinct": forecast.effective_sample_size,
    }


def score_recording(
    method: Method[Any],
    recording: TestRecording,
    place: int,
    repeated: frozenset[int],
    scene: Scene | None,
    options: EvaluationOptions,
) -> list[Scores]:
    """Scores a method on the windows of a recording; draws depend on the window alone.

    The method sees every frame up to a window's last, and none after it. Beside the scores of each window, the seconds
    it took, and where it is repeated the NLL taken again.

    Args:
        place: of the recording among all.
        repeated: rows of those windows whose NLL is taken again.
    """
    windows: list[Scores] = []
    rows = {frame: row for row, frame in enumerate(recording.frames.tolist())}
    state = method.init_state()
    for frame, observation, measured in recording.history:
        started = time.perf_counter()
        state = method.update(state, observation, measured)
        if frame not in rows:
            continue
        row = rows[frame]
        truth = recording.future[row]
        forecast = forecast_in_scene(
            method, state, observation, generator(options.seed, place, row), options.samples, scene
        )
        seconds = time.perf_counter() - started
        windows.append({**score_window(forecast, observation, truth, scene, options), "seconds": seconds})
        if row in repeated:
            nll = np.empty(options.repeats)
            for k in range(options.repeats):
                fresh = generator(options.seed, place, row, k)
                forecast = forecast_in_scene(method, state, observation, fresh, options.samples, scene)
                nll[k] = _averages(-forecast.density.log_prob(truth)[None])[0] / NLL_JOINTS
            windows[-1]["again"] = nll
    return windows


def _repeated(owner: Int[np.ndarray, " W"], recordings: int, options: EvaluationOptions) -> list[frozenset[int]]:
    """Per recording, rows of the windows whose NLL is taken again."""
    count = min(REPEATED, len(owner)) if options.repeats else 0
    again = np.linspace(0, len(owner) - 1, count).astype(int)
    first = np.searchsorted(owner, np.arange(recordings))
    return [frozenset((again[owner[again] == k] - start).tolist()) for k, start in enumerate(first.tolist())]


def _broken_by_truth(recording: TestRecording, scene: Scene | None, limits: JointLimits) -> list[Int[np.ndarray, "4"]]:
    """`_violations` of what was measured after each window."""
    pairs = zip(recording.future, recording.observations, strict=True)
    return [_violations(truth[None], observation, scene, limits) for truth, observation in pairs]


def _violations(
    positions: Float[np.ndarray, "S T 6 3"], observation: Observation, scene: Scene | None, limits: JointLimits
) -> Int[np.ndarray, "4"]:
    """Steps that break position limits, speed limits and the scene, from positions alone; and all known steps."""
    initial = observation.posture
    postures = postures_from_points(observation.to_torso(positions), initial, continuous=True, usual=False)
    position, speed = violations(postures, initial, observation.dt, limits)
    known = np.isfinite(positions).all(axis=(-1, -2))
    hit = np.zeros_like(known)
    if scene is not None:
        hit = known & ~scene.free(positions, observation.times(positions.shape[1]))
    return np.array([np.count_nonzero(broken & known) for broken in (position, speed, hit, known)])


# Averages


def _summary(
    windows: Sequence[Scores],
    recordings: Sequence[TestRecording],
    owner: Int[np.ndarray, " W"],
    options: EvaluationOptions,
) -> dict[str, Any]:
    """One method's entry of metrics.json."""
    of = {name: np.array([window[name] for window in windows]) for name in windows[0] if name != "again"}
    error, nll, volume, inside, stretch = (of[name] for name in ("error", "nll", "volume", "inside", "stretch"))
    moving = np.array([is_moving(o.positions, o.dt) for recording in recordings for o in recording.observations])
    apart = np.concatenate([np.diff([o.stamp for o in recording.observations]) for recording in recordings])
    block = max(round(BOOTSTRAP_BLOCK / (np.median(apart) or 1.0)), 1) if len(apart) else 1
    levels = {str(level): k for k, level in enumerate(LEVELS)}

    def three(select: Bool[np.ndarray, " W"]) -> dict[str, float | None]:
        return {
            "mpjpe_mm": _mean(1e3 * error[select]),
            "crps_mm": _mean(1e3 * of["crps"][select]),
            "nll": _mean(nll[select]),
        }

    def coverage(select: Bool[np.ndarray, " W"]) -> dict[str, float | None]:
        return {level: _mean(inside[select, k]) for level, k in levels.items()}

    def stderr(values: Float[np.ndarray, "W ..."]) -> float | None:
        return _number(block_bootstrap(_averages(values), owner, block, options.seed))

    everything = np.ones(len(owner), dtype=bool)
    return {
        **three(everything),
        "mpjpe_mm_by_step": [_mean(1e3 * error[:, t]) for t in range(error.shape[1])],
        "mpjpe_mm_stderr": stderr(1e3 * error),
        "moving_mpjpe_mm": _mean(1e3 * error[moving]),
        "wrist_final_mm": _mean(1e3 * error[:, -1, WRISTS]),
        "nll_stderr": stderr(nll),
        "kde_nll": _mean(of["kde"]),
        "energy_score_mm": _mean(1e3 * of["energy"]),
        "coverage": coverage(everything),
        "coverage_by_step": {
            level: [_mean(inside[:, k, t]) for t in range(inside.shape[2])] for level, k in levels.items()
        },
        "region_litres": {level: _mean(1e3 * volume[:, k]) for level, k in levels.items()},
        "calibrated_region_litres": {
            level: _calibrated(1e3 * volume[:, k], stretch[:, k], float(level)) for level, k in levels.items()
        },
        "violations": _shares(of["broken"]),
        "accepted_fraction": float(of["accepted"].mean()),
        "effective_sample_size": float(of["distinct"].mean()),
        "blocked_windows": int(np.count_nonzero(of["distinct"] == 0)),
        "latency_ms": {f"p{share}": float(np.percentile(1e3 * of["seconds"], share)) for share in (50, 99)},
        "moving": {"windows": int(moving.sum()), **three(moving)},
        "recordings": {
            recording.name: {"windows": int((owner == k).sum()), **three(owner == k), "coverage": coverage(owner == k)}
            for k, recording in enumerate(recordings)
        },
    }


def _shares(counts: Sequence[Int[np.ndarray, "4"]] | Int[np.ndarray, "W 4"]) -> dict[str, float]:
    """Shares of the known steps of all windows that break each kind of limit."""
    total = np.sum(counts, axis=0) if len(counts) else np.zeros(4)
    return {name: float(broken / max(total[3], 1)) for name, broken in zip(LIMITS, total[:3], strict=True)}


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
