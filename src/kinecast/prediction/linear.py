"""Trivial and linear predictors: every mean is a linear map of the window, fitted where it has anything to fit.

They predict D coordinates at once, positions or posture coordinates alike: a window (N, D) in, a mean (T, D) out.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from itertools import product
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float, Int

from kinecast.errors import ModelError
from kinecast.prediction.mixer import mixer_from_arrays
from kinecast.prediction.model_file import Arrays, shaped

Windows = Float[np.ndarray, "W N D"]
Futures = Float[np.ndarray, "W T D"]

TIME_CONSTANTS = np.array(
    [0.02, 0.04, 0.06, 0.08, 0.1, 0.13, 0.16, 0.2, 0.25, 0.3, 0.4, 0.5, 0.7, 1.0, 1.5, 2.5, 5.0, 20.0]
)
"""Time constants tried for the damped velocity [s]."""

NOISE_RATIOS = 10.0 ** np.arange(-4.0, 4.25, 0.25)
"""Ratios q/r tried for the Kalman filter, per frame cubed."""

RIDGES = 10.0 ** np.arange(-4.0, 5.0)
"""Ridge penalties tried, relative to standardised features."""


@runtime_checkable
class MeanModel(Protocol):
    """The expected next T values of D coordinates from their last N."""

    def mean(self, windows: Windows) -> Futures:
        """(W, N, D) windows in, (W, T, D) means out."""
        ...

    def to_arrays(self) -> dict[str, np.ndarray]:
        """The arrays that describe it."""
        ...


@dataclass(frozen=True)
class WindowFilter(Arrays):
    """The same weights over the window for every coordinate: mean[t] = Σ_n weights[t, n] · window[n].

    Each row of weights sums to one, so the prediction moves along with the person.
    """

    weights: Float[np.ndarray, "T N"]

    def mean(self, windows: Windows) -> Futures:
        return np.einsum("tn,wnd->wtd", self.weights, windows)


@dataclass(frozen=True)
class LinearMap(Arrays):
    """mean = last + ((features − centre) / scale) · matrix.

    The features are the window relative to its last frame, then the last frame itself.
    """

    centre: Float[np.ndarray, " F"]
    scale: Float[np.ndarray, " F"]
    matrix: Float[np.ndarray, "F1 TD"]

    @staticmethod
    def features(windows: Windows) -> Float[np.ndarray, "W F"]:
        """(W, F) the window's earlier frames relative to its last one, then the last one."""
        last = windows[:, -1:]
        return np.concatenate([(windows[:, :-1] - last).reshape(len(windows), -1), last[:, 0]], axis=1)

    def mean(self, windows: Windows) -> Futures:
        standard = (self.features(windows) - self.centre) / self.scale
        displacement = standard @ self.matrix[:-1] + self.matrix[-1]
        return windows[:, -1:] + displacement.reshape(len(windows), -1, windows.shape[2])


def mean_from_arrays(arrays: Mapping[str, np.ndarray], frames: int, steps: int, size: int) -> MeanModel:
    """The mean model of N frames, T steps and D coordinates that `to_arrays` described; ModelError for any other."""
    if "gain" in arrays:
        return mixer_from_arrays(arrays, frames, steps, size)
    if "weights" in arrays:
        return WindowFilter(shaped(arrays, "weights", steps, frames))
    if {"centre", "scale", "matrix"} <= set(arrays):
        features = frames * size
        scale, matrix = shaped(arrays, "scale", features), shaped(arrays, "matrix", features + 1, steps * size)
        if not (scale > 0).all():
            raise ModelError("array scale holds values that are not above 0")
        return LinearMap(shaped(arrays, "centre", features), scale, matrix)
    raise ModelError(
        f"mean model with arrays {sorted(arrays)}; expected weights, or centre, scale and matrix, or those of a mixer"
    )


def zero_velocity(frames: int, steps: int) -> WindowFilter:
    """Nothing moves."""
    return damped(np.zeros(frames), np.inf, steps)


def constant_velocity(frames: int, steps: int) -> WindowFilter:
    """The velocity over the last two intervals goes on; over one alone it is mostly noise."""
    return damped(_difference(frames, 2), np.inf, steps)


def damped_velocity(windows: Windows, futures: Futures, dt: float) -> WindowFilter:
    """x + v·τ(1 − exp(−t/τ)): velocity estimator and time constant τ both fitted on training data.

    Estimators tried: the last interval, the last two, the slope of a line and of a parabola over the window. The pair
    with the least mean point error over the first half second is taken: there the baseline is as strong as it can be.
    """
    frames, steps = windows.shape[1], futures.shape[1]
    near = futures[:, : max(round(0.5 / dt), 1)]
    estimators = [_difference(frames, 1), _difference(frames, 2), slope_weights(frames, 1), slope_weights(frames, 2)]

    def error(fading: tuple[Float[np.ndarray, " N"], float]) -> float:
        return _mean_point_error(damped(*fading, near.shape[1]).mean(windows), near)

    velocity, tau = min(product(estimators, TIME_CONSTANTS / dt), key=error)
    return damped(velocity, tau, steps)


