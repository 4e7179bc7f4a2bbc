"""Training of `kinecast`: experts, then the gate and the error model on recordings the experts did not see."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from kinecast.body.limits import JointLimits
from kinecast.prediction.kinecast.error_model import SIDES, ErrorModel, fit_error_model
from kinecast.prediction.kinecast.experts import Network, RadialBasis, fit_network, fit_radial_basis, forecasts
from kinecast.prediction.kinecast.features import yaw_frame
from kinecast.prediction.kinecast.model import LONGEST_PAUSE, Kinecast, Mixture, MixtureOutput
from kinecast.prediction.kinecast.weights import Gate, fit_gate
from kinecast.prediction.observation import TrainingWindows
from kinecast.tasks import Workers, generator

Rows = Int[np.ndarray, " R"]
Examples = tuple[np.ndarray, ...]
NOISE, RECORDING_NOISE = (5e-4, 12e-3), (1e-3, 8e-3)
"""Noise of the second radial basis expert's inputs, and of the gate's noisy recordings: log-uniform [m]."""


@dataclass(frozen=True)
class KinecastOptions:
    """How the method is trained.

    Attributes:
        pseudo_inputs: M of the radial basis experts.
        network_steps: of stochastic descent.
        folds: parts of the data that gate and spread are fitted on, each with experts that have not seen it.
        networks: whose mean is the neural expert, each from its own seed; folds make do with one.
        seed: of everything random.
    """

    pseudo_inputs: int = 256
    network_steps: int = 2500
    folds: int = 4
    networks: int = 2
    seed: int = 0


def fitting_kinecast(
    workers: Workers,
    windows: TrainingWindows,
    data: Any,
    limits: JointLimits | None,
    noise: float,
    options: KinecastOptions,
) -> Any:
    """Stands for the method `kinecast`, trained by workers.

    Args:
        workers: that do the tasks: experts, what they say of each recording, gate and spread.
        windows: of consecutive frames, recording by recording; groups are left out one after another.
        data: stands for the same windows.
        limits: of the arm's angles; None for none.
        noise: spread of a measured joint about the true one [m].
        options: see KinecastOptions.
    """
    frames, steps, dt = windows.shape
    folds = windows.folds(options.folds)
    names = np.unique(folds)
    held: list[tuple[Any, Rows, tuple[int, int]]] = []
    for place, name in enumerate(names):
        outside = folds == name
        inside = ~outside & ~windows.near(outside) if len(names) > 1 else outside
        experts = _fitting_experts(workers, data, np.flatnonzero(inside), options, 1)
        mixture = workers.submit(Mixture, experts, None, frames, steps)
        for recording in np.unique(windows.recording[outside]).tolist():
            held.append((mixture, np.flatnonzero(outside & (windows.recording == recording)), (place, recording)))
    examples = [workers.submit(_gate_examples, *each, data, options.seed) for each in held]
    gate = workers.submit(_gate, examples, options.seed)
    errors = [workers.submit(_error_examples, mixture, rows, data, gate) for mixture, rows, _ in held]
    spread = workers.submit(_error_model, errors)
    final = _fitting_experts(workers, data, np.arange(len(windows)), options, options.networks)
    mixture = workers.submit(Mixture, final, gate, frames, steps)
    return workers.submit(Kinecast, mixture, spread, dt, noise, limits)


def _fitting_experts(workers: Workers, data: Any, rows: Rows, options: KinecastOptions, networks: int) -> list[Any]:
    """A radial basis, another on noisy inputs for poor sensors, and the mean of networks; stand for the experts."""
    seeds = range(options.seed, options.seed + networks)
    fitted = [workers.submit(_network, data, rows, options.network_steps, seed) for seed in seeds]
    return [
        workers.submit(_radial_basis, data, rows, options),
        workers.submit(_noisy_radial_basis, data, rows, options),
        workers.submit(Network.mean_of, fitted),
    ]


def _network(data: TrainingWindows, rows: Rows, steps: int, seed: int) -> Network:
    return fit_network(data.observed[rows], data.future[rows], steps, seed)


def _radial_basis(data: TrainingWindows, rows: Rows, options: KinecastOptions) -> RadialBasis:
    return fit_radial_basis(data.observed[rows], data.future[rows], options.pseudo_inputs, options.seed)


def _noisy_radial_basis(data: TrainingWindows, rows: Rows, options: KinecastOptions) -> RadialBasis:
    observed, future, rng = data.observed[rows], data.future[rows], np.random.default_rng([options.seed, 1])
    noisy = observed + _white_noise(rng, NOISE, len(rows), observed.shape[1])
    both = np.concatenate([observed, noisy]), np.concatenate([future, future])
    return fit_radial_basis(*both, options.pseudo_inputs, options.seed)


def _white_noise(
    rng: np.random.Generator, levels: tuple[float, float], windows: int, frames: int
) -> Float[np.ndarray, "W K 6 3"]:
    """White noise [m], more on some windows and joints than on others."""
    level = rng.uniform(math.log(levels[0]), math.log(levels[1]), (windows, 1, 1, 1)) + 0.4 * rng.standard_normal(
        (windows, 1, 6, 1)
    )
    return np.exp(level) * rng.standard_normal((windows, frames, 6, 3))


def _gate_examples(mixture: Mixture, rows: Rows, place: tuple[int, int], data: TrainingWindows, seed: int) -> Examples:
    """Every fourth window of a recording as the gate would see it online, from a clean and from a noisy sensor."""
    part, examples = data.take(rows), []
    for each in (part, _noisy_recording(part, generator(seed, 2, *place))):
        for row, output, window in _followed(mixture, each):
            if row % 4 == 0:
                made = (output.forecasts - window[-1]).astype(np.float32)
                examples.append((output.inputs.errors, output.inputs.window, made, each.future[row] - window[-1]))
    return tuple(map(np.stack, zip(*examples, strict=True)))


def _gate(examples: Sequence[Examples], seed: int) -> Gate:
    errors, looks, forecasts, futures = map(np.concatenate, zip(*examples, strict=True))
    return fit_gate(errors, looks, forecasts, futures, seed)


def _noisy_recording(windows: TrainingWindows, rng: np.random.Generator) -> TrainingWindows:
    """One recording's windows as a noisier sensor would have given them: the same noise wherever a frame appears."""
    frames, steps = windows.observed.shape[1], windows.future.shape[1]
    first = windows.frame.min() - frames + 1
    length = int(windows.frame.max() + steps - first + 1)
    noise = _white_noise(rng, RECORDING_NOISE, 1, length)[0]
    seen = (windows.frame - first)[:, None] + np.arange(1 - frames, 1)
    ahead = (windows.frame - first)[:, None] + np.arange(1, steps + 1)
    return replace(windows, observed=windows.observed + noise[seen], future=windows.future + noise[ahead])


