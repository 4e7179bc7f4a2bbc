"""Training of the horizon model: experts, then the gate and the spread on recordings the experts did not see."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from kinecast.body.limits import JointLimits
from kinecast.prediction.horizon.actions import Actions
from kinecast.prediction.horizon.expert_training import fit_network, fit_radial_basis
from kinecast.prediction.horizon.features import yaw_frame
from kinecast.prediction.horizon.gate import Gate
from kinecast.prediction.horizon.gate_training import fit_gate
from kinecast.prediction.horizon.learned import Expert, Network
from kinecast.prediction.horizon.method import LONGEST_PAUSE, Horizon, Means, Mixture
from kinecast.prediction.horizon.spread import SIDES
from kinecast.prediction.horizon.spread_training import fit_spread
from kinecast.prediction.observation import TrainingWindows

__all__ = ["HorizonOptions", "fit_actions", "fit_horizon"]

Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class HorizonOptions:
    """How the horizon model is trained.

    Attributes:
        pseudo_inputs: M of the radial basis experts.
        network_steps: of stochastic descent.
        folds: parts of the data that gate and spread are fitted on, each with experts that have not seen it.
        networks: whose mean is the neural expert, each from its own seed; folds make do with one.
        noise: white noise of the second radial basis expert's inputs, log-uniform between these [m].
        seed: of everything random.
    """

    pseudo_inputs: int = 256
    network_steps: int = 2500
    folds: int = 4
    networks: int = 2
    noise: tuple[float, float] = (5e-4, 12e-3)
    seed: int = 0


def fit_horizon(
    windows: TrainingWindows,
    limits: JointLimits | None,
    noise: float,
    options: HorizonOptions,
    progress: Progress | None = None,
) -> Horizon:
    """Trains the method `kinecast`.

    Args:
        windows: of consecutive frames, recording by recording; their groups (tasks, recordings) are left out one
            after another.
        limits: of the arm's angles; None for none.
        noise: spread of a measured joint about the true one [m].
        options: see HorizonOptions.
        progress: called with (done, total) fits of experts.
    """
    frames, steps = windows.observed.shape[1], windows.future.shape[1]
    folds = windows.folds(options.folds)
    names = np.unique(folds)
    total, done = 3 * (len(names) + 1), 0

    def experts(rows: TrainingWindows, networks: int) -> list[Expert]:
        nonlocal done
        fitted: list[Expert] = []
        for expert in _experts(rows, options, networks):
            fitted.append(expert)
            done += 1
            if progress:
                progress(done, total)
        return fitted

    held = []
    for name in names:
        outside = folds == name
        inside = ~outside & ~windows.near(outside) if len(names) > 1 else outside
        held.append(
            (
                Mixture(experts(windows.take(np.flatnonzero(inside)), 1), None, frames, steps),
                windows.take(np.flatnonzero(outside)),
            )
        )
    gate = fit_gate(*_gate_examples(held, options), seed=options.seed)
    spread = fit_spread(*_spread_examples(held, gate))
    final = Mixture(experts(windows, options.networks), gate, frames, steps)
    return Horizon(final, spread, windows.dt, noise, limits)


def fit_actions(
    windows: Mapping[str, TrainingWindows], options: HorizonOptions, progress: Progress | None = None
) -> Actions:
    """Trains experts for each action on its windows alone.

    Args:
        windows: of each action, by its name.
        options: see HorizonOptions; folds do not matter.
        progress: called with (done, total) fits of experts.
    """
    fitted: list[tuple[Expert, ...]] = []
    total, done = 3 * len(windows), 0
    for own in windows.values():
        experts: list[Expert] = []
        for expert in _experts(own, options, 1):
            experts.append(expert)
            done += 1
            if progress:
                progress(done, total)
        fitted.append(tuple(experts))
    return Actions(tuple(windows), tuple(fitted))


def _experts(windows: TrainingWindows, options: HorizonOptions, networks: int) -> Iterator[Expert]:
    """A radial basis, another on noisy inputs for poor sensors, and the mean of networks."""
    rng = np.random.default_rng([options.seed, 1])
    noisy = _with_noise(windows, rng, options.noise)
    yield fit_radial_basis(windows.observed, windows.future, options.pseudo_inputs, options.seed)
    yield fit_radial_basis(
        np.concatenate([windows.observed, noisy]),
        np.concatenate([windows.future, windows.future]),
        options.pseudo_inputs,
        options.seed,
    )
    seeds = range(options.seed, options.seed + networks)
    fitted = [fit_network(windows.observed, windows.future, options.network_steps, seed) for seed in seeds]
    yield Network.mean_of(fitted)


def _with_noise(
    windows: TrainingWindows, rng: np.random.Generator, least_most: tuple[float, float]
) -> Float[np.ndarray, "W N 6 3"]:
    """The observed windows with white noise, more on some windows and joints than on others."""
    count = len(windows)
    level = np.exp(
        rng.uniform(np.log(least_most[0]), np.log(least_most[1]), (count, 1, 1, 1))
        + 0.4 * rng.standard_normal((count, 1, 6, 1))
    )
    return windows.observed + level * rng.standard_normal(windows.observed.shape)


Held = list[tuple[Mixture, TrainingWindows]]


def _gate_examples(
    held: Held, options: HorizonOptions
) -> tuple[
    Float[np.ndarray, "B E 6 Q"],
    Float[np.ndarray, "B 6 5"],
    Float[np.ndarray, "B E T 6 3"],
    Float[np.ndarray, "B T 6 3"],
]:
    """Every fourth window as the gate would see it online, from a clean and from a noisy sensor."""
    rng = np.random.default_rng([options.seed, 2])
    errors, looks, forecasts, futures = [], [], [], []
    for mixture, windows in held:
        for recording in np.unique(windows.recording):
            part = windows.take(np.flatnonzero(windows.recording == recording))
            for each in (part, _noisy_recording(part, rng)):
                for row, means, _ in _followed(mixture, each):
                    if row % 4:
                        continue
                    last = each.observed[row, -1]
                    errors.append(means.inputs.errors)
                    looks.append(means.inputs.window)
                    forecasts.append((means.forecasts - last).astype(np.float32))
                    futures.append(each.future[row] - last)
    return np.stack(errors), np.stack(looks), np.stack(forecasts), np.stack(futures)


def _noisy_recording(windows: TrainingWindows, rng: np.random.Generator) -> TrainingWindows:
    """One recording's windows as a noisier sensor would have given them: the same noise wherever a frame appears."""
    frames, steps = windows.observed.shape[1], windows.future.shape[1]
    first = windows.frame.min() - frames + 1
    length = int(windows.frame.max() + steps - first + 1)
    level = np.exp(rng.uniform(np.log(1e-3), np.log(8e-3)) + 0.4 * rng.standard_normal((1, 6, 1)))
    noise = level * rng.standard_normal((length, 6, 3))
    seen = (windows.frame - first)[:, None] + np.arange(1 - frames, 1)
    ahead = (windows.frame - first)[:, None] + np.arange(1, steps + 1)
    return replace(windows, observed=windows.observed + noise[seen], future=windows.future + noise[ahead])


