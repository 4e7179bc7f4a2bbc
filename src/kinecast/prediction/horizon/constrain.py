"""Joint limits on motions drawn in space: what breaks Eq. 4's bounds is redrawn, the rest stays as it is."""

from __future__ import annotations

from typing import no_type_check

import numpy as np
from jaxtyping import Float
from numba import njit, prange

from kinecast.body.arm_angles import nearest_turn
from kinecast.body.limits import bounds, speeds_within_wrist_speed
from kinecast.body.posture import points_of_posture, posture_of_points
from kinecast.prediction.truncated_normal import sample

__all__ = ["constrain"]


@njit(cache=True, parallel=True)
@no_type_check
def constrain(
    points: Float[np.ndarray, "S T 6 3"],
    centre: Float[np.ndarray, "T 18"],
    initial: Float[np.ndarray, "18"],
    uniforms: Float[np.ndarray, "S T 8"],
    lower: Float[np.ndarray, "18"],
    upper: Float[np.ndarray, "18"],
    speed: Float[np.ndarray, "18"],
    wrist_speed: float,
    dt: float,
    spread: Float[np.ndarray, "T 18"],
) -> Float[np.ndarray, " S"]:
    """Moves motions inside joint ranges and speeds, in place; returns (S,) the share of steps that were touched.

    Each pose is taken to the posture by the exact inverse kinematics. An angle outside its bounds given the step before
    is drawn anew from the truncated normal about the mean motion's angle (Eq. 2); the pose then comes back by forward
    kinematics. A pose inside keeps every bit.

    Args:
        points: (S, T, 6, 3) motions in the torso frame [m]; changed in place.
        centre: (T, 18) posture of the mean motion.
        initial: (18,) last observed posture.
        uniforms: (S, T, 8) uniform draws for θ1..θ4, left then right.
        lower, upper: (18,) range of a posture [rad].
        speed: (18,) greatest speeds [rad/s].
        wrist_speed: greatest speed of a wrist relative to the torso [m/s]; infinite for none.
        dt: time step [s].
        spread: (T, 18) spread of each angle about the mean motion's [rad].
    """
    draws, steps = points.shape[:2]
    touched = np.zeros(draws)
    for s in prange(draws):
        before = initial.copy()
        now = np.empty(18)
        ceiling = np.empty(18)
        for t in range(steps):
            posture_of_points(points[s, t], before, now)
            speeds_within_wrist_speed(before, speed, wrist_speed, ceiling)
            broken = False
            for arm in range(2):
                for part in range(4):
                    d = 6 + 6 * arm + part
                    lb, ub = bounds(lower[d], upper[d], ceiling[d], before[d], dt)
                    if not lb <= now[d] <= ub:
                        mean = nearest_turn(centre[t, d], before[d]) if part != 3 else centre[t, d]
                        now[d] = sample(uniforms[s, t, 4 * arm + part], mean, spread[t, d], lb, ub)
                        broken = True
            if broken:
                points_of_posture(now, points[s, t])
                touched[s] += 1.0 / steps
            before[:] = now
    return touched
