"""Algorithm 1: motions of the posture drawn step by step inside Eq. 4's bounds, all samples at once.

Two sources of conditionals, one way to constrain: `roll_gaussian` takes them from one joint Gaussian over all
steps and coordinates, `roll_series` (the paper's) from independent one-step Gaussian processes.
"""

from __future__ import annotations

import math
from typing import TypeAlias, no_type_check

import numpy as np
from jaxtyping import Float
from numba import njit

from kinecast.body.limits import bounds, speeds_within_wrist_speed
from kinecast.body.posture import coordinates_from_postures, nearest_turn
from kinecast.prediction.sparse_gp import SparseGPs
from kinecast.prediction.truncated_normal import keep_or_redraw, sample

__all__ = ["LENGTHS", "RELATIVE", "SERIES", "polar", "roll_gaussian", "roll_positions", "roll_series"]

LENGTHS = (10, 11, 16, 17)
"""Where a posture holds bone lengths: left upper arm and forearm, right upper arm and forearm."""
SERIES = tuple(d for d in range(18) if d not in LENGTHS)
"""Posture coordinates with a process of their own: all but the bones."""
PARTS = ((slice(10), slice(10)), (slice(10, 14), slice(12, 16)))
"""The same as slices: of the series, and of the posture."""
RELATIVE = 5
"""Coordinates below this, the torso's pose, are predicted relative to their last value."""
POSITIVE = [5, *LENGTHS]
SHORTEST = 0.05
"""No bone and no shoulder width is drawn shorter [m]."""

UNIFORM = math.pi / math.sqrt(3.0)
"""Spread of an angle of which nothing is known [rad]."""

INNOVATION = 6.0
"""A draw forced by bounds moves what follows by at most this many standard deviations."""


Bounds: TypeAlias = tuple[np.ndarray, np.ndarray, np.ndarray, float]


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


def roll_gaussian(
    mean: Float[np.ndarray, "T 18"],
    cholesky: Float[np.ndarray, "K K"],
    initial: Float[np.ndarray, "18"],
    normals: Float[np.ndarray, "S K"],
    uniforms: Float[np.ndarray, "S T 8"],
    within: Bounds,
    dt: float,
) -> Float[np.ndarray, "S T 18"]:
    """Postures drawn one scalar at a time, each conditional on all that was drawn before it.

    A draw inside its bounds is kept; a violator is redrawn from the truncated normal.

    Args:
        mean: (T, 18) mean of the smooth posture coordinates.
        cholesky: (18 T, 18 T) lower factor of their covariance, steps outermost.
        initial: (18,) last observed posture.
        normals: (S, 18 T) standard normal draws.
        uniforms: (S, T, 8) uniform draws for redrawing θ1..θ4, left then right.
        within: range and speeds of the posture (kinecast.body.limits.posture_bounds).
        dt: time step [s].

    Returns:
        (S, T, 18) postures, every θ inside Eq. 4's bounds.
    """
    white = normals.copy()
    postures = np.empty((len(normals), len(mean), 18))
    now = np.repeat(initial[None], len(normals), axis=0)
    for t in range(len(mean)):
        step, earlier = slice(18 * t, 18 * t + 18), slice(18 * t)
        centre = mean[t] + white[:, earlier] @ cholesky[step, earlier].T
        _draw_gaussian_step(centre, cholesky[step, step], white[:, step], uniforms[:, t], *within, dt, now)
        # Bones and widths keep a sane length whatever was drawn.
        now[:, POSITIVE] = np.maximum(now[:, POSITIVE], SHORTEST)
        postures[:, t] = now
    return postures


@njit(cache=True, error_model="numpy")
@no_type_check
def _draw_gaussian_step(centre, factor, white, uniforms, lower, upper, speed, wrist_speed, dt, now):
    """One step of every sample: `now` (S, 18) goes from the last posture to the next, `white` to what it amounts to.

    `centre` (S, 18) are the means given the earlier steps, `factor` (18, 18) the covariance's block of this one.
    """
    ceiling = np.empty(18)
    for s in range(len(now)):
        z, posture = white[s], now[s]
        speeds_within_wrist_speed(posture, speed, wrist_speed, ceiling)
        for d in range(18):
            arm, part = (d - 6) // 6, (d - 6) % 6
            if d >= 6 and part == 3:
                continue  # drawn with part 2
            sd = factor[d, d]
            m = centre[s, d]
            for k in range(d):
                m += factor[d, k] * z[k]
            value = m + sd * z[d]
            if d < 6 or part >= 4:
                posture[d] = value
                continue
            lb, ub = bounds(lower[d], upper[d], ceiling[d], posture[d], dt)
            if part < 2:
                posture[d] = keep_or_redraw(value, uniforms[s, 4 * arm + part], m, sd, lb, ub)
                z[d] = _innovation(posture[d] - m, sd)
                continue
            # θ3 and θ4 come from the pair (a, b) at d and d + 1, drawn together.
            m_b = centre[s, d + 1]
            for k in range(d):
                m_b += factor[d + 1, k] * z[k]
            slope, sd_rest = factor[d + 1, d], factor[d + 1, d + 1]
            b = m_b + slope * z[d] + sd_rest * z[d + 1]
            swing, bend = nearest_turn(math.atan2(b, value), posture[d]), math.hypot(value, b)
            lb4, ub4 = bounds(lower[d + 1], upper[d + 1], ceiling[d + 1], posture[d + 1], dt)
            if not (lb <= swing <= ub and lb4 <= bend <= ub4):
                m3, sd3, m4, sd4 = polar(m, m_b, sd, math.hypot(slope, sd_rest), posture[d])
                swing = sample(uniforms[s, 4 * arm + 2], m3, sd3, lb, ub)
                bend = sample(uniforms[s, 4 * arm + 3], m4, sd4, lb4, ub4)
                z[d] = _innovation(bend * math.cos(swing) - m, sd)
                z[d + 1] = _innovation(bend * math.sin(swing) - m_b - slope * z[d], sd_rest)
            posture[d], posture[d + 1] = swing, bend


