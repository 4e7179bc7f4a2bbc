"""What an evaluation leaves: metrics.json, pictures, a table for the terminal, and one HTML page with all of it.

Everything that comes from outside (names of methods and recordings, settings) is escaped by the page's template,
data/report.html. A value that is null or not finite is a dash.
"""

from __future__ import annotations

import base64
import io
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import reduce
from importlib import resources
from operator import getitem
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from rich import box
from rich.console import Console
from rich.table import Table as TerminalTable
from rich.text import Text

from kinecast.errors import MissingExtraError
from kinecast.evaluation.metrics import LEVELS, WRISTS
from kinecast.evaluation.pictures import Moment, animate_predictions, draw_prediction
from kinecast.evaluation.plots import (
    UNKNOWN,
    figure_svg,
    known,
    method_style,
    number,
    percent,
    plot_coverage,
    plot_nll_histograms,
    plot_over_horizon,
    plot_violations,
)
from kinecast.evaluation.scoring import LIMITS, REPEATED, EvaluationOptions, TestRecording, evaluate
from kinecast.geometry.scene import Scene
from kinecast.output import all_or_none, write_atomically
from kinecast.prediction.method import Method, forecast_in_scene
from kinecast.tasks import Progress, Workers

try:
    from jinja2 import Environment, StrictUndefined
except ImportError as error:
    raise MissingExtraError("the report", "train") from error

Metrics = Mapping[str, Any]

FILM = 0.75
"""The film begins so long before the moment drawn, and ends so long after it [s]."""


def run_evaluation(
    out: Path,
    methods: Mapping[str, Method[Any]],
    recordings: Sequence[TestRecording],
    scene: Scene | None,
    options: EvaluationOptions,
    settings: Mapping[str, Any],
    progress: Progress | None = None,
    workers: Workers | None = None,
) -> dict[str, Any]:
    """Scores methods and writes everything: all files or, after an error, none.

    Args:
        out: folder for metrics.json, report.html, prediction.png and prediction.gif, which shows the last method.
        settings: what to say about the run, JSON values.
        methods, recordings, scene, options, progress, workers: as for `evaluate`.

    Returns:
        What metrics.json holds.
    """
    results, histograms = evaluate(methods, recordings, scene, options, progress, workers)
    drawn = {"samples": options.samples, "repeats": options.repeats, "repeat_windows": REPEATED, "seed": options.seed}
    metrics: dict[str, Any] = {"settings": {**settings, **drawn}, **results}
    name, method = list(methods.items())[-1]
    recording, frame = _busiest(recordings)
    moments = _moments(recording, frame, method, scene, options)
    title = f"{name}, {recording.name}"
    with all_or_none(out) as folder:
        picture, film = folder / "prediction.png", folder / "prediction.gif"
        write_atomically(folder / "metrics.json", json.dumps(metrics, indent=1).encode())
        draw_prediction(picture, moments[frame], scene, f"{title} at {moments[frame].stamp:.1f} s")
        animate_predictions(film, list(moments.values()), scene, title)
        write_report(metrics, histograms, folder, [picture, film])
    return metrics


def _busiest(recordings: Sequence[TestRecording]) -> tuple[TestRecording, int]:
    """The longest recording, and a frame of it where the wrists move more than in 19 of 20 and the future is known."""
    recording = max(recordings, key=lambda each: len(each.observations))
    wrists = np.array([observation.positions[:, WRISTS] for observation in recording.observations])
    path = np.linalg.norm(np.diff(wrists, axis=1), axis=-1).sum(axis=(1, 2))
    path[~np.isfinite(recording.future).all(axis=(1, 2, 3))] = -1.0
    return recording, int(recording.frames[np.argsort(path)[int(0.95 * (len(path) - 1))]])


