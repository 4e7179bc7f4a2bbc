"""Training of `kinecast`: experts, then the gate and the error model on recordings the experts did not see."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from kinecast.body.limits import JointLimits
from kinecast.prediction.kinecast.error_model import SIDES, ErrorModel
from kinecast.prediction.kinecast.experts import FeatureScale, Networks, arm_views, forecasts, yaw_frame
from kinecast.prediction.kinecast.model import LONGEST_PAUSE, Kinecast, MixtureOutput, OnlineMixture
from kinecast.prediction.kinecast.objectives import fit_error_model, fit_gate, fit_network
from kinecast.prediction.kinecast.weights import Gate
from kinecast.prediction.training_windows import TrainingWindows
from kinecast.tasks import Workers, generator

Rows = Int[np.ndarray, " R"]
Examples = tuple[np.ndarray, ...]
NOISE, RECORDING_NOISE = (5e-4, 12e-3), (1e-3, 8e-3)
"""Noise of the second general network's inputs, and of the gate's noisy recordings: log-uniform [m]."""
NETWORK_STEPS, FOLDS = 4000, 4
"""Steps of a network's descent; parts of the data that gate and spread are fitted on, each with networks that have
not seen it."""
POOL = 80_000
"""Most windows that a network is trained on, drawn by their shares."""
JUDGED = slice(2, None, 3)
"""Steps at which the gate is fitted: what it learns varies smoothly with the step."""
FOLLOWED = 48_000
"""About as many windows, recordings whole, are followed frame by frame for the gate and the error model."""
AT_ONCE = 256
"""Windows that are forecast at once: those of a long recording would take a gigabyte."""
SIZES = 0.15
"""People are this much larger or smaller, log-uniform."""


def fitting_kinecast(
    workers: Workers,
    windows: TrainingWindows,
    data: Any,
    limits: JointLimits | None,
    noise: float,
    seed: int,
) -> Any:
    """Stands for the method `kinecast`, trained by workers.

    Two networks learn from all collections, and one from each where there are several. Gate and error model learn from
    collections (else tasks, else recordings) that no network has seen: in a fold, the place of a left-out collection's
    own network is taken by the one that knows all the others.

    Args:
        workers: that do the tasks: networks, what they say of each recording, gate and spread.
        windows: of consecutive frames, recording by recording; groups are left out one after another.
        data: stands for the same windows.
        limits: of the arm's angles; None for none.
        noise: spread of a measured joint about the true one [m].
        seed: of everything random.
    """
    scale = workers.submit(_feature_scale, data, seed)

    def network(rows: Rows, noisy: bool = False) -> Any:
        return workers.submit(_network, data, rows, scale, seed, noisy)

    def general(rows: Rows) -> list[Any]:
        return [network(rows), network(rows, noisy=True)]

    collections = np.unique(windows.collection).tolist()
    own = {name: network(np.flatnonzero(windows.collection == name)) for name in collections if len(collections) > 1}
    folds, held, followed = windows.folds(FOLDS), [], _followed_recordings(windows)
    names = np.unique(folds)
    for place, name in enumerate(names):
        outside = folds == name
        inside = ~outside & ~windows.near(outside) if len(names) > 1 else outside
        both = general(np.flatnonzero(inside))
        seen = set(windows.collection[inside].tolist()) - set(windows.collection[outside].tolist())
        stand_in = [fitted if each in seen else both[0] for each, fitted in own.items()]
        networks = workers.submit(Networks.joined, both + stand_in)
        for recording in np.unique(windows.recording[outside & followed]).tolist():
            held.append((networks, np.flatnonzero(outside & (windows.recording == recording)), (place, recording)))
    examples = [workers.submit(_gate_examples, *each, data, seed) for each in held]
    gate = workers.submit(_gate, examples, windows.future.shape[1], seed)
    errors = [workers.submit(_error_examples, networks, rows, data, gate) for networks, rows, _ in held]
    spread = workers.submit(_error_model, errors, seed)
    networks = workers.submit(Networks.joined, general(np.arange(len(windows))) + list(own.values()))
    return workers.submit(Kinecast, networks, gate, spread, *windows.shape, noise, limits)


def _feature_scale(data: TrainingWindows, seed: int) -> FeatureScale:
    return FeatureScale.of(arm_views(data.observed[_drawn(data, np.arange(len(data)), POOL // 4, seed)]))


def _drawn(data: TrainingWindows, rows: Rows, count: int, seed: int) -> Rows:
    """At most `count` of the rows, by their shares."""
    shares = data.shares(rows)
    return np.random.default_rng(seed).choice(rows, min(count, len(rows)), p=shares, replace=True)


def _network(data: TrainingWindows, rows: Rows, scale: FeatureScale, seed: int, noisy: bool) -> Networks:
    rng = np.random.default_rng([seed, noisy])
    some = _drawn(data, rows, POOL, seed)
    size = np.exp(rng.uniform(-SIZES, SIZES, (len(some), 1, 1, 1))).astype(np.float32)
    observed, future = size * data.observed[some], size * data.future[some]
    if noisy:
        observed = observed + _white_noise(rng, NOISE, len(some), observed.shape[1])
    return fit_network(scale, observed, future, NETWORK_STEPS, seed + noisy)


def _followed_recordings(windows: TrainingWindows) -> Bool[np.ndarray, " W"]:
    """(W,) windows of the recordings to follow: of each collection its fair part, spread over its recordings."""
    chosen, collections = np.zeros(len(windows), dtype=bool), np.unique(windows.collection)
    for name in collections:
        here = np.flatnonzero(windows.collection == name)
        stride = math.ceil(len(here) * len(collections) / FOLLOWED)
        chosen[here] = np.unique(windows.recording[here], return_inverse=True)[1] % stride == 0
    return chosen


def _white_noise(
    rng: np.random.Generator, levels: tuple[float, float], windows: int, frames: int
) -> Float[np.ndarray, "W K 6 3"]:
    """White noise [m], more on some windows and joints than on others."""
    level = rng.uniform(math.log(levels[0]), math.log(levels[1]), (windows, 1, 1, 1)) + 0.4 * rng.standard_normal(
        (windows, 1, 6, 1)
    )
    return np.exp(level) * rng.standard_normal((windows, frames, 6, 3))


def _gate_examples(
    networks: Networks, rows: Rows, place: tuple[int, int], data: TrainingWindows, seed: int
) -> Examples:
    """Every eighth window of a recording as the gate would see it online, from a clean and from a noisy sensor."""
    part, examples = data.take(rows), []
    for each in (part, _noisy_recording(part, generator(seed, 2, *place))):
        for row, output, window in _followed(networks, None, each):
            if row % 8 == 0:
                made = (output.forecasts[:, JUDGED] - window[-1]).astype(np.float32)
                came = (each.future[row, JUDGED] - window[-1]).astype(np.float32)
                inputs = output.inputs.errors.astype(np.float32), output.inputs.window.astype(np.float32)
                examples.append((*inputs, made, came, each.collection[row]))
    return tuple(map(np.stack, zip(*examples, strict=True)))


def _gate(examples: Sequence[Examples], steps: int, seed: int) -> Gate:
    errors, looks, forecasts, futures, collection = map(np.concatenate, zip(*examples, strict=True))
    rows = _evenly(collection, seed)
    return fit_gate(errors[rows], looks[rows], forecasts[rows], futures[rows], steps, JUDGED, seed)


def _evenly(collection: Int[np.ndarray, " B"], seed: int) -> Rows:
    """As many rows as there are, drawn so that each collection counts by the root of its size."""
    _, which, count = np.unique(collection, return_inverse=True, return_counts=True)
    shares = count[which] ** -0.5
    return np.random.default_rng(seed).choice(len(which), len(which), p=shares / shares.sum())


def _noisy_recording(windows: TrainingWindows, rng: np.random.Generator) -> TrainingWindows:
    """One recording's windows as a noisier sensor would have given them: the same noise wherever a frame appears."""
    frames, steps = windows.observed.shape[1], windows.future.shape[1]
    first = windows.frame.min() - frames + 1
    length = int(windows.frame.max() + steps - first + 1)
    noise = _white_noise(rng, RECORDING_NOISE, 1, length)[0]
    seen = (windows.frame - first)[:, None] + np.arange(1 - frames, 1)
    ahead = (windows.frame - first)[:, None] + np.arange(1, steps + 1)
    return replace(windows, observed=windows.observed + noise[seen], future=windows.future + noise[ahead])


