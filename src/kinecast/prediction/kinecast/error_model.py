"""How far the truth strays from the mean: a scale mixture of Gaussians over all steps and joints at once.

The error of a joint at a step, in the arm's own axes, is scale · shape · z: a scale that depends on the window, a fixed
3 × 3 shape, and z, a vector of unit spread. The z of all steps and joints share one low-rank correlation, smooth in
time, so that samples are whole motions, and one common factor, drawn anew for each sample. How often that factor is
small or large depends on the window too: who rests mostly stays, but may start.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from functools import cached_property
from typing import Any, TypeAlias

import numpy as np
from jaxtyping import Float, Int

from kinecast.geometry.transforms import lengths
from kinecast.prediction.descent import descend
from kinecast.prediction.kinecast.experts import MIRROR, TRIVIAL, WindowMotion
from kinecast.prediction.kinecast.weights import JOINT_TYPE, GateInputs, step_basis
from kinecast.prediction.model_file import Arrays

FIT_ROUNDS = 3
"""Of robust regression of the log error."""
FIT_STEPS, FIT_BATCH, FIT_RATE, FIT_DECAY = 1200, 512, 0.02, 5e-3
"""Of the descent from there to the maximum likelihood of scale and common factor."""
FINEST = 1e-3
"""Errors below this are the luck of a resting tracker that repeats itself: they are not learned from [m]."""
TOGETHER = 0.8
"""Share of the likelihood that is of whole poses; the rest is of each joint for itself."""
REACHED, CEILING, STRAYS = 0.999, 0.75, 3.0
"""Share of errors within `reach`; how much of it the scale may be, and how far drawn motions stray."""
SMOOTH = 5
"""Functions of time that a drawn motion's departure from the mean is made of."""
TAIL = 4.0
"""Degrees of freedom of the Student t under which shapes are found: heavy tails do not bend them."""
RANK = 60
"""Directions kept of the correlation between all steps and joints."""

SPEEDS = (0.05, 0.3)
"""What parts joints that rest, slow and fast ones [m/s]."""
LEVEL = 0.8
"""The region whose coverage `AdaptiveScale` holds."""
RATE, FORGET = 0.1, 0.995
"""How fast the log of its factor moves with each miss, and how fast it returns to nothing."""
MOST = 1.5
"""Most that the log of its factor strays from zero."""

Errors: TypeAlias = Float[np.ndarray, "B T 6 3"]

SCALES = np.array([0.2, 0.35, 0.6, 1.0, 1.7, 3.0])
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
        slope: (3, T, F) log scale of each joint type and step from the features, where it is far below its ceiling.
        reach: (3, T) distance from the mean that one error in a thousand exceeds [m].
        shape: (3, T, 3, 3) lower factor of the error's covariance in the arm's axes.
        factor: (T, 6, 3, R) low-rank factor of the correlation of all z.
        rough: (T, 6, 3) share of z's spread that is not smooth in time: a sensor's noise, left out of drawn motions.
        tail: (F, K) logits of the common factors `SCALES` from the joints' mean features.
    """

    slope: Float[np.ndarray, "3 T F"]
    reach: Float[np.ndarray, "3 T"]
    shape: Float[np.ndarray, "3 T 3 3"]
    factor: Float[np.ndarray, "T 6 3 R"]
    rough: Float[np.ndarray, "T 6 3"]
    tail: Float[np.ndarray, "F K"]

    def scale(self, features: Float[np.ndarray, "6 F"]) -> Float[np.ndarray, "T 6"]:
        """(T, 6) scale of each joint's error."""
        inverse = np.exp(-np.einsum("jtf,jf->tj", self.slope[JOINT_TYPE], features))
        return 1.0 / (inverse + self._least_inverse)

    @property
    def farthest(self) -> Float[np.ndarray, "T 6"]:
        """(T, 6) how far from the mean a drawn motion goes [m]."""
        return STRAYS * self.reach[JOINT_TYPE].T

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
    def _least_inverse(self) -> Float[np.ndarray, "T 6"]:
        return _inverse_ceiling(self.reach, self.shape)[JOINT_TYPE].T

    @cached_property
    def _inverse_axes(self) -> Float[np.ndarray, "T 6 3 3"]:
        return np.linalg.inv(self._axes)