@njit(cache=True, error_model="numpy")
@no_type_check
def _innovation(error: float, sd: float) -> float:
    return min(max(error / sd, -INNOVATION), INNOVATION)


def roll_series(
    window: Float[np.ndarray, "N 18"],
    offsets: Float[np.ndarray, "S 18"],
    processes: SparseGPs,
    length_spread: Float[np.ndarray, "T 4"],
    initial: Float[np.ndarray, "18"],
    normals: Float[np.ndarray, "S T 18"],
    uniforms: Float[np.ndarray, "S T 8"],
    within: Bounds,
    dt: float,
) -> tuple[Float[np.ndarray, "S T 18"], Float[np.ndarray, "S T 18"], Float[np.ndarray, "S T 18"]]:
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
        uniforms, within, dt: as for `roll_gaussian`.

    Returns:
        (S, T, 18) postures, and (S, T, 18) mean and (S, T, 18) spread of the normal behind each number.
    """
    (draws, steps), frames, bones = normals.shape[:2], len(window), list(LENGTHS)
    postures, means, spreads = np.empty((3, steps, draws, 18))  # steps outermost, so that each is in one place
    means[..., bones], spreads[..., bones] = initial[bones], length_spread[:, None]
    white = normals.transpose(1, 0, 2).copy()
    white[..., bones] = white[0][:, bones]  # one error for all steps: a bone's length does not flicker
    past, predict = _past(window[:, SERIES], offsets[:, SERIES], steps), processes.predictor(draws)
    before = np.repeat(initial[None], draws, axis=0)
    for t in range(steps):
        x = past[:, t : t + frames].copy()
        newest = past[:RELATIVE, t + frames - 1]
        x[:RELATIVE] -= newest[:, None]
        mean, spread = predict(x)
        mean[:RELATIVE] += newest
        for here, there in PARTS:
            means[t, :, there], spreads[t, :, there] = mean[here].T, spread[here].T
        now = np.multiply(spreads[t], white[t], out=postures[t])
        now += means[t]
        for d in POSITIVE:
            np.maximum(now[:, d], SHORTEST, out=now[:, d])
        _draw_angles(means[t], spreads[t], white[t], uniforms[:, t], before, *within, dt, now)
        coordinates = coordinates_from_postures(now)
        for here, there in PARTS:
            past[here, t + frames] = coordinates[:, there].T
        before = now
    return postures.transpose(1, 0, 2), means.transpose(1, 0, 2), spreads.transpose(1, 0, 2)


@njit(cache=True, error_model="numpy")
@no_type_check
def _draw_angles(mean, spread, normals, uniforms, before, lower, upper, speed, wrist_speed, dt, now):
    """The arms' angles of every sample's next posture `now` (S, 18), from the truncated normals of Eq. 2.

    `mean` and `spread` (S, 18) come as those of the smooth coordinates and leave as those of the posture's own numbers.
    """
    ceiling = np.empty(18)
    for s in range(len(now)):
        speeds_within_wrist_speed(before[s], speed, wrist_speed, ceiling)
        for arm in range(2):
            a, b = 8 + 6 * arm, 9 + 6 * arm
            mean[s, a], spread[s, a], mean[s, b], spread[s, b] = polar(
                mean[s, a], mean[s, b], spread[s, a], spread[s, b], before[s, a]
            )
            for part in range(4):
                d = 6 + 6 * arm + part
                m, sd = mean[s, d], spread[s, d]
                lb, ub = bounds(lower[d], upper[d], ceiling[d], before[s, d], dt)
                now[s, d] = keep_or_redraw(m + sd * normals[s, d], uniforms[s, 4 * arm + part], m, sd, lb, ub)


def _past(
    window: Float[np.ndarray, "N D"], offsets: Float[np.ndarray, "S D"], steps: int
) -> Float[np.ndarray, "D K S"]:
    """(D, N + T, S) the window of each sample, with room for what is drawn."""
    frames, size = window.shape
    past = np.empty((size, frames + steps, len(offsets)))
    past[:, :frames] = window.T[:, :, None] + offsets.T[:, None]
    return past


def roll_positions(
    window: Float[np.ndarray, "N 18"],
    offsets: Float[np.ndarray, "S 18"],
    processes: SparseGPs,
    normals: Float[np.ndarray, "S T 18"],
) -> tuple[Float[np.ndarray, "S T 18"], Float[np.ndarray, "S T 18"], Float[np.ndarray, "S T 18"]]:
    """Each coordinate's next value from its own last N, sample by sample, without any constraint.

    Args:
        window: (N, 18) observed coordinates [m].
        offsets: (S, 18) error of the window in each sample [m].
        processes: one per coordinate.
        normals: (S, T, 18) standard normal draws.

    Returns:
        (S, T, 18) coordinates, and (S, T, 18) mean and (S, T, 18) spread of the normal behind each [m].
    """
    positions, means, spreads = np.empty(normals.shape), np.empty(normals.shape), np.empty(normals.shape)
    past, predict = _past(window, offsets, normals.shape[1]), processes.predictor(len(normals))
    for t in range(normals.shape[1]):
        mean, spread = predict(past[:, t : t + len(window)])
        means[:, t], spreads[:, t] = mean.T, spread.T
        positions[:, t] = means[:, t] + spreads[:, t] * normals[:, t]
        past[:, t + len(window)] = positions[:, t].T
    return positions, means, spreads
