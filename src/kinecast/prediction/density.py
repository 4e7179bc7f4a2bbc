"""Exact densities over the pose of both arms at each predicted step (Eq. 6).

A pose is read in three blocks: both shoulders, then the left arm (elbow, wrist) given the shoulders, then the
right arm given what came before. Each block's predictive density is mixed with a small broad part for
tracker faults, so that one jump of a tracker costs a bounded price instead of an infinite one:

    g(x) = Π_b [(1 − ε) f_b(x) + ε h_b(x)]

Constraints bind the true pose, not the tracker's faults: they act on the part of g without any fault,
f = Π_b f_b, which becomes f(x) · P(allowed | x) / P(allowed) (Eq. 7, normalised).
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from jaxtyping import Float
from scipy.linalg import solve_triangular
from scipy.special import logsumexp

from kinecast.body.posture import TURN, coordinates_from_postures, postures_from_coordinates, postures_from_points
from kinecast.prediction.allowance import Allowance

__all__ = ["BLOCKS", "CoordinateGaussianDensity", "PositionGaussianDensity", "combine"]

FAULT_PROBABILITY = 0.01
"""ε: share of blocks that are a tracker's fault."""
FAULT_SPREAD = 0.5
"""Spread of a faulty joint about its prediction [m], an arm's length."""

BLOCKS = ((0, 3), (1, 2), (4, 5))
"""Joints of each block: shoulders, left elbow and wrist, right elbow and wrist."""
JOINT_ORDER = [joint for block in BLOCKS for joint in block]
"""Permutation of the six joints into block order."""

TURNING = (3, 6, 7, 12, 13)
"""Coordinates that are angles: yaw, flexion and abduction of each arm."""

Blocks = Float[np.ndarray, "T 3"]


def combine(inlier: Blocks, fault: Blocks, allowed: Float[np.ndarray, " T"] | float = 0.0) -> Float[np.ndarray, " T"]:
    """log g: every way in which blocks may be faulty, the faultless way weighted by what is allowed.

    Args:
        inlier: (T, 3) log f_b.
        fault: (T, 3) log h_b.
        allowed: (T,) log [P(allowed | x) / P(allowed)].
    """
    choices = np.stack([np.log1p(-FAULT_PROBABILITY) + inlier, np.log(FAULT_PROBABILITY) + fault])
    ways = []
    for way in product((0, 1), repeat=3):
        total = sum(choices[faulty, :, block] for block, faulty in enumerate(way))
        ways.append(total + (allowed if not any(way) else 0.0))
    return np.asarray(logsumexp(np.stack(ways), axis=0))


def fault_log_prob(points: Float[np.ndarray, "T 6 3"], mean: Float[np.ndarray, "T 6 3"]) -> Blocks:
    """(T, 3) log h_b: each block spread broadly about its prediction."""
    square = ((points - mean) ** 2).sum(axis=-1) / FAULT_SPREAD**2
    joint = -0.5 * square - 1.5 * np.log(2 * np.pi * FAULT_SPREAD**2)
    return np.stack([joint[:, list(block)].sum(axis=1) for block in BLOCKS], axis=1)


@dataclass(frozen=True)
class PositionGaussianDensity:
    """A Gaussian over the 18 coordinates of the six joints at each step.

    Attributes:
        mean: (T, 6, 3) [m].
        cholesky: (T, 18, 18) lower factor of each step's covariance, joints in `JOINT_ORDER` [m].
        allowance: constraints, or None.
    """

    mean: Float[np.ndarray, "T 6 3"]
    cholesky: Float[np.ndarray, "T 18 18"]
    allowance: Allowance | None = None

    def log_prob(self, positions: Float[np.ndarray, "T 6 3"]) -> Float[np.ndarray, " T"]:
        """(T,) log density [nats per m^18]; NaN where a joint is NaN."""
        error = (positions - self.mean)[:, JOINT_ORDER].reshape(len(positions), 18)
        inlier = gaussian_blocks(error, self.cholesky)
        return combine(inlier, fault_log_prob(positions, self.mean), log_allowed(self.allowance, positions))