class AdaptiveScale:
    """Factors on the spread at each step, moved by whether the truth fell where it should (adaptive conformal).

    There is one for joints that rest, for slow and for fast ones. log factor ← forget · log factor + rate · (joints
    outside the region − (1 − level) · joints) / 6, each time a prediction comes due (Gibbs and Candès 2021, with leak).
    """

    def __init__(self, model: ErrorModel, steps: int, dt: float) -> None:
        self._model, self._edges = model, np.array(SPEEDS) * dt
        self._log = np.zeros((steps, len(SPEEDS) + 1))
        self._past: deque[tuple[Any, ...] | None] = deque(maxlen=steps)

    def factor(self, speed: Float[np.ndarray, "6"]) -> Float[np.ndarray, "T 6"]:
        """(T, 6) by which to multiply the spread of joints of these speeds [m per frame]."""
        return np.exp(self._log[:, np.searchsorted(self._edges, speed)])

    def skip(self, frames: int) -> None:
        """Frames of which nothing is known."""
        self._past.extend([None] * frames)

    def observe(self, pose: Float[np.ndarray, "6 3"]) -> None:
        """Judges what was predicted for this frame; NaN joints judge nothing. The newest was predicted one step ago."""
        known = [(step, *made) for step, made in enumerate(reversed(self._past)) if made is not None]
        if not known or not np.isfinite(pose).all():
            return
        due, means, scales, rotations, radii, bins = map(np.array, zip(*known, strict=True))
        rows = np.arange(len(due))
        z = self._model.whitened(pose - means[rows, due], scales[rows, due], rotations, due)
        reach = radii[:, None] * np.exp(np.take_along_axis(self._log[due], bins, axis=1))
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
        self._past.append((mean, scale, rotation, mixture_radius(weights, LEVEL), np.searchsorted(self._edges, speed)))


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
    sizes = np.linalg.norm(errors, axis=-1)
    reach = np.stack([np.quantile(sizes[:, :, kind == JOINT_TYPE], REACHED, axis=(0, 2)) for kind in range(3)])
    reach = np.maximum(reach, FINEST)
    least = _inverse_ceiling(reach, shape)
    slope, tail = _most_likely(slope, least, unit, features, seed)
    inverse = np.exp(-np.einsum("jtf,bjf->btj", slope[JOINT_TYPE], features)) + least[JOINT_TYPE].T
    return ErrorModel(slope, reach, shape, *_correlation(unit * inverse[..., None]), tail)


def _inverse_ceiling(reach: Float[np.ndarray, "3 T"], shape: Float[np.ndarray, "3 T 3 3"]) -> Float[np.ndarray, "3 T"]:
    """(3, T) one over the largest scale: no error is expected to be larger than people were ever wrong about."""
    return np.cbrt(np.linalg.det(shape)) / (CEILING * reach)


def _most_likely(
    slope: Float[np.ndarray, "3 T F"],
    inverse_ceiling: Float[np.ndarray, "3 T"],
    unit: Errors,
    features: Float[np.ndarray, "B 6 F"],
    seed: int,
) -> tuple[Float[np.ndarray, "3 T F"], Float[np.ndarray, "F K"]]:
    """Scales and common factors of maximum likelihood, of joints and of whole poses, each step for itself.

    Added to the scale is what varies smoothly with the step; `unit` are errors over their shape [m].
    """
    steps, basis = unit.shape[1], step_basis(unit.shape[1])
    white = unit / np.exp(np.einsum("jtf,bjf->btj", slope[JOINT_TYPE], features))[..., None]
    poses = _alike(white).reshape(len(unit), steps, 18)
    covariance = np.einsum("bti,btj->tij", poses, poses, optimize=True) / len(poses)
    spread = np.sqrt(np.einsum("tii->ti", covariance))
    correlation = covariance / spread[:, :, None] / spread[:, None] + FINEST * np.eye(18)
    decorrelate = np.linalg.inv(np.linalg.cholesky(correlation))

    def loss(jax, parameters, rows, _key):  # type: ignore[no-untyped-def]
        jnp = jax.numpy
        more, tail = parameters
        unit, look = rows
        slopes = slope + jnp.einsum("jkf,tk->jtf", more, basis)
        log_scale = -jnp.einsum("jtf,bjf->btj", slopes[JOINT_TYPE], look)
        log_scale = -jnp.logaddexp(log_scale, np.log(inverse_ceiling[JOINT_TYPE].T))
        log_weights = jax.nn.log_softmax(look.mean(axis=1) @ tail)[:, None]
        z = unit * jnp.exp(-log_scale)[..., None]
        least = FINEST**2 * jnp.exp(-2.0 * log_scale)
        joint = ((z**2).sum(-1) + least)[..., None] / SCALES**2
        joint = jax.nn.logsumexp(log_weights[:, None] - 0.5 * joint - 3.0 * jnp.log(SCALES), axis=-1)
        pose = jnp.einsum("tij,btj->bti", decorrelate, z.reshape(-1, steps, 18))
        pose = ((pose**2).sum(-1) + least.sum(-1))[..., None] / SCALES**2
        pose = jax.nn.logsumexp(log_weights - 0.5 * pose - 18.0 * jnp.log(SCALES), axis=-1)
        likelihood = (1.0 - TOGETHER) * joint.mean() + TOGETHER * pose.mean() / 6.0 - 3.0 * log_scale.mean()
        return -likelihood + FIT_DECAY * ((more**2).sum() + (tail**2).sum())

    start = [np.zeros((3, basis.shape[1], features.shape[2])), np.zeros((features.shape[2], len(SCALES)))]
    more, tail = descend(
        loss, start, (unit, features), steps=FIT_STEPS, batch=FIT_BATCH, rate=FIT_RATE, decay=0.0, second=0.99,
        seed=seed,
    )  # fmt: skip
    return slope + np.einsum("jkf,tk->jtf", more, basis), tail


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

    What is not smooth is the sensor's noise, not the person's motion.
    """
    steps = white.shape[1]
    white = _alike(white)
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


def _alike(white: Errors) -> Errors:
    """Every example at unit spread, however large its error: its common factor is divided out."""
    return white / np.sqrt((white**2).mean(axis=(1, 2, 3), keepdims=True) + 1e-9)
