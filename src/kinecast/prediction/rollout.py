"""Algorithm 1: motions of the posture drawn step by step inside Eq. 4's bounds, all samples at once.

`hold` bounds the draws of one Gaussian over all steps and coordinates; `roll_series` draws from the paper's independent
one-step Gaussian processes. A rollout's density is the mean over samples of the exact law behind each draw (Eq. 6), a
Rao-Blackwell mixture, far less noisy than a histogram; series are independent, as in the paper.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple, TypeAlias, no_type_check

import numpy as np
from jaxtyping import Float
from numba import njit

from kinecast.body.limits import bounds, speeds_within_wrist_speed
from kinecast.body.posture import (
    LENGTHS,
    TURN,
    block_log_det,
    coordinates_from_postures,
    nearest_turn,
    other_branch,
    postures_from_points,
)
from kinecast.prediction.density import JOINT_ORDER
from kinecast.prediction.noise import angle_noise
from kinecast.prediction.observation import Observation
from kinecast.prediction.sparse_gp import SparseGPs
from kinecast.prediction.truncated_normal import keep_or_redraw, noisy_log_pdf

BONES = list(LENGTHS[1:])
"""Where a posture holds bone lengths: left upper arm and forearm, right upper arm and forearm."""
SERIES = [d for d in range(18) if d not in BONES]
"""Posture coordinates with a process of their own: all but the bones."""
RELATIVE = 5
"""Coordinates below this, the torso's pose, are predicted relative to their last value."""
SHORTEST = 0.05
"""No bone and no shoulder width is drawn shorter [m]."""
UNIFORM = math.pi / math.sqrt(3.0)
"""Spread of an angle of which nothing is known [rad]."""
FAINT, NEVER = 40.0, -500.0
"""A summand so many nats below the largest, and a log density of two angles below this, add nothing."""
WIDE = 0.3
"""Spread [rad] from which on more than the nearest turn of an angle counts."""
MOST_NOISE = 0.95
"""Greatest share of a learned spread that can be the sensor's."""

Postures: TypeAlias = Float[np.ndarray, "S T 18"]
Bounds: TypeAlias = tuple[np.ndarray, np.ndarray, np.ndarray, float]
"""Range [rad], greatest speeds [rad/s] and wrist speed [m/s]: kinecast.body.limits.posture_bounds."""


class Rollout(NamedTuple):
    """(S, T, 18) postures; mean and spread of the normal behind each number, and the bounds it was drawn inside."""

    postures: Postures
    means: Postures
    spreads: Postures
    lower: Postures
    upper: Postures


@njit(cache=True, error_model="numpy")
@no_type_check
def polar(a: float, b: float, sd_a: float, sd_b: float, previous: float) -> tuple[float, float, float, float]:
    """Mean and spread of (θ3, θ4) from those of the smooth pair (a, b) = (θ4 cos θ3, θ4 sin θ3).

    First order away from a straight elbow; at one, θ3's spread grows until it is that of a uniform angle.

    Returns:
        mean θ3 (nearest turn to `previous`), its spread, mean θ4, its spread [rad].
    """
    bend = math.sqrt(a * a + b * b)
    cos, sin = (a / bend, b / bend) if bend > 1e-9 else (1.0, 0.0)
    sd_bend = math.sqrt((sd_a * cos) ** 2 + (sd_b * sin) ** 2)
    sd_swing = math.sqrt((sd_a * sin) ** 2 + (sd_b * cos) ** 2) / max(bend, sd_bend)
    return nearest_turn(math.atan2(sin, cos), previous), min(sd_swing, UNIFORM), bend, sd_bend


@njit(cache=True, error_model="numpy")
@no_type_check
def _to_angles(mean, spread, before):
    """Mean and spread (S, 18) of smooth coordinates become those of the posture's own numbers."""
    for s in range(len(mean)):
        for a in (8, 14):
            mean[s, a], spread[s, a], mean[s, a + 1], spread[s, a + 1] = polar(
                mean[s, a], mean[s, a + 1], spread[s, a], spread[s, a + 1], before[s, a]
            )


