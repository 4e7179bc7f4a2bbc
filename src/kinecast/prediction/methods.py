"""All methods by name: trained from windows, written to and read from one file each."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from importlib import resources
from pathlib import Path

import numpy as np

from kinecast.body.limits import JointLimits
from kinecast.body.posture import postures_from_points
from kinecast.errors import ModelError, OptionError
from kinecast.prediction.baselines import constant_velocity, damped_velocity, fit_ridge, kalman, zero_velocity
from kinecast.prediction.checkpoint import ModelCard, read_checkpoint, write_checkpoint
from kinecast.prediction.forecast import Method
from kinecast.prediction.gaussian import Fit, PositionGaussian, PostureGaussian
from kinecast.prediction.horizon.method import Horizon, horizon_from_arrays
from kinecast.prediction.horizon.training import HorizonOptions, fit_actions, fit_horizon
from kinecast.prediction.mixer import fit_mixer
from kinecast.prediction.noise import sensor_noise
from kinecast.prediction.observation import TrainingWindows
from kinecast.prediction.paper import PositionSeries, PostureSeries

__all__ = [
    "METHODS",
    "TrainingOptions",
    "card_of",
    "check_names",
    "limits_of",
    "read_method",
    "save_method",
    "shipped_methods",
    "train",
    "with_actions",
]

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

SHIPPED = ("zero_velocity", "damped_velocity", "gp_constrained", "kinecast")
"""Methods whose models come with kinecast, the best last."""

Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class TrainingOptions:
    """How methods are trained.

    Attributes:
        limits: range and speed of the arm's angles; ranges are widened to hold the training postures, since markers
            are not always at the joints.
        seed: of everything random.
        pseudo_inputs: M of each sparse GP.
        points: most windows a sparse GP is trained on.
        iterations: of the GP's marginal likelihood maximisation.
        descent: steps of it, for the neural forecaster.
    """

    limits: JointLimits = field(default_factory=JointLimits)
    seed: int = 0
    pseudo_inputs: int = 16
    points: int = 2000
    iterations: int = 100
    descent: int = 1500


def train(
    names: Sequence[str], windows: TrainingWindows, options: TrainingOptions, progress: Progress | None = None
) -> dict[str, Method]:
    """Trains methods; what two of them share is trained once.

    Args:
        names: of methods, keys of METHODS.
        windows: training data.
        options: see TrainingOptions.
        progress: called with (done, total) series of the Gaussian processes.

    Raises:
        OptionError: an unknown name.
        ModelError: too few windows.
    """
    check_names(names)
    if len(windows) < 50:
        raise ModelError(f"{len(windows)} training windows; at least 50 are needed")
    noise = sensor_noise(windows)
    limits = limits_of(windows, options)
    trained: dict[str, Method] = {}
    angles: PostureSeries | None = None
    mixer: PositionGaussian | None = None
    for name in names:
        if name == "gp_xyz":
            trained[name] = PositionSeries.fit(windows, options, progress)
        elif name in ("gp_angles", "gp_constrained"):
            angles = angles or PostureSeries.fit(windows, options, noise, progress)
            trained[name] = angles.with_limits(limits if name == "gp_constrained" else None)
        elif name in ("mixer", "mixer_constrained"):
            mixer = mixer or PositionGaussian.fit(_fit("mixer", windows, options), windows)
            trained[name] = mixer if name == "mixer" else mixer.with_limits(limits, noise)
        elif name == "kinecast":
            own = HorizonOptions(seed=options.seed)
            trained[name] = fit_horizon(windows, limits, noise, own, progress)
        else:
            base, _, space = name.partition("_") if name.endswith(("_angles", "_constrained")) else (name, "", "")
            fit = _fit(base, windows, options)
            if space:
                held = limits if space == "constrained" else None
                trained[name] = PostureGaussian.fit(fit, windows, noise, held)
            else:
                trained[name] = PositionGaussian.fit(fit, windows)
    return trained


def with_actions(
    method: Method, windows: Mapping[str, TrainingWindows], options: TrainingOptions, progress: Progress | None = None
) -> Method:
    """The method `kinecast` with a model for each action beside its own.

    Args:
        method: trained, of the same rate, window and horizon as the windows.
        windows: of each action.
        options: see TrainingOptions.
        progress: called with (done, total) fits.

    Raises:
        OptionError: another method.
    """
    if not isinstance(method, Horizon):
        raise OptionError("models per action go with the method kinecast")
    actions = fit_actions(windows, HorizonOptions(seed=options.seed), progress)
    return replace(method, mixture=replace(method.mixture, actions=actions))


def limits_of(windows: TrainingWindows, options: TrainingOptions) -> JointLimits:
    """The options' limits, their ranges widened to hold the postures trained on."""
    return options.limits.widened(postures_from_points(windows.points, continuous=True)[:, -1])


def card_of(
    name: str,
    method: Method,
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


def _fit(base: str, windows: TrainingWindows, options: TrainingOptions) -> Fit:
    """How the mean model of a baseline is fitted."""
    frames, steps = windows.observed.shape[1], windows.future.shape[1]
    fits: dict[str, Fit] = {
        "zero_velocity": lambda _w, _f, _folds: zero_velocity(frames, steps),
        "constant_velocity": lambda _w, _f, _folds: constant_velocity(frames, steps),
        "damped_velocity": lambda w, f, _folds: damped_velocity(w, f, windows.dt),
        "kalman": lambda w, f, _folds: kalman(w, f),
        "ridge": fit_ridge,
        "mixer": partial(fit_mixer, steps=options.descent, seed=options.seed),
    }
    return fits[base]


def save_method(path: Path, card: ModelCard, method: Method) -> None:
    """Writes one trained method to a file, whole or not at all."""
    write_checkpoint(path, card, method.to_arrays())


def read_method(path: Path) -> tuple[ModelCard, Method]:
    """The card and the method of a model file.

    Raises:
        ModelError: not a model of this kinecast.
    """
    card, arrays = read_checkpoint(path)
    if card.method not in METHODS:
        raise ModelError(f"{path}: method {card.method!r}; this kinecast knows {', '.join(METHODS)}")
    try:
        return card, _method_from(card, arrays)
    except (KeyError, ValueError, IndexError) as error:
        raise ModelError(f"{path}: arrays do not fit the method {card.method} ({error})") from None


def _method_from(card: ModelCard, arrays: Mapping[str, np.ndarray]) -> Method:
    shape = (card.frames, card.steps, card.dt)
    if card.method == "kinecast":
        return horizon_from_arrays(arrays, *shape, card.noise, card.limits)
    limits = card.limits if card.method.endswith("_constrained") else None
    if card.method == "gp_xyz":
        return PositionSeries.from_arrays(arrays, *shape)
    if card.method in ("gp_angles", "gp_constrained"):
        return PostureSeries.from_arrays(arrays, *shape, card.noise, limits)
    if card.method.startswith("mixer"):
        return PositionGaussian.from_arrays(arrays, *shape, card.noise, limits)
    if card.method.endswith(("_angles", "_constrained")):
        return PostureGaussian.from_arrays(arrays, *shape, card.noise, limits)
    return PositionGaussian.from_arrays(arrays, *shape)


def shipped_methods() -> tuple[ModelCard, dict[str, Method]]:
    """The models that come with kinecast, the best last, and the best one's card."""
    folder = resources.files("kinecast") / "data" / "models"
    methods = {}
    for name in SHIPPED:
        with resources.as_file(folder / f"{name}.npz") as path:
            card, methods[name] = read_method(path)
    return card, methods