def _moments(
    recording: TestRecording, at: int, method: Method[Any], scene: Scene | None, options: EvaluationOptions
) -> dict[int, Moment]:
    """What a method predicted around one frame of a recording, by frame, and what happened."""
    measured_at = {frame: measured for frame, _, measured in recording.history}
    for frame, future in zip(recording.frames.tolist(), recording.future, strict=True):
        measured_at |= {frame + k: pose for k, pose in enumerate(future, 1)}
    unknown = np.full((6, 3), np.nan)
    state, moments = method.init_state(), {}
    for frame, seen, measured in recording.history:
        state = method.update(state, seen, measured)
        if frame > at + FILM / seen.dt:
            break
        if frame < at - FILM / seen.dt:
            continue
        rng = np.random.default_rng(options.seed)  # the same draws in each, so that the samples move smoothly
        forecast = forecast_in_scene(method, state, seen, rng, options.samples, scene)
        truth = np.stack([measured_at.get(frame + k, unknown) for k in range(1, method.steps + 1)])
        moments[frame] = Moment(seen.positions, forecast.samples, forecast.mean, truth, seen.dt, seen.stamp)
    return moments


# The page


def write_report(
    metrics: Metrics, histograms: Mapping[str, Float[np.ndarray, "..."]], folder: Path, pictures: Sequence[Path] = ()
) -> Path:
    """Write `report.html`, a page that shows everything and needs no other file.

    Args:
        metrics: as in metrics.json; any number may be None.
        histograms: NLL per repeat or window, by method.
        folder: for the page; made where missing.
        pictures: PNG and GIF files to show, inlined; their names are the captions and their endings say which.

    Returns:
        The page's path.

    Raises:
        OSError: a picture cannot be read or the page not written; then there is no page.
    """
    methods, first = metrics["methods"], next(iter(metrics["methods"].values()))
    errors = {
        recording: [each["recordings"][recording]["mpjpe_mm"] for each in methods.values()]
        for recording in first["recordings"]
    }
    environment = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    environment.filters |= {"number": number, "percent": percent, "setting": _setting}
    environment.globals |= {"style_of": method_style, "scores": SCORES, "levels": LEVELS, "limits": LIMITS}
    data = resources.files("kinecast") / "data"
    page = environment.from_string((data / "report.html").read_text("utf-8")).render(
        style=(data / "report.css").read_text("utf-8"),
        metrics=metrics,
        methods=methods,
        recordings=first["recordings"],
        best={score: _best(score, methods) for score in SCORES},
        least={recording: min(filter(known, each), default=None) for recording, each in errors.items()},
        pictures=[_inlined(path) for path in pictures],
        charts=_charts(metrics, histograms),
    )
    path = folder / "report.html"
    write_atomically(path, page.encode())
    return path


def _inlined(path: Path) -> tuple[str, str]:
    """A picture's caption and content."""
    content = base64.b64encode(path.read_bytes()).decode("ascii")
    return path.stem.replace("_", " "), f"data:image/{path.suffix.removeprefix('.')};base64,{content}"


def _charts(metrics: Metrics, histograms: Mapping[str, Float[np.ndarray, "..."]]) -> dict[str, str]:
    """Charts as SVG elements."""
    methods, horizon = metrics["methods"], metrics["settings"]["horizon"]

    def of(key: str) -> dict[str, Any]:
        return {name: each[key] for name, each in methods.items()}

    by_step = {
        name: [100 * share if known(share) else None for share in shares["0.9"]]
        for name, shares in of("coverage_by_step").items()
    }
    figures = {
        "errors": (
            plot_over_horizon(of("mpjpe_mm_by_step"), horizon, "Mean joint error over the horizon [mm]"),
            "Mean joint error against time ahead, by method",
        ),
        "nll": (
            plot_nll_histograms(histograms, of("nll_stderr")),
            "Mean negative log likelihood and its histogram, by method",
        ),
        "coverage": (plot_coverage(of("coverage")), "Observed against nominal coverage, by method"),
        "coverage_by_step": (
            plot_over_horizon(by_step, horizon, "Inside the 90 % region over the horizon [%]", should_be=90.0),
            "Coverage at 90 % against time ahead, by method",
        ),
        "violations": (
            plot_violations(of("violations"), metrics["ground_truth_violations"]),
            "Share of steps outside limits, by method and as measured",
        ),
    }
    return {name: figure_svg(figure, title) for name, (figure, title) in figures.items()}


