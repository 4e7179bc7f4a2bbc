"""`kinecast evaluate`: methods scored on recordings they never saw; and `kinecast demo`, on those that come with it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import reduce
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, NamedTuple

from tyro.conf import arg

from kinecast import __version__
from kinecast.body.limits import JointLimits
from kinecast.cli.options import (
    Action,
    ClusterPlace,
    Many,
    MethodNames,
    OptionalFile,
    Switch,
    check_folder,
    check_seed,
    worker_pool,
)
from kinecast.cli.progress import compiling, note, progress_bar
from kinecast.cli.recordings import FormatName, listed, read_recordings, unseen
from kinecast.datasets.recording import Recording
from kinecast.datasets.windows import WindowOptions
from kinecast.errors import ModelError, OptionError
from kinecast.evaluation.scoring import EvaluationOptions, TestRecording, warm_up
from kinecast.geometry.scene import Scene
from kinecast.pipeline import training_windows
from kinecast.prediction.kinecast.model import Kinecast, ablations
from kinecast.prediction.method import Method, shortened
from kinecast.prediction.methods import SHIPPED, check_names, read_method
from kinecast.prediction.methods import train as train_all
from kinecast.prediction.plugins import is_plugin, train_plugin
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
    out: Path,
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

    check_seed(seed)
    check_folder(out)
    scores = EvaluationOptions(samples, repeats, seed=seed)
    names = _methods_asked(train, model, methods, ablate, scores)
    obstacles = None if scene is None else Scene.load(scene)
    given = {"rate": rate, "window": window, "horizon": horizon}
    told: dict[str, Any] = {name: value for name, value in given.items() if value is not None}
    saved = read_models(model, told) if model else None
    options = replace(saved.windows if saved else WindowOptions(**told), stride=stride, label=label)
    with worker_pool(cluster) as workers:
        tested = read_recordings(test, format, "--test")
        recordings = TestRecording.of(tested, options, workers)
        seen = [] if saved else unseen(read_recordings(train, format, "--train"), tested)
        compared = saved or train_methods(names, seen, options, obstacles, seed, workers)
        if saved and (known := {each.name for each in tested} & {*saved.recordings}):
            flattered = listed([name for name, own in saved.trained_on.items() if known & {*own}])
            note(f"{flattered}: trained on recordings of these names, scores may flatter: {listed(sorted(known))}")
        parts = with_ablations(compared.methods) if ablate else compared.methods
        facts = {"scene": None if scene is None else scene.name, "train": compared.recordings, "models": compared.files}
        _score(out, parts, recordings, obstacles, replace(scores, limits=compared.limits), options, facts, workers)


def demo(out: Path = Path("kinecast-demo")) -> None:
    """Predicts the arms of real people at work, scores and draws that, and says where it all is.

    Args:
        out: folder for the report and the pictures.
    """
    with resources.as_file(resources.files("kinecast") / "data") as data:
        models = tuple(data / "models" / f"{name}.npz" for name in SHIPPED)
        evaluate((data / "clips",), out, model=models, horizon=0.5, samples=200, repeats=2)
    print(f"pictures: {out / 'prediction.png'}, {out / 'prediction.gif'}")


def _methods_asked(
    train: Sequence[Path], model: Sequence[Path], methods: str, ablate: bool, scores: EvaluationOptions
) -> list[str]:
    """Names of methods to train, where there are no models; an OptionError for what cannot be asked."""
    if not 1 <= scores.samples <= 100_000 or not 0 <= scores.repeats <= 1000:
        allowed = "allowed are 1..100000 and 0..1000"
        raise OptionError(f"samples {scores.samples}, repeats {scores.repeats}; {allowed}")
    if bool(train) == bool(model):
        raise OptionError("give either --train with recordings or --model with saved models")
    if model and methods != DEFAULT_METHODS:
        raise OptionError("--methods goes with --train; a --model brings its own")
    names = method_names(methods)
    if ablate and not model and "kinecast" not in names:
        raise OptionError("--ablate takes kinecast apart: name it among --methods")
    return names


def method_names(text: str) -> list[str]:
    """Names with commas between them, each once; OptionError if one is no method. MODULE:FUNCTION is one too."""
    names = list(dict.fromkeys(name.strip() for name in text.split(",") if name.strip()))
    own = [name for name in names if not is_plugin(name)]
    if own or not names:
        check_names(own)
    return names


class Compared(NamedTuple):
    """Methods for the same windows."""

    methods: Mapping[str, Method[Any]]  # by the name they are reported under
    limits: JointLimits  # against which all their samples are counted
    trained_on: Mapping[str, Sequence[str]]  # names of the recordings, by name
    windows: WindowOptions  # what they are made for
    files: Mapping[str, str]  # that they were read from, by name

    @property
    def recordings(self) -> list[str]:
        """Names of all that any was trained on."""
        return sorted({name for own in self.trained_on.values() for name in own})


def train_methods(
    names: Sequence[str],
    recordings: Sequence[Recording],
    options: WindowOptions,
    scene: Scene | None,
    seed: int,
    workers: Workers,
) -> Compared:
    """Methods trained on every window of recordings, as `kinecast train` does; those from elsewhere in this process.

    A DatasetError, ModelError or OptionError for too few windows, or where what a function gives is no method.
    """
    with progress_bar("cutting windows") as progress:
        data = training_windows(recordings, options, scene, progress, workers)
    found = {name: train_plugin(name, data) for name in names if is_plugin(name)}
    with progress_bar("training") as progress:
        found |= train_all([name for name in names if name not in found], data, seed, progress, workers)
    methods = {name: found[name] for name in names}
    trained_on = dict.fromkeys(names, tuple(recording.name for recording in recordings))
    return Compared(methods, data.limits, trained_on, options, {})


def read_models(paths: Sequence[Path], told: Mapping[str, Any]) -> Compared:
    """Saved models, at least one, of one rate and window; what is told (`rate`, `window`, `horizon`) must be theirs.

    They predict as far as told, or as the least of them does. A ModelError where a file is no model, or made for other
    windows; an OptionError for windows that there are not.
    """
    cards, methods = zip(*map(read_method, paths), strict=True)
    first = cards[0]
    own = {
        "rate": first.rate,
        "window": first.frames / first.rate,
        "horizon": min(card.steps / card.rate for card in cards),
    }
    options = WindowOptions(**{**own, **told})
    wanted = (options.observed_steps, options.predicted_steps, options.rate)
    frames = "{} frames seen and {} predicted at {:g} Hz"
    for path, card in zip(paths, cards, strict=True):
        made = (card.frames, card.steps, card.rate)
        if made[::2] != wanted[::2] or made[1] < wanted[1]:
            raise ModelError(f"{path}: made for {frames.format(*made)}, not {frames.format(*wanted)}")
    methods = tuple(shortened(method, options.horizon) for method in methods)
    named = [card.method for card in cards]
    names = [f"{name} #{named[: k + 1].count(name)}" if named.count(name) > 1 else name for k, name in enumerate(named)]
    # The least that every constrained model keeps, else those found in training.
    held = [card.limits for card in cards if card.method == "kinecast" or card.method.endswith("_constrained")]
    return Compared(
        dict(zip(names, methods, strict=True)),
        reduce(JointLimits.union, held or [first.limits]),
        {name: card.trained_on for name, card in zip(names, cards, strict=True)},
        options,
        dict(zip(names, map(str, paths), strict=True)),
    )


def with_ablations(methods: Mapping[str, Method[Any]]) -> dict[str, Method[Any]]:
    """With, before `kinecast`, what is left of it with each stage switched off; OptionError if it is not there."""
    whole = methods.get("kinecast")
    if not isinstance(whole, Kinecast):
        raise OptionError(f"--ablate takes kinecast apart; the methods are {', '.join(methods)}")
    others = {name: method for name, method in methods.items() if method is not whole}
    return others | {f"kinecast, {name}": part for name, part in ablations(whole).items()} | {"kinecast": whole}


def _score(
    out: Path,
    methods: Mapping[str, Method[Any]],
    recordings: Sequence[TestRecording],
    scene: Scene | None,
    options: EvaluationOptions,
    windows: WindowOptions,
    facts: Mapping[str, Any],
    workers: Workers,
) -> None:
    from kinecast.evaluation.report import format_table, run_evaluation

    settings = {
        "version": __version__,
        **{name: getattr(windows, name) for name in ("rate", "window", "horizon", "stride", "label")},
        "test": [each.name for each in recordings],
        "windows": sum(len(each.observations) for each in recordings),
        "windows_left_out": sum(each.left_out for each in recordings),
        **facts,
    }
    if isinstance(workers, Serial):  # those of a cluster compile for themselves
        with compiling():
            warm_up(methods, recordings, scene, options)
    with progress_bar("scoring") as progress:
        metrics = run_evaluation(out, methods, recordings, scene, options, settings, progress, workers)
    print(format_table(metrics))
    print(f"report: {out / 'report.html'}")
