"""How far the truth strays from the mean: a scale mixture of Gaussians over all steps and joints at once.

The error of a joint at a step, in the arm's own axes, is scale · shape · z: a scale that depends on the window, a fixed
3 × 3 shape, and z, a vector of unit spread. The z of all steps and joints share one low-rank correlation, so that
samples are whole motions, and one common factor, drawn anew for each sample, that gives them their heavy tails.
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

LEVEL = 0.8
"""The region whose coverage is held."""
RATE, FORGET = 0.1, 0.995
"""How fast the log of the factor moves with each miss, and how fast it returns to nothing."""
MOST = 1.0
"""Most that the log of the factor strays from zero."""
FIT_ROUNDS = 3
"""Of robust regression of the log error."""
TAIL = 4.0
"""Degrees of freedom of the Student t under which shapes are found: heavy tails do not bend them."""
RANK = 60
"""Directions kept of the correlation between all steps and joints."""
LEVELS = (0.5, 0.8, 0.9, 0.95)
"""Where the conformal correction is matched."""

Errors: TypeAlias = Float[np.ndarray, "B T 6 3"]
Speeds: TypeAlias = Float[np.ndarray, "B 6"]

SCALES = np.array([0.3, 0.6, 1.0, 1.7, 3.0, 6.0])
"""The common factors of the mixture; their weights are fitted."""
SIDES = np.stack([np.eye(3)] * 3 + [np.diag(MIRROR)] * 3)
"""(6, 3, 3) from the arm's own axes to the person's: the right arm was seen in a mirror."""


def mixture_radius(weights: Float[np.ndarray, " K"], level: float) -> float:
    """Radius that holds a share of a three-dimensional scale mixture of unit normals."""

    low, high = 0.0, 60.0
    for _ in range(60):
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
    apart = lengths(forecasts[TRIVIAL:] - mean).mean(axis=(0, 1))
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
        weights: (K,) of the common factors `SCALES`.
        edges: (2,) speeds that part the three bins [m per frame].
        conformal: (3, T, 3) correction per joint type, step and speed bin.
    """

    slope: Float[np.ndarray, "3 T F"]
    shape: Float[np.ndarray, "3 T 3 3"]
    factor: Float[np.ndarray, "T 6 3 R"]
    weights: Float[np.ndarray, " K"]
    edges: Float[np.ndarray, "2"]
    conformal: Float[np.ndarray, "3 T 3"]

    def scale(self, features: Float[np.ndarray, "6 F"], speed: Float[np.ndarray, "6"]) -> Float[np.ndarray, "T 6"]:
        """(T, 6) scale of each joint's error, conformal correction included; speeds in [m per frame]."""
        log_scale = np.einsum("jtf,jf->tj", self.slope[JOINT_TYPE], features)
        bins = np.searchsorted(self.edges, speed, side="right")
        return np.exp(log_scale) * self.conformal[JOINT_TYPE, :, bins].T

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
    def radius(self) -> float:
        """Of the region that holds `LEVEL` of all z."""
        return mixture_radius(self.weights, LEVEL)

    @cached_property
    def _axes(self) -> Float[np.ndarray, "T 6 3 3"]:
        """Maps from z to the error over its scale, in the person's axes."""
        return SIDES @ self.shape[JOINT_TYPE].transpose(1, 0, 2, 3)

    @cached_property
    def _inverse_axes(self) -> Float[np.ndarray, "T 6 3 3"]:
        return np.linalg.inv(self._axes)


class AdaptiveScale:
    """A factor on the spread at each step, moved by whether the truth fell where it should (adaptive conformal).

    log factor ← forget · log factor + rate · (share of joints outside the region − (1 − level)), each time a prediction
    comes due (Gibbs and Candès 2021, with leak).
    """

    def __init__(self, model: ErrorModel, steps: int) -> None:
        self._model = model
        self._log = np.zeros(steps)
        self._means = np.zeros((steps, steps, 6, 3))
        self._scales = np.ones((steps, steps, 6))
        self._rotations = np.zeros((steps, 3, 3))
        self._known = np.zeros(steps, dtype=np.bool_)
        self._newest = 0

    @property
    def factor(self) -> Float[np.ndarray, " T"]:
        """(T,) by which to multiply the spread."""
        return np.exp(self._log)

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
        reach = self._model.radius * np.exp(self._log[due])
        missed = ((z**2).sum(axis=-1) > reach[:, None] ** 2).mean(axis=1)
        moved = FORGET * self._log[due] + RATE * (missed - (1.0 - LEVEL))
        self._log[due] = np.clip(moved, -MOST, MOST)

    def predicted(
        self, mean: Float[np.ndarray, "T 6 3"], scale: Float[np.ndarray, "T 6"], rotation: Float[np.ndarray, "3 3"]
    ) -> None:
        """Keeps what is predicted from this frame on: mean [m], scale, and the rotation of the person's axes."""
        self.skip(1)
        self._known[self._newest] = True
        self._means[self._newest], self._scales[self._newest], self._rotations[self._newest] = mean, scale, rotation


