"""All methods by name: trained from windows, written to and read from one file each."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache, partial
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from kinecast.body.limits import JointLimits
from kinecast.body.posture import postures_from_points
from kinecast.errors import ModelError, OptionError
from kinecast.prediction.gaussian import PositionGaussian, PostureGaussian
from kinecast.prediction.kinecast.model import kinecast_from_arrays
from kinecast.prediction.linear import MeanModel, constant_velocity, damped_velocity, fit_ridge, kalman, zero_velocity
from kinecast.prediction.method import Method
from kinecast.prediction.mixer import fit_mixer
from kinecast.prediction.model_file import ModelCard, read_model_file, write_model_file
from kinecast.prediction.noise import sensor_noise
from kinecast.prediction.observation import TrainingWindows
from kinecast.prediction.paper import PositionSeries, PostureSeries
from kinecast.prediction.plugins import is_plugin, load_plugin
from kinecast.prediction.sparse_gp import SparseGPOptions
from kinecast.tasks import Progress, Serial, Workers, scatter

METHODS: Mapping[str, str] = {
    "zero_velocity": "nothing moves",
    "constant_velocity": "the last velocity goes on",
    "damped_velocity": "the velocity fades out; estimator and time constant fitted",
    "kalman": "constant-velocity Kalman filter, noise fitted",
    "ridge": "ridge regression from the window to every step",
    "kalman_angles": "the Kalman filter on posture coordinates",
    "kalman_constrained": "the same, inside joint limits and scene",
    "ridge_angles": "ridge regression on posture coordinates",
    "ridge_constrained": "the same, inside joint limits and scene",
    "gp_xyz": "the paper's: one sparse GP per position coordinate",
    "gp_angles": "the paper's: one sparse GP per joint angle",
    "gp_constrained": "the paper's: the same, inside joint limits and scene",
    "mixer": "a small neural forecaster in the manner of siMLPe, its errors' covariance around it",
    "mixer_constrained": "the same, inside joint limits and scene",
    "kinecast": "the project's own: experts mixed online, calibrated, inside joint limits and scene",
}
"""Every method and what it does."""

FREE = {
    "kalman_constrained": "kalman_angles",
    "ridge_constrained": "ridge_angles",
    "gp_constrained": "gp_angles",
    "mixer_constrained": "mixer",
}
"""Constrained methods, and what each is without its limits."""

SHIPPED = ("zero_velocity", "damped_velocity", "gp_constrained", "kinecast")
"""Methods whose models come with kinecast, the best last."""


@dataclass(frozen=True)
class TrainingOptions(SparseGPOptions):
    """How methods are trained.

    Attributes:
        limits: range and speed of the arm's angles; ranges are widened to hold the training postures, since markers
            are not always at the joints.
        descent: steps of it, for the neural forecaster.
    """

    limits: JointLimits = field(default_factory=JointLimits)
    descent: int = 1500


def train(
    names: Sequence[str],
    windows: TrainingWindows,
    options: TrainingOptions,
    progress: Progress | None = None,
    workers: Workers | None = None,
) -> dict[str, Method[Any]]:
    """Trains methods; what two of them share is trained once.

    Args:
        names: of methods, keys of METHODS.
        windows: training data.
        options: see TrainingOptions.
        progress: called with (done, total) tasks.
        workers: that do them; None for this process. The methods are the same, to the last bit.

    Raises:
        OptionError: an unknown name.
        ModelError: too few windows.
    """
    if names:
        check_names(names)
    if len(windows) < 50:
        raise ModelError(f"{len(windows)} training windows; at least 50 are needed")
    workers = workers or Serial()
    fitted = _fitting(workers, windows, options)
    return dict(zip(names, workers.results([fitted(name) for name in names], progress), strict=True))


def _fitting(workers: Workers, windows: TrainingWindows, options: TrainingOptions) -> Callable[[str], Any]:
    """Gives what stands for a trained method by its name; what two methods share is one task."""
    noise, limits, data = sensor_noise(windows), limits_of(windows, options), workers.submit(scatter, windows)
    examples = cache(lambda kind: workers.submit(kind.examples, data))

    @cache
    def fitted(name: str) -> Any:
        if name in FREE:
            return workers.submit(_with_limits, fitted(FREE[name]), limits)
        if name == "kinecast":
            from kinecast.prediction.kinecast.fit import KinecastOptions, fitting_kinecast  # only to train

            return fitting_kinecast(workers, windows, data, limits, noise, KinecastOptions(seed=options.seed))
        if name == "gp_xyz":
            return PositionSeries.fitting(workers, windows, data, options)
        if name == "gp_angles":
            return PostureSeries.fitting(workers, windows, examples(PostureGaussian), options, noise)
        kind = PostureGaussian if name.endswith("_angles") else PositionGaussian
        fit = partial(_fit_mean, name.removesuffix("_angles"), options, windows.dt)
        return kind.fitting(workers, fit, windows, examples(kind), noise)

    return fitted


def _with_limits(method: Any, limits: JointLimits) -> Any:
    return method.with_limits(limits)


def limits_of(windows: TrainingWindows, options: TrainingOptions) -> JointLimits:
    """The options' limits, their ranges widened to hold the postures trained on."""
    return options.limits.widened(postures_from_points(windows.points, continuous=True)[:, -1])


