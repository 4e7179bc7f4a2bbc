"""The exact density of the horizon model at each step: a scale mixture of Gaussians, within what is allowed."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float
from scipy.special import logsumexp

from kinecast.prediction.allowance import Allowance
from kinecast.prediction.density import JOINT_ORDER, combine, fault_log_prob, log_allowed, whiten
from kinecast.prediction.horizon.spread import SCALES

__all__ = ["ScaleMixtureDensity"]

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
