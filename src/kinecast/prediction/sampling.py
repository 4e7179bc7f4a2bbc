"""The one constrained sampler: correlated draws → poses → joint angles → Eq. 4's bounds, step by step → positions.

Nearly every pose lies inside its bounds. So the angles of all poses are found at once, by array operations; one
compiled loop then goes through the steps, and takes by itself only the poses that leave their bounds. They are brought
to the nearest pose inside: drawing them anew, step by step, would make a motion that leaves its bounds tremble.
"""

from __future__ import annotations

import math
import os
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from typing import no_type_check

import numpy as np
from jaxtyping import Float
from numba import njit

from kinecast.body.limits import JointLimits, bounds, wrist_levers
from kinecast.body.posture import ANGLES, LENGTHS, arm_vectors, nearest_turn, out_of_torso
from kinecast.prediction.observation import Observation

__all__ = ["sample_motions"]

BLOCK = 104
"""Samples side by side. Known to the compiler, it makes vector instructions of loops over them (eight at a time), and a
product of this size stays in the calling thread: OpenBLAS' other threads would wait for a busy core."""
INSIDE = 5e-3
"""How far from the end of its range an angle is held that would leave it [rad]: others may reckon the end from fewer
recordings."""


def sample_motions(
    observation: Observation,
    mean: Float[np.ndarray, "T 6 3"],
    factor: Float[np.ndarray, "T 6 3 R"],
    draws: Float[np.ndarray, "R S"],
    limits: JointLimits | None,
    farthest: Float[np.ndarray, "T 6"] | None = None,
) -> Float[np.ndarray, "S T 6 3"]:
    """Motions mean + factor · draw, every step within Eq. 4's bounds of the one before.

    A motion that strays too far from the mean is brought nearer to it as a whole, by one factor, and stays smooth. Each
    pose is taken to the posture by the exact inverse kinematics. An angle outside its bounds given the step before is
    taken to the nearest bound; the pose then comes back by forward kinematics. A pose inside is kept as it is.

    Args:
        observation: the window; its last pose is the step before the first.
        mean: (T, 6, 3) in the torso frame [m].
        factor: (T, 6, 3, R) of the covariance [m].
        draws: (R, S) of the factor's coordinates.
        limits: of the arm's angles; None leaves every motion as it is.
        farthest: (T, 6) that each joint may be from the mean [m]; None for any.

    Returns:
        (S, T, 6, 3) positions in the world [m].
    """
    steps, samples = len(mean), draws.shape[1]
    within = None if limits is None else _within(limits, observation)
    motions = np.empty((samples, steps, 6, 3))

    def fill(first: int, last: int) -> None:
        """The motions from one to another, a block at a time: it stays in the processor's cache."""
        block, poses = np.zeros((draws.shape[0], BLOCK)), np.empty((steps, 18 * BLOCK))
        angles, adjacent = np.empty((2, steps, 8 * BLOCK))
        for start in range(first, last, BLOCK):
            part = draws[:, start : min(start + BLOCK, last)]
            block[:, : part.shape[1]] = part
            np.matmul(factor.reshape(steps, 18, -1), block, out=poses.reshape(steps, 18, BLOCK))
            if farthest is not None:
                _hold_near(poses, 1.0 / farthest**2)
            poses.reshape(steps, 18, BLOCK)[:] += mean.reshape(steps, 18, 1)
            if within is not None:
                _arm_triangles(poses, angles, adjacent)
                np.arctan2(angles, adjacent, out=angles)
                _hold_within_bounds(poses, angles, *within)
            _to_world(poses, *observation.frame, motions[start : start + part.shape[1]])

    half = BLOCK * (samples // (2 * BLOCK))
    if half == 0:
        fill(0, samples)
    else:
        helper = _helper(os.getpid()).submit(fill, 0, half)
        fill(half, samples)
        helper.result()
    return motions


def _within(limits: JointLimits, observation: Observation) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """Last angles [rad], bones [m]; lower and upper end and reach in a step (3, 8) [rad]; a wrist's reach [m]."""
    lower, upper, speed = limits.of_posture()
    bounds_of_step = np.stack([lower, upper, speed * observation.dt])[:, list(ANGLES)]
    wrist_reach = np.inf if limits.wrist_speed is None else limits.wrist_speed * observation.dt
    posture = observation.posture
    return posture[list(ANGLES)], posture[list(LENGTHS[1:])], bounds_of_step, wrist_reach


@cache
def _helper(_process: int) -> ThreadPoolExecutor:
    """A second thread: products, arctangents and compiled loops all let go of the interpreter."""
    return ThreadPoolExecutor(1, thread_name_prefix="sampling")


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def _hold_near(departures: Float[np.ndarray, "T 18*C"], weight: Float[np.ndarray, "T 6"]) -> None:
    """Whole departures from the mean, changed in place: times (1 + r⁸)^(-1/8), r the largest share of what is allowed.

    `weight` is one over the square of how far each joint may be [1/m²].
    """
    largest = np.zeros(BLOCK)
    for t in range(departures.shape[0]):
        p = departures[t]
        for j in range(6):
            for c in range(BLOCK):
                i = 3 * j * BLOCK + c
                square = p[i] * p[i] + p[i + BLOCK] * p[i + BLOCK] + p[i + 2 * BLOCK] * p[i + 2 * BLOCK]
                largest[c] = max(largest[c], square * weight[t, j])
    for c in range(BLOCK):
        largest[c] = (1.0 + largest[c] ** 4) ** -0.125
    for t in range(departures.shape[0]):
        for k in range(18):
            for c in range(BLOCK):
                departures[t, k * BLOCK + c] *= largest[c]


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def _arm_triangles(
    poses: Float[np.ndarray, "T 18*C"],
    opposite: Float[np.ndarray, "T 8*C"],
    adjacent: Float[np.ndarray, "T 8*C"],
) -> None:
    """θ1 … θ4 of the left and the right arm (kinecast.body.posture) as sides of right-angled triangles.

    The angles arctan(opposite / adjacent) lie within half a turn of 0; an undefined one is NaN.
    """
    for t in range(poses.shape[0]):
        p, up, along = poses[t], opposite[t], adjacent[t]
        for arm in range(2):
            side = 1.0 - 2.0 * arm
            at, k = 9 * BLOCK * arm, 4 * BLOCK * arm
            for c in range(BLOCK):
                x, y, z = (
                    p[c] - p[9 * BLOCK + c],
                    p[BLOCK + c] - p[10 * BLOCK + c],
                    p[2 * BLOCK + c] - p[11 * BLOCK + c],
                )
                level = math.sqrt(x * x + y * y)
                width = math.sqrt(level * level + z * z)
                sy, cy, sr, cr = -x / level, y / level, z / width, level / width
                i = at + c
                ex, ey, ez = p[i + 3 * BLOCK], p[i + 4 * BLOCK], p[i + 5 * BLOCK]
                ux, uy, uz = ex - p[i], ey - p[i + BLOCK], ez - p[i + 2 * BLOCK]
                fx, fy, fz = p[i + 6 * BLOCK] - ex, p[i + 7 * BLOCK] - ey, p[i + 8 * BLOCK] - ez
                ahead = cy * uy - sy * ux
                ux, uy, uz = cy * ux + sy * uy, side * (cr * ahead + sr * uz), cr * uz - sr * ahead
                ahead = cy * fy - sy * fx
                fx, fy, fz = cy * fx + sy * fy, side * (cr * ahead + sr * fz), cr * fz - sr * ahead
                swing = math.sqrt(ux * ux + uz * uz)
                bone = math.sqrt(swing * swing + uy * uy)
                s1, c1, s2, c2 = ux / swing, -uz / swing, uy / bone, swing / bone
                flexed, ahead = fx * s1 - fz * c1, fx * c1 + fz * s1
                outward = c2 * fy - s2 * flexed
                j = k + c
                up[j], along[j] = ux, -uz
                up[j + BLOCK], along[j + BLOCK] = uy, swing
                up[j + 2 * BLOCK], along[j + 2 * BLOCK] = outward, ahead
                up[j + 3 * BLOCK] = math.sqrt(ahead * ahead + outward * outward)
                along[j + 3 * BLOCK] = c2 * flexed + s2 * fy


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def _hold_within_bounds(
    poses: Float[np.ndarray, "T 18*C"],
    angles: Float[np.ndarray, "T 8*C"],
    initial: Float[np.ndarray, "8"],
    bones: Float[np.ndarray, "4"],
    within: Float[np.ndarray, "3 8"],
    wrist_reach: float,
) -> None:
    """Poses, changed in place: the angles of every step within Eq. 4's bounds of the step before.

    Args:
        poses: torso frame [m].
        angles: of both arms [rad], as `_arm_triangles` has them.
        initial: angles one step before the first [rad].
        bones: upper arm and forearm there, left and right [m].
        within: lower and upper end of each range, farthest that an angle goes in a step [rad].
        wrist_reach: farthest that a wrist goes relative to the torso in a step [m]; infinite for none.
    """
    lower, upper, reach = within
    before = np.empty(8 * BLOCK)
    for i in range(8 * BLOCK):
        before[i] = initial[i // BLOCK]
    held = np.empty(BLOCK, dtype=np.bool_)
    for t in range(poses.shape[0]):
        p, angle = poses[t], angles[t]
        for arm in range(2):
            a = 4 * arm
            for c in range(BLOCK):
                held[c] = wrist_reach == np.inf
            for k in range(a, a + 4):
                low, high, far = lower[k], upper[k], reach[k]
                for c in range(BLOCK):
                    value = angle[k * BLOCK + c]
                    near = math.fabs(value - before[k * BLOCK + c]) <= far
                    held[c] &= near & (low <= value) & (value <= high)
            for c in range(BLOCK):
                i1, i2, i3, i4 = a * BLOCK + c, (a + 1) * BLOCK + c, (a + 2) * BLOCK + c, (a + 3) * BLOCK + c
                if not held[c]:
                    _turn_to(angle, before, i1, i2, i3, i4)
                    levers = (0.0, 0.0, 0.0, 0.0)
                    if wrist_reach != np.inf:
                        upper_arm, forearm = bones[2 * arm], bones[2 * arm + 1]
                        if t > 0:
                            upper_arm, forearm = _bones(poses[t - 1], arm, c)
                        held_at = (before[i1], before[i2], before[i3], before[i4])
                        levers = wrist_levers(held_at, upper_arm, forearm)
                    changed = False
                    for k in range(a, a + 4):
                        i, far = k * BLOCK + c, reach[k]
                        if far * levers[k - a] > wrist_reach:
                            far = wrist_reach / levers[k - a]
                        lb, ub = bounds(lower[k] + INSIDE, upper[k] - INSIDE, far, before[i], 1.0)
                        if not lb <= angle[i] <= ub:
                            angle[i] = min(max(angle[i], lb), ub)
                            changed = True
                    if changed:
                        _place_arm(p, angle, i1, i2, i3, i4, arm, c)
                before[i1], before[i2], before[i3], before[i4] = angle[i1], angle[i2], angle[i3], angle[i4]


@njit(cache=True, error_model="numpy")
@no_type_check
def _turn_to(angle: np.ndarray, before: np.ndarray, i1: int, i2: int, i3: int, i4: int) -> None:
    """The angles of one arm on the turn and the branch next to those before (kinecast.body.posture)."""
    p1, p2, p3 = before[i1], before[i2], before[i3]
    here1, here2, here3 = nearest_turn(angle[i1], p1), nearest_turn(angle[i2], p2), nearest_turn(angle[i3], p3)
    there1, there2 = nearest_turn(here1 + math.pi, p1), nearest_turn(math.pi - here2, p2)
    gain = (here1 - p1) ** 2 + (here2 - p2) ** 2 - (there1 - p1) ** 2 - (there2 - p2) ** 2
    other = gain > 4.0 * angle[i4] * before[i4] * math.cos(here3 - p3)
    angle[i1] = there1 if other else here1
    angle[i2] = there2 if other else here2
    angle[i3] = nearest_turn(here3 + math.pi, p3) if other else here3


@njit(cache=True)
@no_type_check
def _bones(p: np.ndarray, arm: int, c: int) -> tuple[float, float]:
    """Lengths of one arm's upper arm and forearm [m]."""
    s, e, w, y, z = 9 * arm * BLOCK + c, (9 * arm + 3) * BLOCK + c, (9 * arm + 6) * BLOCK + c, BLOCK, 2 * BLOCK
    upper = (p[e] - p[s]) ** 2 + (p[e + y] - p[s + y]) ** 2 + (p[e + z] - p[s + z]) ** 2
    fore = (p[w] - p[e]) ** 2 + (p[w + y] - p[e + y]) ** 2 + (p[w + z] - p[e + z]) ** 2
    return math.sqrt(upper), math.sqrt(fore)


@njit(cache=True, error_model="numpy")
@no_type_check
def _place_arm(p: np.ndarray, angle: np.ndarray, i1: int, i2: int, i3: int, i4: int, arm: int, c: int) -> None:
    """Forward kinematics: elbow and wrist of one arm at its angles, its bones as long as they are."""
    side, s, e, w = 1.0 - 2.0 * arm, 9 * arm * BLOCK + c, (9 * arm + 3) * BLOCK + c, (9 * arm + 6) * BLOCK + c
    y1, z1 = BLOCK, 2 * BLOCK
    upper, fore = _bones(p, arm, c)
    x, y, z = p[c] - p[9 * BLOCK + c], p[y1 + c] - p[10 * BLOCK + c], p[z1 + c] - p[11 * BLOCK + c]
    level = math.sqrt(x * x + y * y)
    width = math.sqrt(level * level + z * z)
    sy, cy, sr, cr = -x / level, y / level, z / width, level / width
    u, f = arm_vectors((angle[i1], angle[i2], angle[i3], angle[i4]), upper, fore, side)
    u, f = out_of_torso(u, sy, cy, sr, cr), out_of_torso(f, sy, cy, sr, cr)
    for axis in range(3):
        along = axis * BLOCK
        p[e + along] = p[s + along] + u[axis]
        p[w + along] = p[e + along] + f[axis]


@njit(cache=True, nogil=True)
@no_type_check
def _to_world(
    poses: Float[np.ndarray, "T 18*C"],
    rotation: Float[np.ndarray, "3 3"],
    origin: Float[np.ndarray, "3"],
    motions: Float[np.ndarray, "S T 6 3"],
) -> None:
    """Motions of the torso frame, in blocks, as positions in the world."""
    for s in range(motions.shape[0]):
        for t in range(motions.shape[1]):
            p, out = poses[t], motions[s, t]
            for j in range(6):
                at = 3 * j * BLOCK + s
                x, y, z = p[at], p[at + BLOCK], p[at + 2 * BLOCK]
                for a in range(3):
                    out[j, a] = origin[a] + rotation[a, 0] * x + rotation[a, 1] * y + rotation[a, 2] * z