def fit_error_model(errors: Errors, features: Float[np.ndarray, "B 6 F"], speeds: Speeds) -> ErrorModel:
    """Scale, shape, correlation, common factor and conformal correction, in this order.

    From errors of the mean in each arm's own axes [m], `error_features`, and speeds of the joints [m per frame].
    """
    steps, inputs = errors.shape[1], features.shape[2]
    slope = np.zeros((3, steps, inputs))
    shape = np.zeros((3, steps, 3, 3))
    white = np.zeros_like(errors)
    for kind in range(3):
        joints = np.flatnonzero(kind == JOINT_TYPE)
        table = features[:, joints].reshape(-1, inputs)
        own = errors[:, :, joints].transpose(0, 2, 1, 3).reshape(-1, steps, 3)
        slope[kind] = _log_scale(table, np.log(np.linalg.norm(own, axis=-1) + 1e-4))
        unit = own / np.exp(table @ slope[kind].T)[..., None]
        for t in range(steps):
            shape[kind, t] = np.linalg.cholesky(_shape(unit[:, t]))
            solved = np.linalg.solve(shape[kind, t], unit[:, t].T).T
            white[:, t, joints] = solved.reshape(len(errors), len(joints), 3)
    weights = _common_factor((white**2).sum(axis=-1).ravel())
    edges = np.quantile(speeds, [1 / 3, 2 / 3])
    return ErrorModel(slope, shape, _correlation(white), weights, edges, _conformal(white, speeds, edges, weights))


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


def _common_factor(square: Float[np.ndarray, " B"]) -> Float[np.ndarray, " K"]:
    """Weights of the common factors: maximum likelihood of the squared radii in three dimensions, by EM."""
    some = square[:: max(len(square) // 200_000, 1)]
    log_density = -0.5 * some[:, None] / SCALES**2 - 3.0 * np.log(SCALES)
    weights = np.full(len(SCALES), 1.0 / len(SCALES))
    for _ in range(60):
        share = weights * np.exp(log_density - log_density.max(axis=1, keepdims=True))
        weights = (share / share.sum(axis=1, keepdims=True)).mean(axis=0)
    return weights / weights.sum()


def _correlation(white: Errors) -> Float[np.ndarray, "T 6 3 R"]:
    """Leading directions of the correlation, rescaled so that each number keeps unit spread.

    Every example counts alike, however large its error: its common factor is divided out first.
    """
    flat = white.reshape(len(white), -1)
    flat = flat / np.sqrt((flat**2).mean(axis=1, keepdims=True) + 1e-9)
    covariance = flat.T @ flat / len(flat)
    spread = np.sqrt(np.diag(covariance))
    values, vectors = np.linalg.eigh(covariance / np.outer(spread, spread))
    kept = min(RANK, len(values))
    factor = vectors[:, -kept:] * np.sqrt(np.maximum(values[-kept:], 0.0))
    factor /= np.linalg.norm(factor, axis=1, keepdims=True)
    return factor.reshape(*white.shape[1:], kept)


def _conformal(white: Errors, speeds: Speeds, edges: np.ndarray, weights: np.ndarray) -> Float[np.ndarray, "3 T 3"]:
    """Per joint type, step and speed bin: by how much regions must grow to hold what they should."""
    radius = np.linalg.norm(white, axis=-1)
    bins = np.digitize(speeds, edges)
    expected = np.array([mixture_radius(weights, level) for level in LEVELS])
    result = np.ones((3, white.shape[1], 3))
    for kind in range(3):
        joints = np.flatnonzero(kind == JOINT_TYPE)
        for each in range(3):
            chosen = bins[:, joints] == each
            if chosen.sum() < 200:
                continue
            found = np.quantile(radius[:, :, joints].transpose(1, 0, 2)[:, chosen], LEVELS, axis=1)
            result[kind, :, each] = np.exp(np.log(found / expected[:, None]).mean(axis=0))
    return result
