"""How far the truth strays from the mean: a scale mixture of Gaussians over all steps and joints at once.

The error of a joint at a step, in the arm's own axes, is scale · shape · z: a scale that depends on the window, a fixed
3 × 3 shape, and z, a vector of unit spread. The z of all steps and joints share one low-rank correlation, smooth in
time, so that samples are whole motions, and one common factor, drawn anew for each sample. How often that factor is
small or large depends on the window too: who rests mostly stays, but may start.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import TypeAlias

import numpy as np
from jaxtyping import Float, Int

from kinecast.geometry.transforms import lengths
from kinecast.prediction.kinecast.experts import TRIVIAL
from kinecast.prediction.kinecast.features import MIRROR, WindowMotion
from kinecast.prediction.kinecast.weights import JOINT_TYPE, GateInputs
from kinecast.prediction.model_file import Arrays

SPEEDS = (0.05, 0.3)
"""What parts joints that rest, slow and fast ones [m/s]."""
LEVEL = 0.8
"""The region whose coverage is held."""
RATE, FORGET = 0.1, 0.995
"""How fast the log of the factor moves with each miss, and how fast it returns to nothing."""
MOST = 1.5
"""Most that the log of the factor strays from zero."""
FIT_ROUNDS = 3
"""Of robust regression of the log error."""
FIT_STEPS, FIT_BATCH, FIT_RATE, FIT_DECAY = 1200, 512, 0.02, 1e-3
"""Of the descent from there to the maximum likelihood of scale and common factor."""
SMOOTH = 7
"""Functions of time that a drawn motion's departure from the mean is made of."""
TAIL = 4.0
"""Degrees of freedom of the Student t under which shapes are found: heavy tails do not bend them."""
RANK = 60
"""Directions kept of the correlation between all steps and joints."""

Errors: TypeAlias = Float[np.ndarray, "B T 6 3"]

SCALES = np.array([0.3, 0.6, 1.0, 1.6, 2.5, 4.0])
"""The common factors of the mixture; their weights depend on the window."""
SIDES = np.stack([np.eye(3)] * 3 + [np.diag(MIRROR)] * 3)
"""(6, 3, 3) from the arm's own axes to the person's: the right arm was seen in a mirror."""


def mixture_radius(weights: Float[np.ndarray, " K"], level: float) -> float:
    """Radius that holds a share of a three-dimensional scale mixture of unit normals."""

    low, high = 0.0, 60.0
    for _ in range(24):
        middle = 0.5 * (low + high)
        radii = (middle / SCALES).tolist()
        ball = [math.erf(r / math.sqrt(2.0)) - math.sqrt(2.0 / math.pi) * r * math.exp(-0.5 * r * r) for r in radii]
        low, high = (middle, high) if weights @ ball < level else (low, middle)
    return low