def _error_examples(networks: Networks, rows: Rows, data: TrainingWindows, gate: Gate) -> Examples:
    """Errors of the mixture on a recording in each arm's own axes, features of the error model, collection."""
    part, examples = data.take(rows), []
    for row, output, window in _followed(networks, gate, part):
        own = (part.future[row] - output.mean) @ yaw_frame(window[-1])
        examples.append(
            (np.einsum("tjd,jde->tje", own, SIDES).astype(np.float32), output.features, part.collection[row])
        )
    return tuple(map(np.stack, zip(*examples, strict=True)))


def _error_model(examples: Sequence[Examples], seed: int) -> ErrorModel:
    errors, features, collection = map(np.concatenate, zip(*examples, strict=True))
    rows = _evenly(collection, seed)
    return fit_error_model(errors[rows], features[rows], seed)


def _followed(
    networks: Networks, gate: Gate | None, windows: TrainingWindows
) -> Iterator[tuple[int, MixtureOutput, Float[np.ndarray, "N 6 3"]]]:
    """One recording frame by frame, as online: row, what the mixture says, window."""
    steps, before = windows.future.shape[1], int(windows.frame[0]) - LONGEST_PAUSE - 2
    for row, frame in enumerate(windows.frame.tolist()):
        if row % AT_ONCE == 0:
            made, seen = forecasts(networks, windows.observed[row : row + AT_ONCE], steps)
        if frame - before - 1 > LONGEST_PAUSE:
            mixture, before = OnlineMixture(gate, len(networks), steps, regresses=gate is not None), frame - 1
        mixture.skip(frame - before - 1)
        window, at = windows.observed[row], row % AT_ONCE
        yield row, mixture.step(window, window[-1], made[at], seen[at]), window
        before = frame
