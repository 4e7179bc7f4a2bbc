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
from numba import njit

from kinecast.body.limits import JointLimits, bounds, posture_bounds, speeds_within_wrist_speed
from kinecast.body.posture import TURN, nearest_turn, other_branch, postures_from_points
from kinecast.prediction.density import JOINT_ORDER, block_log_det
from kinecast.prediction.noise import angle_noise
from kinecast.prediction.observation import Observation
from kinecast.prediction.truncated_normal import noisy_log_pdf

__all__ = ["PositionRolloutBlocks", "PostureRolloutBlocks"]

HALF_LOG_TAU = 0.5 * math.log(2.0 * math.pi)
FAINT = 40.0
"""A summand so many nats below the largest adds nothing."""
NEVER = -500.0
"""A log density of two angles below this adds nothing to any sum."""
WIDE = 0.3
"""Spread [rad] from which on more than the nearest turn of an angle counts."""
LEAST_NOISE = 1e-6
"""Where bounds leave a single value, its density needs some noise to be finite [m]."""
MOST_NOISE = 0.95
"""Greatest share of a learned spread that can be the sensor's."""


@njit(cache=True, nogil=True)
@no_type_check
def _normal_mixture(
    x: Float[np.ndarray, "T D"], means: Float[np.ndarray, "S T D"], spreads: Float[np.ndarray, "S T D"]
) -> Float[np.ndarray, "T D"]:
    """log of the mean over samples of N(x; mean, spread²), each number for itself."""
    draws, steps, size = means.shape
    out = np.empty((steps, size))
    for t in range(steps):
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


@njit(cache=True)
@no_type_check
def _add(top: float, total: float, value: float) -> tuple[float, float]:
    """One more summand exp(value) to the sum exp(top) · total."""
    if value > top:
        return value, total * math.exp(top - value) + 1.0
    if value > top - FAINT:
        total += math.exp(value - top)
    return top, total


@njit(cache=True)
@no_type_check
def _parts(spread: float, noise: float) -> tuple[float, float]:
    """Spread of the true angle and of its measurement's noise; together they are the spread that was learned."""
    tau = min(noise, MOST_NOISE * spread)
    return math.sqrt(spread * spread - tau * tau), tau