@dataclass(frozen=True)
class Score:
    """A column of the main table.

    Attributes:
        title, unit: of its head.
        path: keys that lead to the value in a method's metrics.
        digits: after the point.
        times: factor, e.g. 100 for per cent.
        stderr: key of its standard error.
        ideal: the value nearest to this is best: −inf for less is better; None for no best.
        terminal: whether the terminal shows it too.
    """

    title: str
    unit: str
    path: tuple[str, ...]
    digits: int
    times: float = 1.0
    stderr: str = ""
    ideal: float | None = -math.inf
    terminal: bool = True

    def of(self, method: Metrics) -> float | None:
        """A method's value as it is shown."""
        value = reduce(getitem, self.path, method)
        return round(self.times * value, self.digits) if known(value) else None

    def text(self, method: Metrics) -> tuple[str, str]:
        """The value, and its standard error with a sign before it, if there is one."""
        value, error = self.of(method), method.get(self.stderr)
        return number(value, self.digits), f"± {number(error, self.digits)}" if known(error) and known(value) else ""


SCORES = (
    Score("MPJPE", "mm", ("mpjpe_mm",), 1, stderr="mpjpe_mm_stderr"),
    Score("moving", "mm", ("moving_mpjpe_mm",), 1),
    Score("final wrist", "mm", ("wrist_final_mm",), 1),
    Score("NLL", "nats", ("nll",), 2, stderr="nll_stderr"),
    Score("KDE-NLL", "nats", ("kde_nll",), 2),
    Score("CRPS", "mm", ("crps_mm",), 1),
    Score("energy", "mm", ("energy_score_mm",), 1),
    Score("coverage", "at 90 %", ("coverage", "0.9"), 1, times=100.0, ideal=90.0),
    Score("region", "litres", ("calibrated_region_litres", "0.9", "typical"), 2, terminal=False),
    Score("accepted", "%", ("accepted_fraction",), 1, times=100.0, ideal=None),
    Score("effective", "samples", ("effective_sample_size",), 0, ideal=None, terminal=False),
    Score("latency", "ms, p50", ("latency_ms", "p50"), 1, ideal=None, terminal=False),
    Score("latency", "ms, p99", ("latency_ms", "p99"), 1, ideal=None),
)


def format_table(metrics: Metrics) -> str:
    """The main table as plain text for a terminal, 100 columns or so wide."""
    table = TerminalTable(box=box.SIMPLE_HEAD, pad_edge=False)
    table.add_column("method")
    columns = [score for score in SCORES if score.terminal]
    for score in columns:
        table.add_column(Text(f"{score.title}\n{score.unit}"), justify="right", no_wrap=True)
    for name, each in metrics["methods"].items():
        table.add_row(Text(name), *[Text(" ".join(score.text(each)).rstrip()) for score in columns])
    stream = io.StringIO()
    Console(file=stream, width=200, color_system=None, legacy_windows=False).print(table)
    return "\n".join(line.rstrip() for line in stream.getvalue().rstrip().splitlines())


def _setting(value: object) -> str:
    """A line for each item of a list or mapping."""
    if isinstance(value, Mapping):
        return "\n".join(f"{key}: {_setting(item)}" for key, item in value.items())
    if isinstance(value, Sequence) and not isinstance(value, str):
        return "\n".join(map(_setting, value))
    return UNKNOWN if value is None else str(value)


def _best(score: Score, methods: Metrics) -> list[str]:
    """The methods that share the best value as it is shown; none if all do."""
    if score.ideal is None:
        return []
    values = {name: value for name, each in methods.items() if (value := score.of(each)) is not None}
    away = {name: value if score.ideal == -math.inf else abs(value - score.ideal) for name, value in values.items()}
    if len(set(away.values())) < 2:
        return []
    return [name for name, value in away.items() if value == min(away.values())]
