"""Algorithm 1 as loops: motions of the posture drawn step by step inside Eq. 4's bounds.

Two sources of conditionals, one way to constrain: `roll_gaussian` takes them from one joint Gaussian over all
steps and coordinates, `roll_series` (the paper's) from independent one-step Gaussian processes.
"""

from __future__ import annotations

import math
from typing import no_type_check

import numpy as np
from jaxtyping import Float
from numba import njit, prange

from kinecast.body.elementary import arctangent, sine_cosine
from kinecast.body.limits import bounds, speeds_within_wrist_speed
from kinecast.body.posture import nearest_turn
from kinecast.prediction.lanes import LANES, Tiles, lane_memory, next_values, tiled
from kinecast.prediction.series import SeriesStack
from kinecast.prediction.truncated_normal import keep_or_redraw, sample

__all__ = ["RELATIVE", "SERIES", "polar", "roll_gaussian", "roll_positions", "roll_series"]

SERIES = (0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 12, 13, 14, 15)
"""Posture coordinates with a process of their own: all but the bones."""
RELATIVE = 5
"""Coordinates below this, the torso's pose, are predicted relative to their last value."""
SHORTEST = 0.05
"""No bone and no shoulder width is drawn shorter [m]."""

UNIFORM = math.pi / math.sqrt(3.0)
"""Spread of an angle of which nothing is known [rad]."""

INNOVATION = 6.0
"""A draw forced by bounds moves what follows by at most this many standard deviations."""


@njit(cache=True, fastmath=True)
@no_type_check
def _dot(a: Float[np.ndarray, " K"], b: Float[np.ndarray, " K"], count: int) -> float:
    total = 0.0
    for k in range(count):
        total += a[k] * b[k]
    return total


@njit(cache=True, forceinline=True, error_model="numpy")
@no_type_check
def polar(a: float, b: float, sd_a: float, sd_b: float, previous: float) -> tuple[float, float, float, float]:
    """Mean and spread of (θ3, θ4) from those of the smooth pair (a, b) = (θ4 cos θ3, θ4 sin θ3).

    First order away from a straight elbow; at one, θ3's spread grows until it is that of a uniform angle.

    Returns:
        mean θ3 (nearest turn to `previous`), its spread, mean θ4, its spread [rad].
    """
    bend = math.sqrt(a * a + b * b)
    bent = bend > 1e-9
    cos, sin = a / bend if bent else 1.0, b / bend if bent else 0.0
    sd_bend = math.sqrt((sd_a * cos) ** 2 + (sd_b * sin) ** 2)
    sd_swing = math.sqrt((sd_a * sin) ** 2 + (sd_b * cos) ** 2) / max(bend, sd_bend)
    return nearest_turn(arctangent(sin, cos), previous), min(sd_swing, UNIFORM), bend, sd_bend