def error_features(
    window: Float[np.ndarray, "N 6 3"],
    motion: WindowMotion,
    forecasts: Float[np.ndarray, "E T 6 3"],
    mean: Float[np.ndarray, "T 6 3"],
    gate: GateInputs,
    due: Float[np.ndarray, "6 L"],
) -> Float[np.ndarray, "6 F"]:
    """(6, F) what the scale depends on, joint by joint: the window, its motion, what experts and mixture forecast [m],
    the gate's inputs, and the mean error of the mixture come due lately [m], NaN while unknown.
    """
    learned = forecasts[TRIVIAL:] if len(forecasts) > TRIVIAL else forecasts
    apart = lengths(learned - mean).mean(axis=(0, 1))
    unknown = np.isnan(due)
    features = np.empty((6, 10 + due.shape[1]))
    features[:, 0] = 1.0
    for column, value in enumerate((motion.speed, motion.change, apart)):
        features[:, 1 + column] = np.log(value + 0.001) + 4.0
    features[:, 4:8] = gate.window[:, :4]
    features[:, 8:-2] = np.log(due + 0.002) + 3.5
    features[:, 8:-2][unknown] = 0.0
    features[:, -2] = ~unknown[:, 0]
    features[:, -1] = np.log(lengths(mean[len(mean) // 2] - window[-1]) + 0.003) + 3.0
    return features


@dataclass(frozen=True)
class ErrorModel(Arrays):
    """Fitted on errors of recordings that the means were not trained on.

    Attributes:
        slope: (3, T, F) log scale of each joint type and step from the features.
        shape: (3, T, 3, 3) lower factor of the error's covariance in the arm's axes.
        factor: (T, 6, 3, R) low-rank factor of the correlation of all z.
        rough: (T, 6, 3) share of z's spread that is not smooth in time: a sensor's noise, left out of drawn motions.
        tail: (F, K) logits of the common factors `SCALES` from the joints' mean features.
    """

    slope: Float[np.ndarray, "3 T F"]
    shape: Float[np.ndarray, "3 T 3 3"]
    factor: Float[np.ndarray, "T 6 3 R"]
    rough: Float[np.ndarray, "T 6 3"]
    tail: Float[np.ndarray, "F K"]

    def scale(self, features: Float[np.ndarray, "6 F"]) -> Float[np.ndarray, "T 6"]:
        """(T, 6) scale of each joint's error."""
        return np.exp(np.einsum("jtf,jf->tj", self.slope[JOINT_TYPE], features))

    def weights(self, features: Float[np.ndarray, "6 F"]) -> Float[np.ndarray, " K"]:
        """(K,) of the common factors; they sum to one."""
        logits = features.mean(axis=0) @ self.tail
        weights = np.exp(logits - logits.max())
        return weights / weights.sum()

    def factor_in(
        self, scale: Float[np.ndarray, "T 6"], rotation: Float[np.ndarray, "3 3"]
    ) -> Float[np.ndarray, "T 6 3 R"]:
        """(T, 6, 3, R) factor of the error's covariance [m], where `rotation` takes the person's axes."""
        return (scale[..., None, None] * (rotation @ self._axes)) @ self.factor

    def whitened(
        self,
        error: Float[np.ndarray, "K 6 3"],
        scale: Float[np.ndarray, "K 6"],
        rotation: Float[np.ndarray, "K 3 3"],
        steps: Int[np.ndarray, " K"],
    ) -> Float[np.ndarray, "K 6 3"]:
        """(K, 6, 3) z of errors [m] in the world at some of the steps; rotations take the person's axes there."""
        own = self._inverse_axes[steps] @ (error @ rotation)[..., None]
        return own[..., 0] / scale[..., None]

    @cached_property
    def _axes(self) -> Float[np.ndarray, "T 6 3 3"]:
        """Maps from z to the error over its scale, in the person's axes."""
        return SIDES @ self.shape[JOINT_TYPE].transpose(1, 0, 2, 3)

    @cached_property
    def _inverse_axes(self) -> Float[np.ndarray, "T 6 3 3"]:
        return np.linalg.inv(self._axes)


class AdaptiveScale:
    """Factors on the spread at each step, moved by whether the truth fell where it should (adaptive conformal).

    There is one for joints that rest, for slow and for fast ones. log factor ← forget · log factor + rate · (joints
    outside the region − (1 − level) · joints) / 6, each time a prediction comes due (Gibbs and Candès 2021, with leak).
    """

    def __init__(self, model: ErrorModel, steps: int, dt: float) -> None:
        self._model = model
        self._edges = np.array(SPEEDS) * dt
        self._log = np.zeros((steps, len(SPEEDS) + 1))
        self._means = np.zeros((steps, steps, 6, 3))
        self._scales = np.ones((steps, steps, 6))
        self._rotations = np.zeros((steps, 3, 3))
        self._radii = np.ones(steps)
        self._bins = np.zeros((steps, 6), dtype=np.intp)
        self._known = np.zeros(steps, dtype=np.bool_)
        self._newest = 0

    def factor(self, speed: Float[np.ndarray, "6"]) -> Float[np.ndarray, "T 6"]:
        """(T, 6) by which to multiply the spread of joints of these speeds [m per frame]."""
        return np.exp(self._log[:, self._bins_of(speed)])

    def _bins_of(self, speed: Float[np.ndarray, "6"]) -> Int[np.ndarray, "6"]:
        return np.searchsorted(self._edges, speed)

    def skip(self, frames: int) -> None:
        """Frames of which nothing is known."""
        for _ in range(frames):
            self._newest = (self._newest + 1) % len(self._known)
            self._known[self._newest] = False

    def observe(self, pose: Float[np.ndarray, "6 3"]) -> None:
        """Judges what was predicted for this frame; NaN joints judge nothing. The newest was predicted one step ago."""
        if not np.isfinite(pose).all():
            return
        rows = (self._newest - np.arange(len(self._log))) % len(self._log)
        due = np.flatnonzero(self._known[rows])
        rows = rows[due]
        z = self._model.whitened(pose - self._means[rows, due], self._scales[rows, due], self._rotations[rows], due)
        bins = self._bins[rows]
        reach = self._radii[rows, None] * np.exp(np.take_along_axis(self._log[due], bins, axis=1))
        missed = ((z**2).sum(axis=-1) > reach**2) - (1.0 - LEVEL)
        for k in range(self._log.shape[1]):
            moved = self._log[due, k] + RATE * np.where(bins == k, missed, 0.0).mean(axis=1)
            self._log[due, k] = np.clip(np.where((bins == k).any(axis=1), FORGET * moved, moved), -MOST, MOST)

    def predicted(
        self,
        mean: Float[np.ndarray, "T 6 3"],
        scale: Float[np.ndarray, "T 6"],
        rotation: Float[np.ndarray, "3 3"],
        weights: Float[np.ndarray, " K"],
        speed: Float[np.ndarray, "6"],
    ) -> None:
        """Keeps what is predicted from this frame on.

        Mean [m], scale, rotation of the person's axes, weights of common factors, speed of the joints [m per frame].
        """
        self.skip(1)
        self._known[self._newest] = True
        self._radii[self._newest] = mixture_radius(weights, LEVEL)
        self._bins[self._newest] = self._bins_of(speed)
        self._means[self._newest], self._scales[self._newest], self._rotations[self._newest] = mean, scale, rotation


def fit_error_model(errors: Errors, features: Float[np.ndarray, "B 6 F"], seed: int = 0) -> ErrorModel:
    """The error model of errors that recordings left out of training had.

    Args:
        errors: (B, T, 6, 3) truth minus mean in each arm's own axes (right arm in a mirror) [m].
        features: (B, 6, F) of `error_features`.
        seed: of the descent.
    """
    steps = errors.shape[1]
    slope, shape = np.empty((3, steps, features.shape[2])), np.empty((3, steps, 3, 3))
    unit = np.empty(errors.shape)
    for kind in range(3):
        joints = np.flatnonzero(kind == JOINT_TYPE)
        table = features[:, joints].reshape(-1, features.shape[2])
        own = errors[:, :, joints].transpose(0, 2, 1, 3).reshape(-1, steps, 3)
        slope[kind] = _log_scale(table, np.log(np.linalg.norm(own, axis=-1) + 1e-4))
        scaled = own / np.exp(table @ slope[kind].T)[..., None]
        for t in range(steps):
            shape[kind, t] = np.linalg.cholesky(_shape(scaled[:, t]))
            solved = np.linalg.solve(shape[kind, t], own[:, t].T).T
            unit[:, t, joints] = solved.reshape(len(errors), len(joints), 3)
    square = np.einsum("btjd,btjd->btj", unit, unit) + 1e-8
    slope, tail = _most_likely(slope, square, features, seed)
    white = unit / np.exp(np.einsum("jtf,bjf->btj", slope[JOINT_TYPE], features))[..., None]
    return ErrorModel(slope, shape, *_correlation(white), tail)


def _most_likely(
    slope: Float[np.ndarray, "3 T F"],
    square: Float[np.ndarray, "B T 6"],
    features: Float[np.ndarray, "B 6 F"],
    seed: int,
) -> tuple[Float[np.ndarray, "3 T F"], Float[np.ndarray, "F K"]]:
    """Scales and common factors of maximum likelihood, joints and steps each for themselves; squared radii in [m²]."""
    from kinecast.prediction.descent import descend, jax_in_one_thread

    jax = jax_in_one_thread()
    import jax.numpy as jnp

    def loss(parameters, rows, _key):  # type: ignore[no-untyped-def]
        slope, tail = parameters
        radius, look = rows
        log_scale = jnp.einsum("jtf,bjf->btj", slope[JOINT_TYPE], look)
        log_weights = jax.nn.log_softmax(look.mean(axis=1) @ tail)[:, None, None]
        z = radius * jnp.exp(-2.0 * log_scale)
        log_density = log_weights - 0.5 * z[..., None] / SCALES**2 - 3.0 * jnp.log(SCALES)
        return (3.0 * log_scale - jax.nn.logsumexp(log_density, axis=-1)).mean() + FIT_DECAY * (tail**2).sum()

    start = [slope, np.zeros((features.shape[2], len(SCALES)))]
    slope, tail = descend(
        loss, start, (square, features), steps=FIT_STEPS, batch=FIT_BATCH, rate=FIT_RATE, decay=0.0, second=0.99,
        seed=seed,
    )  # fmt: skip
    return slope, tail


def _log_scale(table: Float[np.ndarray, "B F"], target: Float[np.ndarray, "B T"]) -> Float[np.ndarray, "T F"]:
    """Robust linear regression of the log error, each step for itself."""
    ridge = 1e-3 * len(table) * np.eye(table.shape[1])
    slope = np.linalg.solve(table.T @ table + ridge, table.T @ target).T
    for _ in range(FIT_ROUNDS):
        for t in range(target.shape[1]):
            weight = 1.0 / (1.0 + ((target[:, t] - table @ slope[t]) / 1.5) ** 2)
            weighted = table * weight[:, None]
            slope[t] = np.linalg.solve(weighted.T @ table + ridge, weighted.T @ target[:, t])
    return slope


def _shape(unit: Float[np.ndarray, "B 3"]) -> Float[np.ndarray, "3 3"]:
    """Scatter of a Student t about zero (fixed-point iteration of maximum likelihood)."""
    scatter = np.eye(3)
    for _ in range(8):
        square = np.einsum("bi,ij,bj->b", unit, np.linalg.inv(scatter), unit)
        scatter = ((TAIL + 3.0) / (TAIL + square))[:, None] * unit
        scatter = scatter.T @ unit / len(unit) + 1e-9 * np.eye(3)
    return scatter


def _correlation(white: Errors) -> tuple[Float[np.ndarray, "T 6 3 R"], Float[np.ndarray, "T 6 3"]]:
    """Leading directions of the correlation, smooth in time, at unit spread of each number, and what they leave out.

    Every example counts alike, however large its error: its common factor is divided out first. What of it is not
    smooth is the sensor's noise, not the person's motion.
    """
    steps = white.shape[1]
    white = white / np.sqrt((white**2).mean(axis=(1, 2, 3), keepdims=True) + 1e-9)
    early = np.sqrt(np.arange(1.0, steps + 1) / steps)  # errors change most in the first steps
    smooth = np.linalg.qr(np.cos(np.pi * np.outer(early, np.arange(min(SMOOTH, steps)))))[0]
    flat = np.einsum("tk,sk,bsjd->btjd", smooth, smooth, white, optimize=True).reshape(len(white), -1)
    spread = np.sqrt((white**2).mean(axis=0)).ravel()
    values, vectors = np.linalg.eigh(flat.T @ flat / len(flat) / np.outer(spread, spread))
    kept = min(RANK, len(values))
    factor = vectors[:, -kept:] * np.sqrt(np.maximum(values[-kept:], 0.0))
    held = np.linalg.norm(factor, axis=1, keepdims=True)
    rough = np.sqrt(np.maximum(1.0 - held**2, 0.0))
    return (factor / held).reshape(*white.shape[1:], kept), rough.reshape(white.shape[1:])
