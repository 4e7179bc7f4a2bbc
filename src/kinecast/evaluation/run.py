"""One evaluation from windows to files: scores, metrics.json, report.html, pictures."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from kinecast.datasets.windows import Windows
from kinecast.evaluation.animations import animate_prediction
from kinecast.evaluation.output import all_or_none, write_atomically
from kinecast.evaluation.pictures import Moment, draw_prediction
from kinecast.evaluation.protocol import EvaluationOptions, TestRecording, evaluate
from kinecast.evaluation.report import write_report
from kinecast.geometry.scene import Scene
from kinecast.pipeline import followed, observations
from kinecast.prediction.forecast import Method
from kinecast.tasks.workers import Progress, Workers

__all__ = ["run_evaluation"]


def run_evaluation(
    out: Path,
    methods: Mapping[str, Method],
    parts: Sequence[Windows],
    histories: Sequence[Windows],
    scene: Scene | None,
    options: EvaluationOptions,
    settings: Mapping[str, Any],
    progress: Progress | None = None,
    workers: Workers | None = None,
) -> dict[str, Any]:
    """Scores methods and writes everything: all files or, after an error, none.

    Args:
        out: folder for metrics.json, report.html, prediction.png and prediction.gif.
        methods: by name; the last one is drawn.
        parts: test windows, one entry per recording.
        histories: the windows that end with each of its frames (`WindowOptions.every_frame`), for methods that follow
            the person; by name.
        scene: obstacles; None for none.
        options: see EvaluationOptions.
        settings: what to say about the run, JSON values.
        progress: called with (done, total) tasks.
        workers: that do them; None for this process.

    Returns:
        What metrics.json holds.
    """
    every = {history.name: history for history in histories}
    recordings = [
        TestRecording(part.name, observations(part), part.future, part.frames, followed(every[part.name]))
        for part in parts
    ]
    results, histograms = evaluate(methods, recordings, scene, options, progress, workers)
    metrics: dict[str, Any] = {
        "settings": {
            **settings,
            "test": [part.name for part in parts],
            "windows": sum(len(part) for part in parts),
            "windows_left_out": sum(part.lost + part.not_whole for part in parts),
            "samples": options.samples,
            "repeats": options.repeats,
            "repeat_windows": options.repeat_windows,
            "seed": options.seed,
        },
        **results,
    }
    name, method = list(methods.items())[-1]
    moment, title = _busiest(parts, method, scene, options)
    title = f"{name}, {title}"
    with all_or_none(out) as folder:
        picture, film = folder / "prediction.png", folder / "prediction.gif"
        write_atomically(folder / "metrics.json", json.dumps(metrics, indent=1).encode())
        draw_prediction(picture, moment, scene, title)
        animate_prediction(film, moment, scene, title)
        write_report(metrics, histograms, folder, [picture, film])
    return metrics


def _busiest(
    parts: Sequence[Windows], method: Method, scene: Scene | None, options: EvaluationOptions
) -> tuple[Moment, str]:
    """A moment where the wrists move much (more than in 19 of 20 windows) and the whole future is known."""
    part = max(parts, key=len)
    path = np.linalg.norm(np.diff(part.arms[:, :, [2, 5]], axis=1), axis=-1).sum(axis=(1, 2))
    path[~np.isfinite(part.future).all(axis=(1, 2, 3))] = -1.0
    row = int(np.argsort(path)[int(0.95 * (len(path) - 1))])
    observation = observations(part)[row]
    forecast = method.forecast(observation, np.random.default_rng(options.seed), options.samples, scene)
    moment = Moment(
        observed=observation.positions,
        samples=forecast.samples,
        mean=forecast.mean,
        dt=observation.dt,
        truth=part.future[row],
        stamp=observation.stamp,
    )
    return moment, f"{part.name} at {observation.stamp:.1f} s"
