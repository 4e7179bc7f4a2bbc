"""`kinecast evaluate`: methods scored on recordings they never saw; metrics, report, table."""

from __future__ import annotations

from pathlib import Path

from kinecast import __version__
from kinecast.body.limits import JointLimits
from kinecast.cli.progress import progress_bar
from kinecast.datasets.loading import load_all
from kinecast.datasets.windows import WindowOptions, all_windows
from kinecast.errors import ModelError, OptionError
from kinecast.evaluation.protocol import EvaluationOptions
from kinecast.evaluation.run import run_evaluation
from kinecast.evaluation.tables import format_table
from kinecast.geometry.scene import Scene
from kinecast.pipeline import training_windows
from kinecast.prediction.forecast import Method
from kinecast.prediction.methods import TrainingOptions, check_names, limits_of, read_method
from kinecast.prediction.methods import train as fit

__all__ = ["evaluate"]

DEFAULT_METHODS = "zero_velocity,constant_velocity,damped_velocity,kalman,ridge,gp_xyz,gp_angles,gp_constrained"


def evaluate(
    test: tuple[Path, ...],
    out: Path,
    train: tuple[Path, ...] = (),
    model: tuple[Path, ...] = (),
    methods: str = DEFAULT_METHODS,
    rate: float = 30.0,
    window: float = 0.2,
    horizon: float = 0.5,
    stride: int = 5,
    label: str | None = None,
    scene: Path | None = None,
    samples: int = 1000,
    repeats: int = 25,
    seed: int = 0,
    format: str | None = None,
) -> None:
    """Scores methods on test recordings; writes metrics.json, report.html and pictures, prints the table.

    Methods: zero_velocity, constant_velocity, damped_velocity, kalman, ridge; kalman and ridge with _angles or
    _constrained; and the paper's gp_xyz, gp_angles, gp_constrained.

    Args:
        test: recordings, or folders of them, to be scored on.
        out: folder for the results.
        train: recordings, or folders of them, to train on; none of them may be among the test recordings.
        model: saved models to score, in place of training.
        methods: names, with commas.
        rate: frames per second [Hz].
        window: what is observed [s].
        horizon: what is predicted [s].
        stride: frames from one test window to the next.
        label: only where the recording's label is this action.
        scene: obstacles, a YAML file.
        samples: motions drawn per prediction.
        repeats: how often the NLL is taken again with fresh draws, for its histogram.
        seed: of everything random.
        format: read recordings as this format instead of finding it by content.
    """
    if bool(train) == bool(model):
        raise OptionError("give either --train with recordings or --model with saved models")
    if not 1 <= samples <= 100_000 or not 0 <= repeats <= 1000:
        raise OptionError(f"samples {samples}, repeats {repeats}; allowed are 1..100000 and 0..1000")
    options = WindowOptions(rate=rate, window=window, horizon=horizon, stride=stride, label=label)
    obstacles = None if scene is None else Scene.load(scene)
    if model:
        trained, limits, trained_on = _saved(model, options)
    else:
        trained, limits, trained_on = _trained(train, test, methods.split(","), options, seed, format)
    parts = list(all_windows(load_all(test, format), options))
    settings = {
        "version": __version__,
        "train": trained_on,
        "rate": rate,
        "window": window,
        "horizon": horizon,
        "stride": stride,
        "label": label,
        "scene": None if scene is None else scene.name,
    }
    scores = EvaluationOptions(samples=samples, repeats=repeats, seed=seed, limits=limits)
    with progress_bar("scoring") as progress:
        metrics = run_evaluation(out, trained, parts, obstacles, scores, settings, progress)
    print(format_table(metrics))
    print(out / "report.html")


def _trained(
    train: tuple[Path, ...],
    test: tuple[Path, ...],
    names: list[str],
    options: WindowOptions,
    seed: int,
    format: str | None,
) -> tuple[dict[str, Method], JointLimits, list[str]]:
    """Methods trained on recordings that are not among those to be scored on."""
    check_names(names)
    tested = {recording.source.resolve() for recording in load_all(test, format) if recording.source}
    recordings = [
        recording
        for recording in load_all(train, format)
        if recording.source is None or recording.source.resolve() not in tested
    ]
    if not recordings:
        raise OptionError("every training recording is also a test recording; nothing is left to train on")
    whole = WindowOptions(
        rate=options.rate,
        window=options.window,
        horizon=options.horizon,
        stride=1,
        label=options.label,
        whole=False,
    )
    data = training_windows(recordings, whole)
    settings = TrainingOptions(seed=seed)
    with progress_bar("training") as progress:
        trained = fit(names, data, settings, progress)
    return trained, limits_of(data, settings), [recording.name for recording in recordings]


def _saved(paths: tuple[Path, ...], options: WindowOptions) -> tuple[dict[str, Method], JointLimits, list[str]]:
    """Saved models, all for the same windows."""
    trained: dict[str, Method] = {}
    cards = []
    for path in paths:
        card, method = read_method(path)
        if (card.frames, card.steps) != (
            options.observed_steps,
            options.predicted_steps,
        ) or card.rate != options.rate:
            raise ModelError(
                f"{path}: made for {card.frames} frames seen and {card.steps} predicted at {card.rate:g} Hz, not "
                f"{options.observed_steps} and {options.predicted_steps} at {options.rate:g} Hz"
            )
        trained[card.method if card.method not in trained else f"{card.method} ({path.stem})"] = method
        cards.append(card)
    held = [card.limits for card in cards if card.method.endswith("_constrained")]
    return (
        trained,
        (held or [cards[0].limits])[0],
        sorted({name for card in cards for name in card.trained_on}),
    )