@njit(cache=True, nogil=True)
@no_type_check
def _angle_mixture(
    theta: Float[np.ndarray, "B T 4"],
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
    """log density of one arm's angles at each step, summed over every way of writing them that a rollout may use.

    θ1, θ2 and the pair (θ3, θ4) are independent mixtures over the samples. A process learned from measurements
    predicts measurements: its spread holds the sensor's noise, which bounds do not bind. So each law is a normal of
    variance σ² − τ² inside its bounds, plus noise of variance τ². The ways are both branches; whole turns;
    and an elbow bent backwards, (θ3 + π, −θ4), which free draws and noise may bring.
    """
    branches, steps, _ = theta.shape
    draws = means.shape[0]
    out = np.empty(steps)
    for t in range(steps):
        top, total = -np.inf, 0.0
        for branch in range(branches):
            log_density = 0.0
            for part in range(2):
                d = at + part
                best, whole = -np.inf, 0.0
                for s in range(draws):
                    mean, sd, tau = means[s, t, d], *_parts(spreads[s, t, d], noise[t, part])
                    lb, ub = bounds(lower[d], upper[d], ceilings[s, t, d], before[s, t, d], dt)
                    angle = nearest_turn(theta[branch, t, part], min(max(mean, lb), ub))
                    best, whole = _add(best, whole, noisy_log_pdf(angle, mean, sd, lb, ub, tau))
                log_density += best + math.log(whole / draws) if whole > 0.0 else -np.inf
            if log_density < NEVER:
                continue
            best, whole = -np.inf, 0.0
            for s in range(draws):
                m3, sd3, tau3 = means[s, t, at + 2], *_parts(spreads[s, t, at + 2], noise[t, 2])
                m4, sd4, tau4 = means[s, t, at + 3], *_parts(spreads[s, t, at + 3], noise[t, 3])
                lb3, ub3 = bounds(lower[at + 2], upper[at + 2], ceilings[s, t, at + 2], before[s, t, at + 2], dt)
                lb4, ub4 = bounds(lower[at + 3], upper[at + 3], ceilings[s, t, at + 3], before[s, t, at + 3], dt)
                turns = 1 if spreads[s, t, at + 2] > WIDE else 0
                for back in range(2):
                    bend = -theta[branch, t, 3] if back else theta[branch, t, 3]
                    log_bend = noisy_log_pdf(bend, m4, sd4, lb4, ub4, tau4)
                    if log_bend < NEVER:
                        continue
                    swing = nearest_turn(theta[branch, t, 2] + math.pi * back, min(max(m3, lb3), ub3))
                    for turn in range(-turns, turns + 1):
                        value = noisy_log_pdf(swing + turn * TURN, m3, sd3, lb3, ub3, tau3)
                        best, whole = _add(best, whole, log_bend + value)
            log_density += best + math.log(whole / draws) if whole > 0.0 else -np.inf
            top, total = _add(top, total, log_density)
        out[t] = top + math.log(total) if total > 0.0 else -np.inf
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


ONE = np.zeros(1)
"""log weight of the only component: what is mixed is each number for itself."""


@dataclass(frozen=True)
class PositionRolloutBlocks:
    """Product of mixtures over the 18 coordinates of the six joints in the world.

    Attributes:
        observation: places the torso frame.
        means, spreads: (S, T, 18) the normal behind each draw [m].
    """

    observation: Observation
    means: Float[np.ndarray, "S T 18"]
    spreads: Float[np.ndarray, "S T 18"]

    def log_blocks(
        self, poses: Float[np.ndarray, "T 6 3"]
    ) -> tuple[Float[np.ndarray, "1"], Float[np.ndarray, "1 T 3"]]:
        """See kinecast.prediction.density.BlockDensity."""
        terms = _normal_mixture(self.observation.to_world(poses).reshape(-1, 18), self.means, self.spreads)
        return ONE, terms.reshape(-1, 6, 3)[:, JOINT_ORDER].reshape(1, -1, 3, 6).sum(axis=-1)


@dataclass(frozen=True)
class PostureRolloutBlocks:
    """Product of mixtures over posture numbers, carried to positions by the Jacobian's determinant.

    Attributes:
        postures: (S, T, 18) draws.
        means, spreads: (S, T, 18) the normal behind each number of them.
        initial: (18,) last observed posture.
        limits: of the angles; None where they were drawn free.
        dt: time step [s].
        noise: spread of a measured joint about the true one [m]; the part of each spread that bounds do not bind.
    """

    postures: Float[np.ndarray, "S T 18"]
    means: Float[np.ndarray, "S T 18"]
    spreads: Float[np.ndarray, "S T 18"]
    initial: Float[np.ndarray, "18"]
    limits: JointLimits | None
    dt: float
    noise: float

    def log_blocks(
        self, poses: Float[np.ndarray, "T 6 3"]
    ) -> tuple[Float[np.ndarray, "1"], Float[np.ndarray, "1 T 3"]]:
        """See kinecast.prediction.density.BlockDensity."""
        postures = postures_from_points(poses, self.initial, continuous=False)
        plain = _normal_mixture(postures, self.means, self.spreads)
        before = np.concatenate(
            [np.broadcast_to(self.initial, (len(self.postures), 1, 18)), self.postures[:, :-1]], axis=1
        )
        lower, upper, speed, wrist_speed = posture_bounds(self.limits)
        ceilings = _ceilings(before, speed, wrist_speed)
        noise = 0.0 if self.limits is None else max(self.noise, LEAST_NOISE)
        blocks = [plain[:, :6].sum(axis=1)]
        for at in (6, 12):
            spread = angle_noise(postures[:, at : at + 6], np.full(3, noise))
            theta = postures[:, at : at + 4]
            branches = np.stack([theta, other_branch(theta)])
            angles = _angle_mixture(
                branches, self.means, self.spreads, before, at, lower, upper, ceilings, self.dt, spread
            )
            blocks.append(angles + plain[:, at + 4 : at + 6].sum(axis=1))
        return ONE, (np.stack(blocks, axis=1) - block_log_det(postures))[None]
