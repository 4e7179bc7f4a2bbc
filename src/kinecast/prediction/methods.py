"""All methods by name: trained from windows, written to and read from one file each."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache, partial
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from kinecast.errors import ModelError, OptionError
from kinecast.prediction.gaussian import PositionGaussian, PostureGaussian
from kinecast.prediction.kinecast.model import kinecast_from_arrays
from kinecast.prediction.linear import MeanModel, constant_velocity, damped_velocity, fit_ridge, kalman, zero_velocity
from kinecast.prediction.method import Method
from kinecast.prediction.mixer import fit_mixer
from kinecast.prediction.model_file import ModelCard, read_model_file, write_model_file
from kinecast.prediction.paper import PositionSeries, PostureSeries
from kinecast.prediction.plugins import is_plugin, load_plugin
from kinecast.prediction.training_windows import TrainingWindows
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


def train(
    names: Sequence[str],
    windows: TrainingWindows,
    seed: int = 0,
    progress: Progress | None = None,
    workers: Workers | None = None,
) -> dict[str, Method[Any]]:
    """Trains methods; what two of them share is trained once.

    Args:
        names: of methods, keys of METHODS.
        windows: training data.
        seed: of everything random, 0 or more.
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
    noise, limits, data = windows.noise, windows.limits, workers.submit(scatter, windows)

    @cache
    def fitting(name: str) -> Any:
        """What stands for a trained method."""
        if name in FREE:
            return workers.submit(partial(replace, limits=limits), fitting(FREE[name]))
        if name == "kinecast":
            from kinecast.prediction.kinecast.fit import fitting_kinecast  # only to train

            return fitting_kinecast(workers, windows, data, limits, noise, seed)
        if name == "gp_xyz":
            return PositionSeries.fitting(workers, windows, seed)
        if name == "gp_angles":
            return PostureSeries.fitting(workers, windows, seed, noise)
        kind = PostureGaussian if name.endswith("_angles") else PositionGaussian
        fit = partial(_fit_mean, name.removesuffix("_angles"), seed, windows.dt)
        return workers.submit(_fit_gaussian, kind, fit, data, noise)

    return dict(zip(names, workers.results([fitting(name) for name in names], progress), strict=True))


def _fit_gaussian(kind: Any, fit: Any, windows: TrainingWindows, noise: float) -> Any:
    return kind.fit(fit, windows, noise)


def card_of(
    name: str,
    method: Method[Any],
    windows: TrainingWindows,
    label: str,
    trained_on: Sequence[str],
    notes: Sequence[str] = (),
    seed: int = 0,
) -> ModelCard:
    """The card of a method just trained."""
    return ModelCard(
        method=name,
        frames=method.frames,
        steps=method.steps,
        rate=1.0 / method.dt,
        limits=windows.limits,
        noise=windows.noise,
        trained_on=tuple(trained_on),
        windows=len(windows),
        label=label,
        seed=seed,
        notes=tuple(notes),
    )


def check_names(names: Sequence[str]) -> None:
    """Raises OptionError for names that are no methods, listing those that are."""
    unknown = [name for name in names if name not in METHODS]
    if unknown or not names:
        raise OptionError(f"unknown method {', '.join(unknown) or '(none)'}; methods are {', '.join(METHODS)}")


def _fit_mean(
    name: str, seed: int, dt: float, windows: np.ndarray, futures: np.ndarray, folds: np.ndarray
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
    return fit_mixer(windows, futures, seed=seed)


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
    return method if free == card.method else replace(method, limits=card.limits)


def read_shipped(name: str = SHIPPED[-1]) -> tuple[ModelCard, Method[Any]]:
    """The card and the method of a model that comes with kinecast, one of `SHIPPED`."""
    with resources.as_file(resources.files("kinecast") / "data" / "models" / f"{name}.npz") as path:
        return read_method(path)


def shipped_methods() -> tuple[ModelCard, dict[str, Method[Any]]]:
    """The models that come with kinecast, the best last, and the best one's card."""
    read = {name: read_shipped(name) for name in SHIPPED}
    return read[SHIPPED[-1]][0], {name: method for name, (_, method) in read.items()}