def gaussian_blocks(error: Float[np.ndarray, "T 18"], cholesky: Float[np.ndarray, "T 18 18"]) -> Blocks:
    """(T, 3) log density of each six-dimensional block of a Gaussian given the blocks before it."""
    white = whiten(error, cholesky)
    diagonal = np.log(np.diagonal(cholesky, axis1=1, axis2=2))
    terms = -0.5 * white**2 - diagonal - 0.5 * np.log(2 * np.pi)
    return terms.reshape(-1, 3, 6).sum(axis=2)


def whiten(error: Float[np.ndarray, "T D"], cholesky: Float[np.ndarray, "T D D"]) -> Float[np.ndarray, "T D"]:
    """(T, D) errors in units of unit spread: the factor's inverse times each."""
    return np.stack(
        [
            solve_triangular(factor, row, lower=True, check_finite=False)
            for factor, row in zip(cholesky, error, strict=True)
        ]
    )


def log_allowed(allowance: Allowance | None, positions: Float[np.ndarray, "T 6 3"]) -> Float[np.ndarray, " T"] | float:
    """(T,) log [P(allowed | x) / P(allowed)]; 0 without constraints."""
    return 0.0 if allowance is None else allowance.log_given(positions) - allowance.log_total


@dataclass(frozen=True)
class CoordinateGaussianDensity:
    """A Gaussian over the 18 smooth posture coordinates at each step, carried to positions (Eq. 6).

    f(x) = f(coordinates) · |∂ coordinates / ∂ angles| / |det ∂ x / ∂ angles|: with bone lengths, shoulder
    width and torso pose as the paper's dummy variables the Jacobian is square and the result exact.

    Attributes:
        mean: (T, 18) smooth posture coordinates.
        cholesky: (T, 18, 18) lower factor of each step's covariance.
        points: (T, 6, 3) where the mean lies [m].
        allowance: constraints, or None.
    """

    mean: Float[np.ndarray, "T 18"]
    cholesky: Float[np.ndarray, "T 18 18"]
    points: Float[np.ndarray, "T 6 3"]
    allowance: Allowance | None = None

    def log_prob(self, positions: Float[np.ndarray, "T 6 3"]) -> Float[np.ndarray, " T"]:
        """(T,) log density [nats per m^18] of torso-frame points; NaN where a joint is NaN."""
        finite = np.isfinite(positions).all(axis=(1, 2))
        result = np.full(len(positions), np.nan)
        if finite.any():
            result[finite] = self._log_prob(np.where(finite[:, None, None], positions, self.points))[finite]
        return result

    def _log_prob(self, positions: Float[np.ndarray, "T 6 3"]) -> Float[np.ndarray, " T"]:
        # Only the way of writing the pose that is nearest to the mean counts: the others lie half a turn away.
        nearby = postures_from_coordinates(self.mean)
        postures = postures_from_points(positions[:, None], nearby, continuous=False)[:, 0]
        error = coordinates_from_postures(postures) - self.mean
        error[:, TURNING] -= TURN * np.round(error[:, TURNING] / TURN)
        inlier = gaussian_blocks(error, self.cholesky) - block_log_det(postures)
        # ∂(a, b)/∂(θ3, θ4) has determinant θ4.
        inlier[:, 1:] += _log_magnitude(postures[:, [9, 15]])
        return combine(inlier, fault_log_prob(positions, self.points), log_allowed(self.allowance, positions))


def block_log_det(postures: Float[np.ndarray, "T 18"]) -> Blocks:
    """(T, 3) log |∂ points / ∂ posture| of each block: shoulders, left arm, right arm.

    Their sum is kinecast.body.posture.log_det_jacobian; sines and cosines are kept off zero.
    """
    shoulders = 2 * np.log(postures[:, 5]) + _log_magnitude(np.cos(postures[:, 4]))
    arms = [
        2 * np.log(postures[:, at + 4] * postures[:, at + 5])
        + _log_magnitude(np.cos(postures[:, at + 1]))
        + _log_magnitude(np.sin(postures[:, at + 3]))
        for at in (6, 12)
    ]
    return np.stack([shoulders, *arms], axis=1)


def _log_magnitude(values: Float[np.ndarray, "*b"]) -> Float[np.ndarray, "*b"]:
    return np.log(np.maximum(np.abs(values), 1e-12))