def card_of(
    name: str,
    method: Method[Any],
    windows: TrainingWindows,
    options: TrainingOptions,
    label: str,
    trained_on: Sequence[str],
    notes: Sequence[str] = (),
) -> ModelCard:
    """The card of a method just trained."""
    return ModelCard(
        method=name,
        frames=method.frames,
        steps=method.steps,
        rate=1.0 / method.dt,
        limits=limits_of(windows, options),
        noise=sensor_noise(windows),
        trained_on=tuple(trained_on),
        windows=len(windows),
        label=label,
        seed=options.seed,
        notes=tuple(notes),
    )


def check_names(names: Sequence[str]) -> None:
    """Raises OptionError for names that are no methods, listing those that are."""
    unknown = [name for name in names if name not in METHODS]
    if unknown or not names:
        raise OptionError(f"unknown method {', '.join(unknown) or '(none)'}; methods are {', '.join(METHODS)}")


def _fit_mean(
    name: str, options: TrainingOptions, dt: float, windows: np.ndarray, futures: np.ndarray, folds: np.ndarray
) -> MeanModel:
    """Fits the mean model of a baseline."""
    frames, steps = windows.shape[1], futures.shape[1]
    match name:
        case "zero_velocity":
            return zero_velocity(frames, steps)
        case "constant_velocity":
            return constant_velocity(frames, steps)
        case "damped_velocity":
            return damped_velocity(windows, futures, dt)
        case "kalman":
            return kalman(windows, futures)
        case "ridge":
            return fit_ridge(windows, futures, folds)
    return fit_mixer(windows, futures, steps=options.descent, seed=options.seed)


def save_method(path: Path, card: ModelCard, method: Method[Any]) -> None:
    """Writes one trained method to a file, whole or not at all."""
    write_model_file(path, card, method.to_arrays())


def read_method(path: Path) -> tuple[ModelCard, Method[Any]]:
    """The card and the method of a model file, or of a function MODULE:FUNCTION that gives a trained method.

    Raises:
        ModelError: not a model of this kinecast, or no method.
        OptionError: no such function.
    """
    if is_plugin(str(path)):
        method = load_plugin(str(path))
        return ModelCard(str(path), method.frames, method.steps, 1.0 / method.dt), method
    card, arrays = read_model_file(path)
    if card.method not in METHODS:
        raise ModelError(f"{path}: method {card.method!r}; this kinecast knows {', '.join(METHODS)}")
    try:
        return card, _method_from(card, arrays)
    except (KeyError, ValueError, IndexError) as error:
        raise ModelError(f"{path}: arrays do not fit the method {card.method} ({error})") from None


def _method_from(card: ModelCard, arrays: Mapping[str, np.ndarray]) -> Method[Any]:
    if card.method == "kinecast":
        return kinecast_from_arrays(arrays, card)
    if card.method == "gp_xyz":
        return PositionSeries.from_arrays(arrays, card)
    free = FREE.get(card.method, card.method)
    kind = PostureSeries if free == "gp_angles" else PostureGaussian if free.endswith("_angles") else PositionGaussian
    method = kind.from_arrays(arrays, card)
    return method if free == card.method else method.with_limits(card.limits)


def read_shipped(name: str = SHIPPED[-1]) -> tuple[ModelCard, Method[Any]]:
    """The card and the method of a model that comes with kinecast, one of `SHIPPED`."""
    with resources.as_file(resources.files("kinecast") / "data" / "models" / f"{name}.npz") as path:
        return read_method(path)


def shipped_methods() -> tuple[ModelCard, dict[str, Method[Any]]]:
    """The models that come with kinecast, the best last, and the best one's card."""
    read = {name: read_shipped(name) for name in SHIPPED}
    return read[SHIPPED[-1]][0], {name: method for name, (_, method) in read.items()}
