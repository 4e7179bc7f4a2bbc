"""`kinecast evaluate`: methods scored on recordings they never saw; and `kinecast demo`, on those that come with it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from importlib import resources
from pathlib import Path
from typing import Annotated, Any

from tyro.conf import arg

from kinecast import __version__
from kinecast.cli.method_set import MethodSet, method_names, read_models, train_methods, windows_told
from kinecast.cli.options import (
    Action,
    ClusterPlace,
    Folder,
    FormatName,
    Many,
    MethodNames,
    OptionalFile,
    Switch,
    check_folder,
    check_seed,
    worker_pool,
)
from kinecast.cli.progress import compiling, progress_bar
from kinecast.cli.recordings import read_recordings, unseen
from kinecast.datasets.recording import Recording
from kinecast.datasets.windows import WindowOptions
from kinecast.errors import OptionError
from kinecast.evaluation.scoring import EvaluationOptions, TestRecording, warm_up
from kinecast.geometry.scene import Scene
from kinecast.prediction.methods import SHIPPED
from kinecast.tasks import Serial, Workers

DEFAULT_METHODS = (
    "zero_velocity,constant_velocity,damped_velocity,kalman,ridge,gp_xyz,gp_angles,gp_constrained,kinecast"
)

_HINT = "(default: {:g}, or the model's)"
Rate = Annotated[float | None, arg(metavar="HZ", help_behavior_hint=_HINT.format(WindowOptions.rate))]
Window = Annotated[float | None, arg(metavar="SECONDS", help_behavior_hint=_HINT.format(WindowOptions.window))]
Horizon = Annotated[float | None, arg(metavar="SECONDS", help_behavior_hint=_HINT.format(WindowOptions.horizon))]


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
    scene: OptionalFile = None,
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
        cluster: spread the work over a Dask cluster that you trust: a scheduler's address, or N processes of this
            machine. Scores are the same to the last bit; latencies are those of the workers.
    """
    import kinecast.evaluation.report  # noqa: F401 - drawing is an extra, whose lack is said before the work

    _check_draws(samples, repeats)
    check_seed(seed)
    check_folder(out)
    names = _methods_asked(train, model, methods, ablate)
    obstacles = None if scene is None else Scene.load(scene)
    told = {"rate": rate, "window": window, "horizon": horizon}
    saved = read_models(model, told) if model else None
    options = replace(saved.windows if saved else windows_told(told), stride=stride, label=label)
    with worker_pool(cluster) as workers:
        tested = read_recordings(test, format, "--test")
        recordings, facts = _cut(tested, options, scene, workers)
        seen = [] if saved else unseen(read_recordings(train, format, "--train"), tested)
        compared = saved or train_methods(names, seen, options, obstacles, seed, workers)
        compared.warn_of_known(tested)
        facts = {"version": __version__, "train": compared.trained_on, "models": compared.files} | facts
        compared = compared.with_ablations() if ablate else compared
        scores = EvaluationOptions(samples=samples, repeats=repeats, seed=seed, limits=compared.limits)
        _score(out, compared, recordings, obstacles, scores, facts, workers)


def demo(out: Folder = Path("kinecast-demo")) -> None:
    """Predicts the arms of real people at work, scores and draws that, and says where it all is.

    Args:
        out: folder for the report and the pictures.
    """
    with resources.as_file(resources.files("kinecast") / "data") as data:
        models = tuple(data / "models" / f"{name}.npz" for name in SHIPPED)
        evaluate((data / "clips",), out, model=models, samples=200, repeats=2)
    print(f"pictures: {out / 'prediction.png'}, {out / 'prediction.gif'}")


def _check_draws(samples: int, repeats: int) -> None:
    if not 1 <= samples <= 100_000 or not 0 <= repeats <= 1000:
        raise OptionError(f"samples {samples}, repeats {repeats}; allowed are 1..100000 and 0..1000")


def _methods_asked(train: Sequence[Path], model: Sequence[Path], methods: str, ablate: bool) -> list[str]:
    """Names of methods to train, where there are no models."""
    if bool(train) == bool(model):
        raise OptionError("give either --train with recordings or --model with saved models")
    if model and methods != DEFAULT_METHODS:
        raise OptionError("--methods goes with --train; a --model brings its own")
    names = method_names(methods)
    if ablate and not model and "kinecast" not in names:
        raise OptionError("--ablate takes kinecast apart: name it among --methods")
    return names


def _cut(
    tested: Sequence[Recording], options: WindowOptions, scene: Path | None, workers: Workers
) -> tuple[list[TestRecording], dict[str, Any]]:
    """Windows to be scored, and what is said of them."""
    parts = TestRecording.of(tested, options, workers)
    facts = {
        **{name: getattr(options, name) for name in ("rate", "window", "horizon", "stride", "label")},
        "scene": None if scene is None else scene.name,
        "test": [part.name for part in parts],
        "windows": sum(len(part.observations) for part in parts),
        "windows_left_out": sum(part.left_out for part in parts),
    }
    return parts, facts


def _score(
    out: Path,
    compared: MethodSet,
    recordings: Sequence[TestRecording],
    scene: Scene | None,
    options: EvaluationOptions,
    facts: Mapping[str, Any],
    workers: Workers,
) -> None:
    from kinecast.evaluation.report import format_table, run_evaluation

    methods = compared.methods
    if isinstance(workers, Serial):  # those of a cluster compile for themselves
        with compiling():
            warm_up(methods, recordings, scene, options)
    with progress_bar("scoring") as progress:
        metrics = run_evaluation(out, methods, recordings, scene, options, facts, progress, workers)
    print(format_table(metrics))
    print(f"report: {out / 'report.html'}")
