"""Densities of sampled rollouts: the mean over samples of the exact conditional behind each draw (Eq. 6).

A rollout draws each number of step t from a normal or truncated normal that depends on the sample's past. The
density of that number at step t is the mean of those laws over samples (a Rao-Blackwell mixture, far less noisy than a
histogram); series are independent, as in the paper, so the pose's density is their product over the Jacobian.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import no_type_check

import numpy as np
from jaxtyping import Float
from numba import njit, prange

from kinecast.body.limits import JointLimits, bounds, speeds_within_wrist_speed
from kinecast.body.posture import postures_from_points
from kinecast.prediction.allowance import Allowance
from kinecast.prediction.density import BLOCKS, block_log_det, combine, fault_log_prob, log_allowed
from kinecast.prediction.gaussian import posture_bounds
from kinecast.prediction.noise import angle_noise
from kinecast.prediction.truncated_normal import noisy_log_pdf

__all__ = ["PositionSeriesDensity", "PostureSeriesDensity"]

HALF_LOG_TAU = 0.5 * math.log(2.0 * math.pi)


@njit(cache=True, parallel=True)
@no_type_check
def _normal_mixture(
    x: Float[np.ndarray, "T D"], means: Float[np.ndarray, "S T D"], spreads: Float[np.ndarray, "S T D"]
) -> Float[np.ndarray, "T D"]:
    """log of the mean over samples of N(x; mean, spread²), each number for itself."""
    draws, steps, size = means.shape
    out = np.empty((steps, size))
    for t in prange(steps):
        for d in range(size):
            top, total = -np.inf, 0.0
            for s in range(draws):
                z = (x[t, d] - means[s, t, d]) / spreads[s, t, d]
                value = -0.5 * z * z - math.log(spreads[s, t, d]) - HALF_LOG_TAU
                if value > top:
                    total = total * math.exp(top - value) + 1.0
                    top = value
                else:
                    total += math.exp(value - top)
            out[t, d] = top + math.log(total / draws)
    return out


@njit(cache=True, parallel=True)
@no_type_check
def _angle_mixture(
    theta: Float[np.ndarray, "P T 4"],
    means: Float[np.ndarray, "S T 18"],
    spreads: Float[np.ndarray, "S T 18"],
    before: Float[np.ndarray, "S T 18"],
    at: int,
    lower: Float[np.ndarray, "18"],
    upper: Float[np.ndarray, "18"],
    ceilings: Float[np.ndarray, "S T 18"],
    dt: float,
    noise: Float[np.ndarray, "T 4"],
) -> Float[np.ndarray, "T"]:
    """log density of one arm's angles at each step, summed over the P ways of writing them.

    θ1, θ2 and the pair (θ3, θ4) are independent mixtures over the samples.
    """
    ways, steps, _ = theta.shape
    draws = means.shape[0]
    out = np.empty(steps)
    for t in prange(steps):
        best, whole = -np.inf, 0.0
        for p in range(ways):
            log_density = 0.0
            for group in range(3):
                top, total = -np.inf, 0.0
                for s in range(draws):
                    value = 0.0
                    for part in range(group, 4 if group == 2 else group + 1):
                        d = at + part
                        lb, ub = bounds(lower[d], upper[d], ceilings[s, t, d], before[s, t, d], dt)
                        value += noisy_log_pdf(
                            theta[p, t, part], means[s, t, d], spreads[s, t, d], lb, ub, noise[t, part]
                        )
                    if value == -np.inf:
                        continue
                    if value > top:
                        total = total * math.exp(top - value) + 1.0
                        top = value
                    else:
                        total += math.exp(value - top)
                log_density += top + math.log(total / draws) if total > 0.0 else -np.inf
            if log_density > best:
                whole = whole * math.exp(best - log_density) + 1.0
                best = log_density
            elif log_density > -np.inf:
                whole += math.exp(log_density - best)
        out[t] = best + math.log(whole) if whole > 0.0 else -np.inf
    return out


@njit(cache=True)
@no_type_check
def _ceilings(
    before: Float[np.ndarray, "S T 18"], speed: Float[np.ndarray, "18"], wrist_speed: float
) -> Float[np.ndarray, "S T 18"]:
    """Greatest speeds of each sample's step, the wrist's carried to the angles."""
    out = np.empty(before.shape)
    for s in range(before.shape[0]):
        for t in range(before.shape[1]):
            speeds_within_wrist_speed(before[s, t], speed, wrist_speed, out[s, t])
    return out


@dataclass(frozen=True)
class PositionSeriesDensity:
    """Product of mixtures over the 18 coordinates of the six joints.

    Attributes:
        mean: (T, 6, 3) expected positions [m].
        means, spreads: (S, T, 18) the normal behind each draw [m].
    """

    mean: Float[np.ndarray, "T 6 3"]
    means: Float[np.ndarray, "S T 18"]
    spreads: Float[np.ndarray, "S T 18"]

    def log_prob(self, positions: Float[np.ndarray, "T 6 3"]) -> Float[np.ndarray, " T"]:
        """(T,) log density [nats per m^18]; NaN where a joint is NaN."""
        terms = _normal_mixture(positions.reshape(-1, 18), self.means, self.spreads).reshape(-1, 6, 3).sum(axis=2)
        inlier = np.stack([terms[:, list(block)].sum(axis=1) for block in BLOCKS], axis=1)
        result = combine(inlier, fault_log_prob(positions, self.mean))
        return np.where(np.isfinite(positions).all(axis=(1, 2)), result, np.nan)


@dataclass(frozen=True)
class PostureSeriesDensity:
    """Product of mixtures over posture numbers, carried to positions by the Jacobian's determinant.

    Attributes:
        mean: (T, 6, 3) expected positions, torso frame [m].
        postures: (S, T, 18) draws.
        means, spreads: (S, T, 18) the normal behind each number of them.
        initial: (18,) last observed posture.
        limits: of the angles; None where they were drawn free.
        dt: time step [s].
        noise: spread of a measured joint about the true one [m]; folded into the truncated normals.
        allowance: the scene, or None.
    """

    mean: Float[np.ndarray, "T 6 3"]
    postures: Float[np.ndarray, "S T 18"]
    means: Float[np.ndarray, "S T 18"]
    spreads: Float[np.ndarray, "S T 18"]
    initial: Float[np.ndarray, "18"]
    limits: JointLimits | None
    dt: float
    noise: float
    allowance: Allowance | None = None

    def log_prob(self, positions: Float[np.ndarray, "T 6 3"]) -> Float[np.ndarray, " T"]:
        """(T,) log density [nats per m^18] of torso-frame points; NaN where a joint is NaN."""
        finite = np.isfinite(positions).all(axis=(1, 2))
        result = np.full(len(positions), np.nan)
        if finite.any():
            result[finite] = self._log_prob(np.where(finite[:, None, None], positions, self.mean))[finite]
        return result

    def _log_prob(self, positions: Float[np.ndarray, "T 6 3"]) -> Float[np.ndarray, " T"]:
        postures = postures_from_points(positions, self.initial, continuous=False)
        plain = _normal_mixture(postures, self.means, self.spreads)
        before = np.concatenate(
            [np.broadcast_to(self.initial, (len(self.postures), 1, 18)), self.postures[:, :-1]], axis=1
        )
        lower, upper, speed, wrist_speed = posture_bounds(self.limits)
        ceilings = _ceilings(before, speed, wrist_speed)
        noise = 0.0 if self.limits is None else self.noise
        blocks = [plain[:, :6].sum(axis=1)]
        for at in (6, 12):
            spread = angle_noise(postures[:, at : at + 6], np.full(3, noise))
            angles = _angle_mixture(
                _ways(postures[:, at : at + 4]),
                self.means,
                self.spreads,
                before,
                at,
                lower,
                upper,
                ceilings,
                self.dt,
                spread,
            )
            blocks.append(angles + plain[:, at + 4 : at + 6].sum(axis=1))
        inlier = np.stack(blocks, axis=1) - block_log_det(postures)
        return combine(inlier, fault_log_prob(positions, self.mean), log_allowed(self.allowance, positions))


def _ways(theta: Float[np.ndarray, "T 4"]) -> Float[np.ndarray, "P T 4"]:
    """The ways of writing an arm's angles that a rollout may have used.

    Whole turns of θ3, and the elbow bent the other way with the upper arm turned round (θ3 + π, −θ4).
    """
    turn = 2 * np.pi
    shifts = [(0.0, 1.0), (turn, 1.0), (-turn, 1.0), (np.pi, -1.0), (-np.pi, -1.0)]
    ways = np.repeat(theta[None], len(shifts), axis=0)
    for way, (shift, sign) in zip(ways, shifts, strict=True):
        way[:, 2] += shift
        way[:, 3] *= sign
    return ways
