"""Fits the spread on errors that the means made on recordings they had not seen."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from kinecast.prediction.kinecast.gate import JOINT_TYPE
from kinecast.prediction.kinecast.spread import SCALES, Spread, mixture_radius

__all__ = ["fit_spread"]

ROUNDS = 3
"""Of robust regression of the log error."""
TAIL = 4.0
"""Degrees of freedom of the Student t under which shapes are found: heavy tails do not bend them."""
RANK = 60
"""Directions kept of the correlation between all steps and joints."""
LEVELS = (0.5, 0.8, 0.9, 0.95)
"""Where the conformal correction is matched."""


def fit_spread(
    errors: Float[np.ndarray, "B T 6 3"], features: Float[np.ndarray, "B 6 F"], speeds: Float[np.ndarray, "B 6"]
) -> Spread:
    """Scale, shape, correlation, common factor and conformal correction, in this order.

    Args:
        errors: of the mean, in each arm's own axes [m].
        features: of `spread_features`.
        speeds: of the joints in the window [m per frame].
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
    return Spread(slope, shape, _correlation(white), weights, edges, _conformal(white, speeds, edges, weights))


def _log_scale(table: Float[np.ndarray, "B F"], target: Float[np.ndarray, "B T"]) -> Float[np.ndarray, "T F"]:
    """Robust linear regression of the log error, each step for itself."""
    ridge = 1e-3 * len(table) * np.eye(table.shape[1])
    slope = np.linalg.solve(table.T @ table + ridge, table.T @ target).T
    for _ in range(ROUNDS):
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


def _correlation(white: Float[np.ndarray, "B T 6 3"]) -> Float[np.ndarray, "T 6 3 R"]:
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


def _conformal(
    white: Float[np.ndarray, "B T 6 3"],
    speeds: Float[np.ndarray, "B 6"],
    edges: Float[np.ndarray, "2"],
    weights: Float[np.ndarray, " K"],
) -> Float[np.ndarray, "3 T 3"]:
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
