"""Whole motions drawn from the spread and moved inside joint limits: one pass over the samples."""

from __future__ import annotations

from typing import no_type_check

import numpy as np
from jaxtyping import Float
from numba import njit, prange

from kinecast.body.arm_angles import nearest_turn
from kinecast.body.limits import bounds, speeds_within_wrist_speed
from kinecast.body.posture import points_of_posture, posture_of_points
from kinecast.prediction.truncated_normal import sample

__all__ = ["draw_motions"]


@njit(cache=True, fastmath={"reassoc", "contract"})
@no_type_check
def _dot(a, b):
    total = 0.0
    for k in range(len(a)):
        total += a[k] * b[k]
    return total


@njit(cache=True, parallel=True)
@no_type_check
def draw_motions(
    mean: Float[np.ndarray, "T 6 3"],
    factor: Float[np.ndarray, "T 6 3 R"],
    draws: Float[np.ndarray, "S R"],
    uniforms: Float[np.ndarray, "S T 8"],
    centre: Float[np.ndarray, "T 18"],
    spread: Float[np.ndarray, "T 18"],
    initial: Float[np.ndarray, "18"],
    lower: Float[np.ndarray, "18"],
    upper: Float[np.ndarray, "18"],
    speed: Float[np.ndarray, "18"],
    wrist_speed: float,
    dt: float,
    rotation: Float[np.ndarray, "3 3"],
    origin: Float[np.ndarray, "3"],
) -> Float[np.ndarray, "S T 6 3"]:
    """Motions mean + factor · draw, every step within Eq. 4's bounds of the one before.

    Each pose is taken to the posture by the exact inverse kinematics. An angle outside its bounds given the step before
    is drawn anew from the truncated normal about the mean motion's angle (Eq. 2); the pose then comes back by forward
    kinematics. A pose inside keeps every bit.

    Args:
        mean: (T, 6, 3) in the torso frame [m].
        factor: (T, 6, 3, R) of the covariance [m].
        draws: (S, R) of the factor's coordinates.
        uniforms: (S, T, 8) uniform draws for θ1..θ4, left then right.
        centre: (T, 18) posture of the mean motion.
        spread: (T, 18) spread of each angle about it [rad].
        initial: (18,) last observed posture.
        lower, upper: (18,) range of a posture [rad]; infinite where free.
        speed: (18,) greatest speeds [rad/s]; infinite where free.
        wrist_speed: greatest speed of a wrist relative to the torso [m/s]; infinite for none.
        dt: time step [s].
        rotation, origin: of the torso frame in the world.

    Returns:
        (S, T, 6, 3) positions in the world [m].
    """
    samples, steps = len(draws), len(mean)
    motions = np.empty((samples, steps, 6, 3))
    for s in prange(samples):
        before = initial.copy()
        now = np.empty(18)
        ceiling = np.empty(18)
        points = np.empty((6, 3))
        for t in range(steps):
            for j in range(6):
                for d in range(3):
                    points[j, d] = mean[t, j, d] + _dot(factor[t, j, d], draws[s])
            posture_of_points(points, before, now)
            speeds_within_wrist_speed(before, speed, wrist_speed, ceiling)
            broken = False
            for arm in range(2):
                for part in range(4):
                    k = 6 + 6 * arm + part
                    lb, ub = bounds(lower[k], upper[k], ceiling[k], before[k], dt)
                    if not lb <= now[k] <= ub:
                        about = centre[t, k] if part == 3 else nearest_turn(centre[t, k], before[k])
                        now[k] = sample(uniforms[s, t, 4 * arm + part], about, spread[t, k], lb, ub)
                        broken = True
            if broken:
                points_of_posture(now, points)
            before[:] = now
            for j in range(6):
                for d in range(3):
                    motions[s, t, j, d] = (
                        origin[d]
                        + rotation[d, 0] * points[j, 0]
                        + rotation[d, 1] * points[j, 1]
                        + rotation[d, 2] * points[j, 2]
                    )
    return motions