@njit(cache=True, parallel=True)
@no_type_check
def roll_gaussian(
    mean: Float[np.ndarray, "T 18"],
    cholesky: Float[np.ndarray, "K K"],
    initial: Float[np.ndarray, "18"],
    normals: Float[np.ndarray, "S K"],
    uniforms: Float[np.ndarray, "S T 8"],
    lower: Float[np.ndarray, "18"],
    upper: Float[np.ndarray, "18"],
    speed: Float[np.ndarray, "18"],
    wrist_speed: float,
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
        lower, upper: (18,) range of a posture [rad]; infinite where unconstrained.
        speed: (18,) greatest speeds [rad/s]; infinite where unconstrained.
        wrist_speed: greatest speed of a wrist relative to the torso [m/s]; infinite for none.
        dt: time step [s].

    Returns:
        (S, T, 18) postures, every θ inside Eq. 4's bounds.
    """
    steps, draws = mean.shape[0], normals.shape[0]
    postures = np.empty((draws, steps, 18))
    for s in prange(draws):
        white = normals[s].copy()
        before = initial.copy()
        ceiling = np.empty(18)
        for t in range(steps):
            speeds_within_wrist_speed(before, speed, wrist_speed, ceiling)
            for d in range(18):
                k = 18 * t + d
                row = cholesky[k]
                spread = row[k]
                centre = mean[t, d] + _dot(row, white, k)
                arm, part = (d - 6) // 6, (d - 6) % 6
                if d < 6 or part >= 4:
                    before[d] = centre + spread * white[k]
                elif part < 2:
                    lb, ub = bounds(lower[d], upper[d], ceiling[d], before[d], dt)
                    u = uniforms[s, t, 4 * arm + part]
                    value = keep_or_redraw(centre + spread * white[k], u, centre, spread, lb, ub)
                    white[k] = min(max((value - centre) / spread, -INNOVATION), INNOVATION)
                    before[d] = value
                elif part == 2:
                    # θ3 and θ4 come from the pair (a, b) at k and k + 1, drawn together.
                    below = cholesky[k + 1]
                    centre_b = mean[t, d + 1] + _dot(below, white, k)
                    a = centre + spread * white[k]
                    b = centre_b + below[k] * white[k] + below[k + 1] * white[k + 1]
                    swing = nearest_turn(math.atan2(b, a), before[d])
                    bend = math.hypot(a, b)
                    lb3, ub3 = bounds(lower[d], upper[d], ceiling[d], before[d], dt)
                    lb4, ub4 = bounds(lower[d + 1], upper[d + 1], ceiling[d + 1], before[d + 1], dt)
                    if not (lb3 <= swing <= ub3 and lb4 <= bend <= ub4):
                        sd_b = math.hypot(below[k], below[k + 1])
                        m3, sd3, m4, sd4 = polar(centre, centre_b, spread, sd_b, before[d])
                        swing = sample(uniforms[s, t, 4 * arm + 2], m3, sd3, lb3, ub3)
                        bend = sample(uniforms[s, t, 4 * arm + 3], m4, sd4, lb4, ub4)
                        a, b = bend * math.cos(swing), bend * math.sin(swing)
                        z = min(max((a - centre) / spread, -INNOVATION), INNOVATION)
                        white[k] = z
                        z = (b - centre_b - below[k] * z) / below[k + 1]
                        white[k + 1] = min(max(z, -INNOVATION), INNOVATION)
                    before[d], before[d + 1] = swing, bend
                # part == 3 was drawn with part 2.
            # Bones and widths keep a sane length whatever was drawn.
            before[5] = max(before[5], SHORTEST)
            for d in (10, 11, 16, 17):
                before[d] = max(before[d], SHORTEST)
            postures[s, t] = before
    return postures


def roll_series(
    window: Float[np.ndarray, "N 18"],
    offsets: Float[np.ndarray, "S 18"],
    stack: SeriesStack,
    length_spread: Float[np.ndarray, "T 4"],
    initial: Float[np.ndarray, "18"],
    normals: Float[np.ndarray, "S T 18"],
    uniforms: Float[np.ndarray, "S T 8"],
    lower: Float[np.ndarray, "18"],
    upper: Float[np.ndarray, "18"],
    speed: Float[np.ndarray, "18"],
    wrist_speed: float,
    dt: float,
) -> tuple[Float[np.ndarray, "S T 18"], Float[np.ndarray, "S T 18"], Float[np.ndarray, "S T 18"]]:
    """Algorithm 1: each series' next value from its own last N, by its own Gaussian process, sample by sample.

    θ1, θ2 are drawn from Eq. 2 as they are. θ3, θ4 come from the processes of the smooth pair (a, b), whose mean
    and spread are carried to the angles (`polar`); they too are truncated normals. Bones keep their last length to
    within what they varied by in training.

    Args:
        window: (N, 18) observed smooth coordinates.
        offsets: (S, 18) error of the window in each sample, where the camera states more noise than in training.
        stack: the Gaussian processes (kinecast.prediction.series).
        length_spread: (T, 4) spread of the four bones' lengths about their last ones [m].
        initial: (18,) last observed posture.
        normals: (S, T, 18) standard normal draws.
        uniforms: (S, T, 8) uniform draws for redrawing θ1..θ4, left then right.
        lower, upper: (18,) range of a posture [rad]; infinite where unconstrained.
        speed: (18,) greatest speeds [rad/s]; infinite where unconstrained.
        wrist_speed: greatest speed of a wrist relative to the torso [m/s]; infinite for none.
        dt: time step [s].

    Returns:
        (S, T, 18) postures, and (S, T, 18) mean and (S, T, 18) spread of the normal behind each number.
    """
    return _roll_series(
        window, offsets, tiled(stack), length_spread, initial, normals, uniforms, lower, upper, speed, wrist_speed, dt
    )


@njit(cache=True, parallel=True)
@no_type_check
def _roll_series(
    window: Float[np.ndarray, "N 18"],
    offsets: Float[np.ndarray, "S 18"],
    tiles: Tiles,
    length_spread: Float[np.ndarray, "T 4"],
    initial: Float[np.ndarray, "18"],
    normals: Float[np.ndarray, "S T 18"],
    uniforms: Float[np.ndarray, "S T 8"],
    lower: Float[np.ndarray, "18"],
    upper: Float[np.ndarray, "18"],
    speed: Float[np.ndarray, "18"],
    wrist_speed: float,
    dt: float,
) -> tuple[Float[np.ndarray, "S T 18"], Float[np.ndarray, "S T 18"], Float[np.ndarray, "S T 18"]]:
    frames, (draws, steps) = window.shape[0], normals.shape[:2]
    postures = np.empty((draws, steps, 18))
    means = np.empty((draws, steps, 18))
    spreads = np.empty((draws, steps, 18))
    for block in prange((draws + LANES - 1) // LANES):
        first, last = block * LANES, min(block * LANES + LANES, draws)
        past = _past(window, offsets[first:last], steps)
        memory, values = lane_memory(tiles), np.empty((frames, LANES))
        mean, spread, now = np.empty((18, LANES)), np.empty((18, LANES)), np.empty((18, LANES))
        for d in range(18):
            now[d] = initial[d]
        for t in range(steps):
            for series in range(len(SERIES)):
                d = SERIES[series]
                newest = past[d, t + frames - 1]
                share = 1.0 if d < RELATIVE else 0.0
                for n in range(frames):
                    for lane in range(LANES):
                        values[n, lane] = past[d, t + n, lane] - share * newest[lane]
                next_values(values, series, tiles, memory, mean[d], spread[d])
                for lane in range(LANES):
                    mean[d, lane] += share * newest[lane]
            _draw_step(
                now, mean, spread, initial, length_spread[t], normals[first:last, t], normals[first:last, 0],
                uniforms[first:last, t], lower, upper, speed, wrist_speed, dt,
            )  # fmt: skip
            _remember(now, past[:, t + frames])
            for s in range(first, last):
                for d in range(18):
                    postures[s, t, d] = now[d, s - first]
                    means[s, t, d], spreads[s, t, d] = mean[d, s - first], spread[d, s - first]
    return postures, means, spreads


@njit(cache=True)
@no_type_check
def _past(
    window: Float[np.ndarray, "N D"], offsets: Float[np.ndarray, "B D"], steps: int
) -> Float[np.ndarray, "D N+T L"]:
    """The window of each sample in a lane of its own, with room for what is drawn; lanes left over repeat the last."""
    frames, size = window.shape
    past = np.empty((size, frames + steps, LANES))
    for d in range(size):
        for n in range(frames):
            for lane in range(LANES):
                past[d, n, lane] = window[n, d] + offsets[min(lane, len(offsets) - 1), d]
        past[d, frames:] = 0.0
    return past


@njit(cache=True, error_model="numpy")
@no_type_check
def _draw_step(
    now: Float[np.ndarray, "18 L"],
    mean: Float[np.ndarray, "18 L"],
    spread: Float[np.ndarray, "18 L"],
    initial: Float[np.ndarray, "18"],
    length_spread: Float[np.ndarray, "4"],
    normals: Float[np.ndarray, "B 18"],
    bone_normals: Float[np.ndarray, "B 18"],
    uniforms: Float[np.ndarray, "B 8"],
    lower: Float[np.ndarray, "18"],
    upper: Float[np.ndarray, "18"],
    speed: Float[np.ndarray, "18"],
    wrist_speed: float,
    dt: float,
) -> None:
    """One step of each lane's sample: `now` goes from the last posture to the next.

    `mean` and `spread` come as those of the smooth coordinates and leave as those of the posture's own numbers.
    """
    count = len(normals)
    ceiling = np.empty((LANES, 18))
    posture = np.empty(18)
    for lane in range(LANES):
        posture[:] = now[:, lane]
        speeds_within_wrist_speed(posture, speed, wrist_speed, ceiling[lane])
    for d in range(6):
        for lane in range(count):
            now[d, lane] = mean[d, lane] + spread[d, lane] * normals[lane, d]
    for lane in range(LANES):
        now[5, lane] = max(now[5, lane], SHORTEST)
    for arm in range(2):
        at = 6 + 6 * arm
        a, b, sd_a, sd_b, swing = mean[at + 2], mean[at + 3], spread[at + 2], spread[at + 3], now[at + 2]
        for lane in range(LANES):
            a[lane], sd_a[lane], b[lane], sd_b[lane] = polar(a[lane], b[lane], sd_a[lane], sd_b[lane], swing[lane])
        for part in range(4):
            d = at + part
            for lane in range(count):
                lb, ub = bounds(lower[d], upper[d], ceiling[lane, d], now[d, lane], dt)
                m, sd = mean[d, lane], spread[d, lane]
                now[d, lane] = keep_or_redraw(m + sd * normals[lane, d], uniforms[lane, 4 * arm + part], m, sd, lb, ub)
        for bone in range(2):
            d = at + 4 + bone
            mean[d], spread[d] = initial[d], length_spread[2 * arm + bone]
            for lane in range(count):
                # One error for all steps: a bone's length does not flicker.
                now[d, lane] = max(mean[d, lane] + spread[d, lane] * bone_normals[lane, d], SHORTEST)


@njit(cache=True)
@no_type_check
def _remember(now: Float[np.ndarray, "18 L"], past: Float[np.ndarray, "18 L"]) -> None:
    """The smooth coordinates of the postures just drawn become the newest of the past."""
    past[:] = now
    for at in (8, 14):
        swing, bend, a, b = now[at], now[at + 1], past[at], past[at + 1]
        for lane in range(LANES):
            sine, cosine = sine_cosine(swing[lane])
            a[lane], b[lane] = bend[lane] * cosine, bend[lane] * sine


def roll_positions(
    window: Float[np.ndarray, "N 18"],
    offsets: Float[np.ndarray, "S 18"],
    stack: SeriesStack,
    normals: Float[np.ndarray, "S T 18"],
) -> tuple[Float[np.ndarray, "S T 18"], Float[np.ndarray, "S T 18"], Float[np.ndarray, "S T 18"]]:
    """Each coordinate's next value from its own last N, sample by sample, without any constraint.

    Args:
        window: (N, 18) observed coordinates [m].
        offsets: (S, 18) error of the window in each sample [m].
        stack: one process per coordinate.
        normals: (S, T, 18) standard normal draws.

    Returns:
        (S, T, 18) coordinates, and (S, T, 18) mean and (S, T, 18) spread of the normal behind each [m].
    """
    return _roll_positions(window, offsets, tiled(stack), normals)


@njit(cache=True, parallel=True)
@no_type_check
def _roll_positions(
    window: Float[np.ndarray, "N 18"],
    offsets: Float[np.ndarray, "S 18"],
    tiles: Tiles,
    normals: Float[np.ndarray, "S T 18"],
) -> tuple[Float[np.ndarray, "S T 18"], Float[np.ndarray, "S T 18"], Float[np.ndarray, "S T 18"]]:
    frames, (draws, steps) = window.shape[0], normals.shape[:2]
    positions = np.empty((draws, steps, 18))
    means = np.empty((draws, steps, 18))
    spreads = np.empty((draws, steps, 18))
    for block in prange((draws + LANES - 1) // LANES):
        first = block * LANES
        lanes = min(LANES, draws - first)
        past = _past(window, offsets[first : first + lanes], steps)
        memory = lane_memory(tiles)
        mean, spread = np.empty(LANES), np.empty(LANES)
        for d in range(18):
            for t in range(steps):
                next_values(past[d, t : t + frames], d, tiles, memory, mean, spread)
                for lane in range(lanes):
                    s = first + lane
                    value = mean[lane] + spread[lane] * normals[s, t, d]
                    past[d, t + frames, lane] = value
                    positions[s, t, d], means[s, t, d], spreads[s, t, d] = value, mean[lane], spread[lane]
    return positions, means, spreads
