"""The exact density of the horizon model at each step: a scale mixture of Gaussians, within what is allowed."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float
from scipy.linalg import solve_triangular
from scipy.special import logsumexp

from kinecast.prediction.allowance import Allowance
from kinecast.prediction.density import JOINT_ORDER, combine, fault_log_prob, log_allowed, whiten
from kinecast.prediction.goals import Pursuit
from kinecast.prediction.kinecast.spread import SCALES

__all__ = ["GoalMixtureDensity", "ScaleMixtureDensity"]

FLOOR = 5e-4
"""Least spread of a joint [m], for directions that the low-rank factor leaves out."""


@dataclass(frozen=True)
class ScaleMixtureDensity:
    """f(x) = Σ_k w_k N(x; mean, s_k² Σ) over the 18 coordinates of the six joints at each step.

    Attributes:
        mean: (T, 6, 3) [m].
        factor: (T, 6, 3, R) with Σ = factor · factorᵀ [m].
        weights: (K,) of the common factors.
        allowance: constraints, or None.
    """

    mean: Float[np.ndarray, "T 6 3"]
    factor: Float[np.ndarray, "T 6 3 R"]
    weights: Float[np.ndarray, " K"]
    allowance: Allowance | None = None

    @cached_property
    def _cholesky(self) -> Float[np.ndarray, "T 18 18"]:
        rows = self.factor[:, JOINT_ORDER].reshape(len(self.mean), 18, -1)
        return np.linalg.cholesky(rows @ rows.transpose(0, 2, 1) + FLOOR**2 * np.eye(18))

    def log_prob(self, positions: Float[np.ndarray, "T 6 3"]) -> Float[np.ndarray, " T"]:
        """(T,) log density [nats per m^18]; NaN where a joint is NaN."""
        error = (positions - self.mean)[:, JOINT_ORDER].reshape(len(positions), 18)
        square = (whiten(error, self._cholesky) ** 2).reshape(-1, 3, 6).sum(axis=2)
        volume = np.log(np.diagonal(self._cholesky, axis1=1, axis2=2)).reshape(-1, 3, 6).sum(axis=2)
        fault, allowed = fault_log_prob(positions, self.mean), log_allowed(self.allowance, positions)
        parts = [
            np.log(max(weight, 1e-300))
            + combine(-0.5 * square / scale**2 - volume - 6 * np.log(scale) - 3 * np.log(2 * np.pi), fault, allowed)
            for weight, scale in zip(self.weights, SCALES, strict=True)
        ]
        return np.asarray(logsumexp(np.stack(parts), axis=0))


@dataclass(frozen=True)
class GoalMixtureDensity:
    """f(x) = Σ_c p_c Σ_k w_k N(x; mean + factor · shift_c, s_k² Σ_c): a scale mixture about each goal's mean.

    Attributes:
        mean: (T, 6, 3) of the base forecast [m].
        factor: (T, 6, 3, R) of its covariance [m].
        weights: (K,) of the common factors.
        pursuit: the components.
        allowance: constraints, or None.
    """

    mean: Float[np.ndarray, "T 6 3"]
    factor: Float[np.ndarray, "T 6 3 R"]
    weights: Float[np.ndarray, " K"]
    pursuit: Pursuit
    allowance: Allowance | None = None

    @cached_property
    def _cholesky(self) -> dict[int, Float[np.ndarray, "T 18 18"]]:
        """Of each kind of component."""
        found = {}
        for kind in np.unique(self.pursuit.kind).tolist():
            found[kind] = ScaleMixtureDensity(self.mean, self.pursuit.factor(self.factor, kind), self.weights)._cholesky
        return found

    def log_prob(self, positions: Float[np.ndarray, "T 6 3"]) -> Float[np.ndarray, " T"]:
        """(T,) log density [nats per m^18]; NaN where a joint is NaN."""
        steps = len(positions)
        fault, allowed = fault_log_prob(positions, self.mean), log_allowed(self.allowance, positions)
        parts = []
        for kind, cholesky in self._cholesky.items():
            own = self.pursuit.kind == kind
            centers = self.mean + np.moveaxis(self.factor @ self.pursuit.shifts[:, own], -1, 0)
            error = (positions - centers)[:, :, JOINT_ORDER].reshape(len(centers), steps, 18)
            white = np.stack(
                [
                    solve_triangular(factor, rows.T, lower=True, check_finite=False).T
                    for factor, rows in zip(cholesky, error.transpose(1, 0, 2), strict=True)
                ],
                axis=1,
            )
            square = (white**2).reshape(len(centers), steps, 3, 6).sum(axis=-1)
            volume = np.log(np.diagonal(cholesky, axis1=1, axis2=2)).reshape(steps, 3, 6).sum(axis=2)
            for weight, scale in zip(self.weights, SCALES, strict=True):
                inlier = -0.5 * square / scale**2 - volume - 6 * np.log(scale) - 3 * np.log(2 * np.pi)
                rows = combine(
                    inlier.reshape(-1, 3),
                    np.tile(fault, (len(centers), 1)),
                    np.tile(allowed, len(centers)) if np.ndim(allowed) else allowed,
                )
                share = np.log(np.maximum(self.pursuit.weights[own] * weight, 1e-300))
                parts.append(share[:, None] + rows.reshape(len(centers), steps))
        return np.asarray(logsumexp(np.concatenate(parts), axis=0))