def _spread_examples(
    held: Held, gate: Gate
) -> tuple[Float[np.ndarray, "B T 6 3"], Float[np.ndarray, "B 6 F"], Float[np.ndarray, "B 6"]]:
    """Errors of the mixture in each arm's own axes, features of the spread, speeds of the joints."""
    errors, features, speeds = [], [], []
    for mixture, windows in held:
        gated = replace(mixture, gate=gate)
        for recording in np.unique(windows.recording):
            part = windows.take(np.flatnonzero(windows.recording == recording))
            for row, means, window in _followed(gated, part):
                own = (part.future[row] - means.mean) @ yaw_frame(window[-1])
                errors.append(np.einsum("tjd,jde->tje", own, SIDES))
                features.append(means.features)
                speeds.append(np.linalg.norm(np.diff(window, axis=0), axis=-1).mean(axis=0))
    return np.stack(errors), np.stack(features), np.stack(speeds)


def _followed(mixture: Mixture, windows: TrainingWindows) -> Iterator[tuple[int, Means, Float[np.ndarray, "N 6 3"]]]:
    """One recording frame by frame, as online: row, mixture, window."""
    made = mixture.forecasts(windows.observed)
    memory = mixture.memory()
    before = None
    for row, frame in enumerate(windows.frame):
        pause = 0 if before is None else int(frame - before) - 1
        memory = mixture.memory() if pause > LONGEST_PAUSE else memory
        memory.skip(pause if pause <= LONGEST_PAUSE else 0)
        window = windows.observed[row]
        yield row, mixture.follow(memory, window, window[-1], made[row]), window
        before = frame
