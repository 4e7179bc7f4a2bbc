"""The protocol: every method sees the same windows of unseen recordings and is scored on what came next."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from kinecast.evaluation.bootstrap import block_bootstrap
from kinecast.evaluation.metrics import LEVELS, is_moving
from kinecast.evaluation.scoring import (
    EvaluationOptions,
    Scores,
    TestRecording,
    averages,
    broken_by_truth,
    score_windows,
)
from kinecast.geometry.scene import Scene
from kinecast.prediction.forecast import Follower, Method
from kinecast.tasks.workers import Progress, Serial, Workers, given

__all__ = ["EvaluationOptions", "TestRecording", "evaluate"]

BOOTSTRAP_BLOCK = 5.0
"""Windows within this time of one another [s] are drawn together for standard errors."""

BLOCK = 100
"""Windows scored in one task."""


def evaluate(
    methods: Mapping[str, Method],
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
    observations = [observation for recording in recordings for observation in recording.observations]
    moving = np.array([is_moving(o.positions, o.dt) for o in observations])
    apart = np.concatenate([np.diff([o.stamp for o in recording.observations]) for recording in recordings])
    pace = float(np.median(apart)) if len(apart) else 0.0
    repeated = _repeated(owner, options)

    shared = [workers.submit(given, recording) for recording in recordings]
    truth = [workers.submit(broken_by_truth, each, scene, options.limits) for each in shared]
    scored = {
        name: [
            workers.submit(score_windows, method, shared[place], place, rows, repeated[place], scene, options)
            for place, recording in enumerate(recordings)
            for rows in _blocks(methods[name], len(recording.observations))
        ]
        for name, method in ((name, workers.submit(given, method)) for name, method in methods.items())
    }
    parts = iter(workers.results([*truth, *(task for tasks in scored.values() for task in tasks)], progress))
    broken = [row for _ in truth for row in next(parts)]
    results: dict[str, Any] = {}
    histograms: dict[str, Float[np.ndarray, " K"]] = {}
    for name, tasks in scored.items():
        scores = Scores.together([next(parts) for _ in tasks])
        histograms[name] = averages(np.array(scores.again).T) if scores.again else np.empty(0)
        results[name] = _summary(scores, owner, [r.name for r in recordings], moving, options, pace)
    names = ("position", "speed", "scene")
    return {
        "ground_truth_violations": dict(zip(names, _share(broken).tolist(), strict=True)),
        "methods": results,
    }, histograms


def _blocks(method: Method, windows: int) -> list[range]:
    """Windows of a recording that are scored together: all where the method follows the person."""
    size = windows if isinstance(method, Follower) else BLOCK
    return [range(start, min(start + size, windows)) for start in range(0, windows, max(size, 1))]


def _repeated(owner: Int[np.ndarray, " W"], options: EvaluationOptions) -> list[frozenset[int]]:
    """Per recording, rows of the windows whose NLL is taken again."""
    count = min(options.repeat_windows, len(owner)) if options.repeats else 0
    again = np.linspace(0, len(owner) - 1, count).astype(int)
    first = np.searchsorted(owner, np.arange(owner.max(initial=-1) + 1))
    return [frozenset((again[owner[again] == k] - start).tolist()) for k, start in enumerate(first.tolist())]


def _share(counts: Sequence[Int[np.ndarray, "4"]]) -> Float[np.ndarray, "3"]:
    """Shares of the known steps of all windows that break position limits, speed limits and the scene."""
    total = np.sum(counts, axis=0, initial=0) if len(counts) else np.zeros(4, dtype=int)
    return total[:3] / max(int(total[3]), 1)


def _summary(
    scores: Scores,
    owner: Int[np.ndarray, " W"],
    names: Sequence[str],
    moving: Bool[np.ndarray, " W"],
    options: EvaluationOptions,
    pace: float,
) -> dict[str, Any]:
    error, nll, volume = np.array(scores.error), np.array(scores.nll), np.array(scores.volume)
    crps_, inside, stretch = np.array(scores.crps), np.array(scores.inside), np.array(scores.stretch)
    per_window = averages(error)
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
        "nll_stderr": _number(block_bootstrap(averages(nll), owner, block=block, seed=options.seed).stderr),
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


def _number(value: float) -> float | None:
    """The value; None where it is not a number, which JSON cannot say."""
    return float(value) if np.isfinite(value) else None


def _mean(values: Float[np.ndarray, "..."]) -> float | None:
    """Mean of what was scored; None where nothing was."""
    finite = values[~np.isnan(values)]
    return float(finite.mean()) if finite.size else None