@njit(cache=True, error_model="numpy")
@no_type_check
def _bound(now, mean, spread, uniforms, before, lower, upper, speed, wrist_speed, dt, least, most):
    """Angles of the next postures `now` (S, 18) inside Eq. 4's bounds, which `least` and `most` (S, 18) receive."""
    ceiling = np.empty(18)
    for s in range(len(now)):
        speeds_within_wrist_speed(before[s], speed, wrist_speed, ceiling)
        for k in range(8):
            d = 6 + 6 * (k // 4) + k % 4
            lb, ub = bounds(lower[d], upper[d], ceiling[d], before[s, d], dt)
            now[s, d] = keep_or_redraw(now[s, d], uniforms[s, k], mean[s, d], spread[s, d], lb, ub)
            least[s, d], most[s, d] = lb, ub


def hold(
    drawn: Postures,
    mean: Float[np.ndarray, "T 18"],
    spread: Float[np.ndarray, "T 18"],
    initial: Float[np.ndarray, "18"],
    uniforms: Float[np.ndarray, "S T 8"],
    within: Bounds,
    dt: float,
) -> Postures:
    """Draws of a Gaussian over smooth posture coordinates, every angle inside Eq. 4's bounds of the step before.

    An angle inside its bounds is kept; a violator is redrawn from the truncated normal about its own mean (Eq. 2).

    Args:
        drawn: (S, T, 18) postures.
        mean, spread: (T, 18) of the smooth coordinates.
        initial: (18,) last observed posture.
        uniforms: (S, T, 8) uniform draws for redrawing θ1..θ4, left then right.
        within, dt: see Bounds; time step [s].

    Returns:
        (S, T, 18) postures.
    """
    postures, swings = drawn.copy(), [8, 14]
    postures[..., LENGTHS] = np.maximum(postures[..., LENGTHS], SHORTEST)
    before, ends = np.repeat(initial[None], len(drawn), axis=0), np.empty((2, len(drawn), 18))
    for t in range(drawn.shape[1]):
        now, centre, width = postures[:, t], *(np.repeat(x[None, t], len(drawn), axis=0) for x in (mean, spread))
        now[:, swings] -= TURN * np.round((now[:, swings] - before[:, swings]) / TURN)
        _to_angles(centre, width, before)
        _bound(now, centre, width, uniforms[:, t], before, *within, dt, *ends)
        before = now
    return postures


def roll_series(
    window: Float[np.ndarray, "N 18"],
    offsets: Float[np.ndarray, "S 18"],
    processes: SparseGPs,
    length_spread: Float[np.ndarray, "T 4"],
    initial: Float[np.ndarray, "18"],
    normals: Postures,
    uniforms: Float[np.ndarray, "S T 8"],
    within: Bounds,
    dt: float,
) -> Rollout:
    """Algorithm 1: each series' next value from its own last N, by its own Gaussian process, sample by sample.

    θ1, θ2 are drawn from Eq. 2 as they are. θ3, θ4 come from the processes of the smooth pair (a, b), whose mean
    and spread are carried to the angles (`polar`); they too are truncated normals. Bones keep their last length to
    within what they varied by in training.

    Args:
        window: (N, 18) observed smooth coordinates.
        offsets: (S, 18) error of the window in each sample, where the camera states more noise than in training.
        processes: of the coordinates in `SERIES`.
        length_spread: (T, 4) spread of the four bones' lengths about their last ones [m].
        initial: (18,) last observed posture.
        normals: (S, T, 18) standard normal draws.
        uniforms, within, dt: as for `hold`.
    """
    (draws, steps), frames = normals.shape[:2], len(window)
    rolled = np.empty((5, steps, draws, 18))  # steps outermost, so that each is in one place
    postures, means, spreads, lower, upper = rolled
    means[..., BONES], spreads[..., BONES] = initial[BONES], length_spread[:, None]
    white = normals.transpose(1, 0, 2).copy()
    white[..., BONES] = white[0][:, BONES]  # one error for all steps: a bone's length does not flicker
    past = _past(window[:, SERIES], offsets[:, SERIES], steps)
    before = np.repeat(initial[None], draws, axis=0)
    for t in range(steps):
        x = past[:, t : t + frames].copy()
        newest = past[:RELATIVE, t + frames - 1]
        x[:RELATIVE] -= newest[:, None]
        mean, spread = processes.predict(x)
        mean[:RELATIVE] += newest
        means[t][:, SERIES], spreads[t][:, SERIES] = mean.T, spread.T
        _to_angles(means[t], spreads[t], before)
        now = postures[t]
        now[:] = means[t] + spreads[t] * white[t]
        now[:, LENGTHS] = np.maximum(now[:, LENGTHS], SHORTEST)
        _bound(now, means[t], spreads[t], uniforms[:, t], before, *within, dt, lower[t], upper[t])
        past[:, t + frames] = coordinates_from_postures(now)[:, SERIES].T
        before = now
    return Rollout(*rolled.transpose(0, 2, 1, 3))


def roll_positions(
    window: Float[np.ndarray, "N 18"],
    offsets: Float[np.ndarray, "S 18"],
    processes: SparseGPs,
    normals: Postures,
) -> tuple[Postures, Postures, Postures]:
    """Each coordinate's next value [m] from its own last N, sample by sample, without any constraint.

    Returns:
        (S, T, 18) coordinates, and mean and spread of the normal behind each [m].
    """
    (draws, steps), frames = normals.shape[:2], len(window)
    positions, means, spreads = np.empty((3, draws, steps, 18))
    past = _past(window, offsets, steps)
    for t in range(steps):
        mean, spread = processes.predict(past[:, t : t + frames])
        means[:, t], spreads[:, t] = mean.T, spread.T
        positions[:, t] = means[:, t] + spreads[:, t] * normals[:, t]
        past[:, t + frames] = positions[:, t].T
    return positions, means, spreads


def _past(window: np.ndarray, offsets: np.ndarray, steps: int) -> Float[np.ndarray, "D K S"]:
    """(D, N + T, S) the window (N, D) of each sample, with room for what is drawn."""
    past = np.empty((window.shape[1], len(window) + steps, len(offsets)))
    past[:, : len(window)] = window.T[:, :, None] + offsets.T[:, None]
    return past


def _log_normals(x: Float[np.ndarray, "T D"], means: Postures, spreads: Postures) -> Float[np.ndarray, "T D"]:
    """log of the mean over samples of N(x; mean, spread²), each number for itself."""
    terms = -0.5 * ((x - means) / spreads) ** 2 - np.log(spreads) - 0.5 * math.log(TURN)
    return np.asarray(np.logaddexp.reduce(terms, axis=0) - math.log(len(means)))


@njit(cache=True)
@no_type_check
def _add(top, total, value):
    """One more summand exp(value) to the sum exp(top) · total."""
    if value > top:
        return value, total * math.exp(top - value) + 1.0
    if value > top - FAINT:
        total += math.exp(value - top)
    return top, total


@njit(cache=True)
@no_type_check
def _log_law(angle, mean, spread, lb, ub, noise):
    """log density of a measured angle whose learned `spread` holds the sensor's noise, which bounds do not bind."""
    tau = min(noise, MOST_NOISE * spread)
    return noisy_log_pdf(angle, mean, math.sqrt(spread * spread - tau * tau), lb, ub, tau)


@njit(cache=True, nogil=True)
@no_type_check
def _log_angles(theta, means, spreads, lower, upper, noise):
    """(T,) log density of one arm's angles, summed over every way of writing them that a rollout may use.

    θ1, θ2 and the pair (θ3, θ4) are independent mixtures over the samples. The ways are both branches of `theta`
    (2, T, 4); whole turns; and an elbow bent backwards, (θ3 + π, −θ4), which free draws and noise may bring. Means,
    spreads and bounds are (S, T, 4), noise (T, 4).
    """
    draws, steps, _ = means.shape
    out = np.empty(steps)
    for t in range(steps):
        top, total = -np.inf, 0.0
        for branch in range(2):
            log_density = 0.0
            for d in range(2):
                best, whole = -np.inf, 0.0
                for s in range(draws):
                    m, lb, ub = means[s, t, d], lower[s, t, d], upper[s, t, d]
                    angle = nearest_turn(theta[branch, t, d], min(max(m, lb), ub))
                    best, whole = _add(best, whole, _log_law(angle, m, spreads[s, t, d], lb, ub, noise[t, d]))
                log_density += best + math.log(whole / draws) if whole > 0.0 else -np.inf
            if log_density < NEVER:
                continue
            best, whole = -np.inf, 0.0
            for s in range(draws):
                m, sd, lb, ub = means[s, t, 2], spreads[s, t, 2], lower[s, t, 2], upper[s, t, 2]
                turns = 1 if sd > WIDE else 0
                for back in range(2):
                    bend = -theta[branch, t, 3] if back else theta[branch, t, 3]
                    law = means[s, t, 3], spreads[s, t, 3], lower[s, t, 3], upper[s, t, 3]
                    log_bend = _log_law(bend, *law, noise[t, 3])
                    if log_bend < NEVER:
                        continue
                    swing = nearest_turn(theta[branch, t, 2] + math.pi * back, min(max(m, lb), ub))
                    for turn in range(-turns, turns + 1):
                        log_swing = _log_law(swing + turn * TURN, m, sd, lb, ub, noise[t, 2])
                        best, whole = _add(best, whole, log_bend + log_swing)
            log_density += best + math.log(whole / draws) if whole > 0.0 else -np.inf
            top, total = _add(top, total, log_density)
        out[t] = top + math.log(total) if total > 0.0 else -np.inf
    return out


ONE = np.zeros(1)
"""log weight of the only component: what is mixed is each number for itself."""
Blocks: TypeAlias = tuple[Float[np.ndarray, "1"], Float[np.ndarray, "1 T 3"]]


@dataclass(frozen=True)
class PositionRolloutBlocks:
    """Product of mixtures over the 18 coordinates of the six joints in the world.

    Attributes:
        observation: places the torso frame.
        means, spreads: (S, T, 18) the normal behind each draw [m].
    """

    observation: Observation
    means: Postures
    spreads: Postures

    def log_blocks(self, poses: Float[np.ndarray, "T 6 3"]) -> Blocks:
        """See kinecast.prediction.density.BlockDensity."""
        terms = _log_normals(self.observation.to_world(poses).reshape(-1, 18), self.means, self.spreads)
        return ONE, terms.reshape(-1, 6, 3)[:, JOINT_ORDER].reshape(1, -1, 3, 6).sum(axis=-1)


@dataclass(frozen=True)
class PostureRolloutBlocks:
    """Product of mixtures over posture numbers, carried to positions by the Jacobian's determinant.

    Attributes:
        rollout: the draws and the laws behind them.
        initial: (18,) last observed posture.
        noise: spread of a measured joint about the true one [m]; the part of each spread that bounds do not bind.
    """

    rollout: Rollout
    initial: Float[np.ndarray, "18"]
    noise: float

    def log_blocks(self, poses: Float[np.ndarray, "T 6 3"]) -> Blocks:
        """See kinecast.prediction.density.BlockDensity."""
        _, means, spreads, lower, upper = self.rollout
        postures = postures_from_points(poses, self.initial, continuous=False)
        plain = _log_normals(postures, means, spreads)
        blocks = [plain[:, :6].sum(axis=1)]
        for at in (6, 12):
            arm = np.s_[..., at : at + 4]
            both = np.stack([postures[arm], other_branch(postures[arm])])
            noise = angle_noise(postures[:, at : at + 6], np.full(3, self.noise))
            angles = _log_angles(both, means[arm], spreads[arm], lower[arm], upper[arm], noise)
            blocks.append(angles + plain[:, at + 4 : at + 6].sum(axis=1))
        return ONE, (np.stack(blocks, axis=1) - block_log_det(postures))[None]
