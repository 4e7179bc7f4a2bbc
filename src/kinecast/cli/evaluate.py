"""`kinecast evaluate`: methods scored on recordings they never saw; metrics, report, table."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

from tyro.conf import arg

from kinecast import __version__
from kinecast.cli.method_set import method_names, read_models, train_methods
from kinecast.cli.options import (
    Action,
    ClusterPlace,
    Folder,
    FormatName,
    Many,
    MethodNames,
    SceneFile,
    Switch,
    check_seed,
    worker_pool,
)
from kinecast.cli.output_paths import check_folder
from kinecast.cli.progress import compiling, progress_bar
from kinecast.cli.recordings import read_recordings, unseen
from kinecast.datasets.windows import WindowOptions, Windows, all_windows
from kinecast.errors import OptionError
from kinecast.evaluation.scoring import EvaluationOptions, TestRecording, warm_up
from kinecast.geometry.scene import Scene
from kinecast.pipeline import every_frame
from kinecast.prediction.method import Method
from kinecast.tasks import Serial, Workers

DEFAULT_METHODS = (
    "zero_velocity,constant_velocity,damped_velocity,kalman,ridge,gp_xyz,gp_angles,gp_constrained,kinecast"
)

RATE, WINDOW, HORIZON = 30.0, 0.2, 0.5
"""Frames per second [Hz], and what is observed and predicted [s], where no model says otherwise."""

Rate = Annotated[float | None, arg(metavar="HZ", help_behavior_hint=f"(default: {RATE:g}, or the model's)")]
Window = Annotated[float | None, arg(metavar="SECONDS", help_behavior_hint=f"(default: {WINDOW}, or the model's)")]
Horizon = Annotated[float | None, arg(metavar="SECONDS", help_behavior_hint=f"(default: {HORIZON}, or the model's)")]


def evaluate(
    test: Annotated[Many, arg(help_behavior_hint="(required)")],
    out: Folder,
    train: Many = (),
    model: Annotated[Many, arg(metavar="FILE [FILE ...]")] = (),
    methods: MethodNames = DEFAULT_METHODS,
    rate: Rate = None,
    window: Window = None,
    horizon: Horizon = None,
    stride: int = 5,
    label: Action = None,
    scene: SceneFile = None,
    ablate: Switch = False,
    samples: int = 1000,
    repeats: int = 25,
    seed: int = 0,
    format: FormatName = None,
    cluster: ClusterPlace = None,
) -> None:
    """Scores methods on test recordings: writes metrics.json, report.html and pictures, prints the table.

    Args:
        test: recordings, or folders of them, to be scored on.
        out: folder for the results; made where missing.
        train: recordings, or folders of them, to train on; those that are test recordings too are left out.
        model: saved models to score, instead of training; MODULE:FUNCTION gives your own method (docs/predictor.md).
        methods: names of methods to train, with commas; MODULE:FUNCTION makes your own of training windows.
        rate: frames per second.
        window: how much is observed.
        horizon: how much is predicted.
        stride: frames from one test window to the next.
        label: train and test only where the recordings' label is this action.
        scene: obstacles, a YAML file, in the frame of the recordings.
        ablate: also score `kinecast` with each of its stages switched off in turn.
        samples: motions drawn per prediction.
        repeats: how often the NLL is taken again with fresh draws, for its histogram.
        seed: of everything random.
        format: read recordings as this format instead of finding it by content.
        cluster: spread the work over a Dask cluster that you trust: a scheduler's address, or N processes of this
            machine. Scores are the same to the last bit; latencies are those of the workers.
    """
    import kinecast.evaluation.report  # noqa: F401 - what is not installed is missed before the work, not after it

    if bool(train) == bool(model):
        raise OptionError("give either --train with recordings or --model with saved models")
    if model and methods != DEFAULT_METHODS:
        raise OptionError("--methods goes with --train; a --model brings its own")
    if not 1 <= samples <= 100_000 or not 0 <= repeats <= 1000:
        raise OptionError(f"samples {samples}, repeats {repeats}; allowed are 1..100000 and 0..1000")
    check_seed(seed)
    check_folder(out)
    names = method_names(methods)
    if ablate and not model and "kinecast" not in names:
        raise OptionError("--ablate takes kinecast apart: name it among --methods")
    obstacles = None if scene is None else Scene.load(scene)
    compared = read_models(model, rate, window, horizon) if model else None
    options = WindowOptions(
        rate=RATE if rate is None else rate,
        window=WINDOW if window is None else window,
        horizon=HORIZON if horizon is None else horizon,
    )
    options = replace(compared.windows if compared else options, stride=stride, label=label)
    with worker_pool(cluster) as workers:
        tested = read_recordings(test, format, "--test")
        parts = all_windows(tested, options, workers=workers)
        histories = all_windows(tested, every_frame(options), workers=workers)
        if compared is None:
            recordings = unseen(read_recordings(train, format, "--train"), tested)
            compared = train_methods(names, recordings, options, obstacles, seed, workers)
        else:
            compared.warn_of_known(tested)
        settings = {
            "train": list(compared.trained_on),
            "models": {name: str(path) for name, path in zip(compared.methods, model, strict=False)},
            "scene": None if scene is None else scene.name,
        }
        if ablate:
            compared = compared.with_ablations()
        scores = EvaluationOptions(samples=samples, repeats=repeats, seed=seed, limits=compared.limits)
        score(out, compared.methods, parts, histories, options, obstacles, scores, settings, workers)


def score(
    out: Path,
    methods: Mapping[str, Method[Any]],
    parts: Sequence[Windows],
    histories: Sequence[Windows],
    windows: WindowOptions,
    scene: Scene | None,
    options: EvaluationOptions,
    settings: Mapping[str, Any],
    workers: Workers | None = None,
) -> None:
    """Scores methods, writes everything to a folder, and prints the table.

    Args:
        parts, histories: of each test recording its windows, and those that end with each of its frames.
        windows: as which they were cut.
        settings: what else to say about the run: `train`, `models` and `scene`.
        out, methods, scene, options, workers: as for `run_evaluation`.
    """
    from kinecast.evaluation.report import format_table, run_evaluation  # here, since drawing is an extra

    recordings = TestRecording.of(parts, histories)
    said = {
        "version": __version__,
        "train": settings["train"],
        "models": settings.get("models", {}),
        "rate": windows.rate,
        "window": windows.window,
        "horizon": windows.horizon,
        "stride": windows.stride,
        "label": windows.label,
        "scene": settings["scene"],
        "test": [part.name for part in parts],
        "windows": sum(len(part) for part in parts),
        "windows_left_out": sum(part.lost + part.not_whole for part in parts),
    }
    if workers is None or isinstance(workers, Serial):  # those of a cluster compile for themselves
        with compiling():
            warm_up(methods, recordings, scene, options)
    with progress_bar("scoring") as progress:
        metrics = run_evaluation(out, methods, recordings, scene, options, said, progress, workers)
    print(format_table(metrics))
    print(f"report: {out / 'report.html'}")