def kalman(windows: Windows, futures: Futures) -> WindowFilter:
    """Constant-velocity Kalman filter run over the window; its noise ratio fitted on training data.

    State (value, velocity), white acceleration of spectral density q, measurement noise r. Only q/r shapes
    the mean; it is the one with the least squared one-step innovation error on the windows.
    """
    frames, steps = windows.shape[1], futures.shape[1]
    filters = [kalman_filter(frames, steps, ratio) for ratio in NOISE_RATIOS]
    return min(filters, key=lambda model: float(np.mean((model.mean(windows)[:, 0] - futures[:, 0]) ** 2)))


def damped(velocity: Float[np.ndarray, " N"], tau: float, steps: int) -> WindowFilter:
    """Last value + v·τ(1 − exp(−t/τ)), the velocity v [per frame] as weights over the window; τ in frames, inf: v·t."""
    ahead = np.arange(1.0, steps + 1)
    weights = np.outer(ahead if np.isinf(tau) else -tau * np.expm1(-ahead / tau), velocity)
    weights[:, -1] += 1.0
    return WindowFilter(weights)


def _difference(frames: int, intervals: int) -> Float[np.ndarray, " N"]:
    """Weights of the mean velocity over the last intervals, per frame."""
    intervals = min(intervals, frames - 1)
    velocity = np.zeros(frames)
    velocity[-1], velocity[-1 - intervals] = 1.0, -1.0
    return velocity / intervals


@cache
def slope_weights(frames: int, degree: int) -> Float[np.ndarray, " N"]:
    """Weights of the slope at the last frame of a least-squares polynomial over the window."""
    time = np.arange(1.0 - frames, 1.0)
    return np.asarray(np.linalg.pinv(np.vander(time, degree + 1, increasing=True))[1])


def kalman_filter(frames: int, steps: int, ratio: float) -> WindowFilter:
    """The filter's prediction as weights of each measurement; unit time step, r = 1, q = ratio."""
    transition = np.array([[1.0, 1.0], [0.0, 1.0]])
    process = ratio * np.array([[1 / 3, 1 / 2], [1 / 2, 1.0]])
    # The first two frames fix the state exactly; its covariance follows from r = 1 on each of them.
    state = np.zeros((2, frames))
    state[0, 1], state[1, 0], state[1, 1] = 1.0, -1.0, 1.0
    covariance = np.array([[1.0, 1.0], [1.0, 2.0 + ratio / 3]])
    for k in range(2, frames):
        state = transition @ state
        covariance = transition @ covariance @ transition.T + process
        gain = covariance[:, 0] / (covariance[0, 0] + 1.0)
        innovation = -state[0]
        innovation[k] += 1.0
        state = state + np.outer(gain, innovation)
        covariance = covariance - np.outer(gain, covariance[0])
    return WindowFilter(state[0] + np.arange(1, steps + 1)[:, None] * state[1])


def fit_ridge(windows: Windows, futures: Futures, folds: Int[np.ndarray, " W"]) -> LinearMap:
    """Ridge regression from the window to the displacement at every step.

    The penalty is the one with the least mean point error on left-out folds.
    """
    features = LinearMap.features(windows)
    targets = (futures - windows[:, -1:]).reshape(len(windows), -1)
    names, penalty = np.unique(folds), 1.0
    if len(names) > 1:
        errors = np.zeros(len(RIDGES))
        for name in names:
            inside, outside = folds != name, folds == name
            for k, model in enumerate(_ridges(features[inside], targets[inside], RIDGES)):
                errors[k] += _mean_point_error(model.mean(windows[outside]), futures[outside]) * outside.sum()
        penalty = RIDGES[int(np.argmin(errors))]
    return _ridges(features, targets, np.array([penalty]))[0]


def _ridges(
    features: Float[np.ndarray, "W F"], targets: Float[np.ndarray, "W TD"], penalties: Float[np.ndarray, " K"]
) -> list[LinearMap]:
    """One model per penalty from a single eigendecomposition of the features' covariance."""
    centre, scale = features.mean(axis=0), features.std(axis=0)
    scale = np.where(scale > 1e-9, scale, 1.0)
    standard = (features - centre) / scale
    offset = targets.mean(axis=0)
    values, vectors = np.linalg.eigh(standard.T @ standard)
    rotated = vectors.T @ (standard.T @ (targets - offset))
    return [
        LinearMap(centre, scale, np.vstack([vectors @ (rotated / (np.maximum(values, 0.0) + p)[:, None]), offset]))
        for p in penalties
    ]


def _mean_point_error(mean: Futures, futures: Futures) -> float:
    """Mean distance between predicted and true points, coordinates taken three at a time."""
    error = (mean - futures).reshape(*mean.shape[:2], -1, 3)
    return float(np.linalg.norm(error, axis=-1).mean())
