"""`kinecast evaluate`: methods scored on recordings they never saw; metrics, report, table."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated

from tyro.conf import arg

from kinecast import __version__
from kinecast.cli.contestants import method_names, read_models, train_methods, warn_of_known, with_ablations
from kinecast.cli.crew import crew
from kinecast.cli.destination import check_folder
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
)
from kinecast.cli.progress import progress_bar
from kinecast.cli.recordings import read_recordings, unseen
from kinecast.datasets.windows import WindowOptions, all_windows
from kinecast.errors import OptionError
from kinecast.evaluation.protocol import EvaluationOptions
from kinecast.evaluation.tables import format_table
from kinecast.geometry.scene import Scene
from kinecast.pipeline import every_frame

__all__ = ["evaluate"]

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
    from kinecast.evaluation.run import run_evaluation  # here, since drawing is an extra other commands do without

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
    contestants = read_models(model, rate, window, horizon) if model else None
    options = WindowOptions(
        rate=RATE if rate is None else rate,
        window=WINDOW if window is None else window,
        horizon=HORIZON if horizon is None else horizon,
    )
    options = replace(contestants.windows if contestants else options, stride=stride, label=label)
    with crew(cluster) as workers:
        tested = read_recordings(test, format, "--test")
        parts = all_windows(tested, options, workers=workers)
        histories = all_windows(tested, every_frame(options), workers=workers)
        if contestants is None:
            recordings = unseen(read_recordings(train, format, "--train"), tested)
            contestants = train_methods(names, recordings, options, obstacles, seed, workers)
        else:
            warn_of_known(contestants, tested)
        scored = tuple(contestants.methods)
        if ablate:
            contestants = replace(contestants, methods=with_ablations(contestants.methods))
        settings = {
            "version": __version__,
            "train": list(contestants.trained_on),
            "models": {name: str(path) for name, path in zip(scored, model, strict=False)},
            "rate": options.rate,
            "window": options.window,
            "horizon": options.horizon,
            "stride": stride,
            "label": label,
            "scene": None if scene is None else scene.name,
        }
        scores = EvaluationOptions(samples=samples, repeats=repeats, seed=seed, limits=contestants.limits)
        with progress_bar("scoring") as progress:
            metrics = run_evaluation(
                out, contestants.methods, parts, histories, obstacles, scores, settings, progress, workers
            )
    print(format_table(metrics))
    print(f"report: {out / 'report.html'}")