def _error_examples(mixture: Mixture, rows: Rows, data: TrainingWindows, gate: Gate) -> Examples:
    """Errors of the mixture on a recording in each arm's own axes, features of the error model, joints' speeds."""
    part, examples = data.take(rows), []
    for row, output, window in _followed(replace(mixture, gate=gate), part):
        own = (part.future[row] - output.mean) @ yaw_frame(window[-1])
        examples.append((np.einsum("tjd,jde->tje", own, SIDES), output.features, output.motion.speed))
    return tuple(map(np.stack, zip(*examples, strict=True)))


def _error_model(examples: Sequence[Examples]) -> ErrorModel:
    return fit_error_model(*map(np.concatenate, zip(*examples, strict=True)))


def _followed(
    mixture: Mixture, windows: TrainingWindows
) -> Iterator[tuple[int, MixtureOutput, Float[np.ndarray, "N 6 3"]]]:
    """One recording frame by frame, as online: row, what the mixture says, window."""
    made = forecasts(mixture.experts, windows.observed, mixture.steps)
    errors, before = mixture.rolling_errors(), int(windows.frame[0]) - 1
    for row, frame in enumerate(windows.frame.tolist()):
        if frame - before - 1 > LONGEST_PAUSE:
            errors, before = mixture.rolling_errors(), frame - 1
        errors.skip(frame - before - 1)
        window = windows.observed[row]
        yield row, mixture.update(errors, window, window[-1], made[row]), window
        before = frame
