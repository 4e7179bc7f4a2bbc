"""Whole motions drawn from the spread and moved inside joint limits: one pass over the samples.

Samples go side by side in lanes: a loop without branches takes a block of them to arm
angles, and finds out which lie inside their bounds. Only what lies outside is drawn anew, one by one. All that a block
works on is one flat array with rows at places known to the compiler, which then sees that no row overlaps another.
"""

from __future__ import annotations

import math
from typing import no_type_check

import numpy as np
from jaxtyping import Float
from numba import njit, prange

from kinecast.body.arm_angles import COINCIDENT, UNDEFINED, arm_vectors, nearest_turn
from kinecast.body.elementary import arctangent, sine_cosine
from kinecast.body.limits import JointLimits, bounds, posture_bounds, speeds_within_wrist_speed
from kinecast.body.posture import (
    into_torso,
    out_of_torso,
    points_of_posture,
    posture_of_points,
    postures_from_points,
)
from kinecast.prediction.draws import hashed, hashed_uniform
from kinecast.prediction.noise import angle_noise
from kinecast.prediction.truncated_normal import sample

__all__ = ["draw_motions"]

LANES = 64
"""Samples side by side."""
STRIP = 6
"""Columns of the factor taken in one go."""
ROWS = 92
POINTS, BEFORE, TORSO, ANGLES, SURE, HELD, MOVED, LENGTHS, WORLD = (
    LANES * row for row in (0, 18, 36, 40, 48, 49, 51, 53, 57)
)
"""Places in a block's work: six points; posture one step before; sine and cosine of yaw and roll; eight angles; whether
they are certain, and for each arm whether it keeps its bounds and whether it was moved; lengths of upper arm and
forearm, left and right; six points in the world."""
ARM_POINTS, ARM_POSTURE, ARM_ANGLES, ARM_LENGTHS = 9 * LANES, 6 * LANES, 4 * LANES, 2 * LANES
"""From what belongs to the left arm to what belongs to the right."""


def draw_motions(
    mean: Float[np.ndarray, "T 6 3"],
    factor: Float[np.ndarray, "T 6 3 R"],
    draws: Float[np.ndarray, "R S"],
    rng: np.random.Generator,
    initial: Float[np.ndarray, "18"],
    limits: JointLimits | None,
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
        draws: (R, S) of the factor's coordinates.
        rng: for what is drawn anew.
        initial: (18,) last observed posture.
        limits: of the arm's angles; None leaves every motion as it is.
        dt: time step [s].
        rotation, origin: of the torso frame in the world.

    Returns:
        (S, T, 6, 3) positions in the world [m].
    """
    steps, padding = len(mean), -len(draws) % STRIP
    rows = factor.reshape(18 * steps, -1)
    if padding:
        rows, draws = np.pad(rows, ((0, 0), (0, padding))), np.pad(draws, ((0, padding), (0, 0)))
    centre = postures_from_points(mean, initial, continuous=True, usual=False)
    return _motions(
        mean.reshape(steps, 18),
        rows,
        draws,
        limits is not None,
        np.uint64(rng.integers(2**63)),
        centre,
        _posture_spread(centre, np.sqrt((factor**2).sum(axis=-1).mean(axis=-1))),
        initial,
        *posture_bounds(limits),
        dt,
        rotation,
        origin,
    )


def _posture_spread(centre: Float[np.ndarray, "T 18"], spread: Float[np.ndarray, "T 6"]) -> Float[np.ndarray, "T 18"]:
    """(T, 18) spread of each arm angle, to first order, from that of the joints [m]; 0 for the rest."""
    result = np.zeros_like(centre)
    for first, at in ((0, 6), (3, 12)):
        result[:, at : at + 4] = angle_noise(centre[:, at : at + 6], spread[:, first : first + 3])
    return result


@njit(cache=True, parallel=True)
@no_type_check
def _motions(
    mean: Float[np.ndarray, "T 18"],
    factor: Float[np.ndarray, "18*T R"],
    draws: Float[np.ndarray, "R S"],
    bounded: bool,
    seed: np.uint64,
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
    steps, samples = len(mean), draws.shape[1]
    motions = np.empty((samples, steps, 6, 3))
    # A limit on the wrist's speed makes that of the angles depend on the pose: every one is then looked at alone.
    certain = 1.0 if math.isinf(wrist_speed) else 0.0
    for block in prange((samples + LANES - 1) // LANES):
        first = block * LANES
        count = min(LANES, samples - first)
        drawn, strayed = np.zeros(len(draws) * LANES), np.empty(18 * steps * LANES)
        for r in range(len(draws)):
            drawn[r * LANES : r * LANES + count] = draws[r, first : first + count]
        _stray(factor, drawn, strayed)
        work = np.zeros(ROWS * LANES)
        posture, pose, ceiling = np.empty((2, 18)), np.empty((6, 3)), np.empty(18)
        for d in range(18):
            work[BEFORE + d * LANES : BEFORE + (d + 1) * LANES] = initial[d]
        for t in range(steps):
            for d in range(18):
                k = 18 * t + d
                row = work[POINTS + d * LANES : POINTS + (d + 1) * LANES]
                row[:] = strayed[k * LANES : (k + 1) * LANES]
                row += mean[t, d]
            if bounded:
                work[SURE : SURE + LANES] = certain
                _torso(work)
                _angles(work, 0, 0, 0, 0, 0, 1.0, lower[6:10], upper[6:10], speed[6:10], dt)
                _angles(
                    work, ARM_POINTS, ARM_POSTURE, ARM_ANGLES, ARM_LENGTHS, LANES, -1.0,
                    lower[12:16], upper[12:16], speed[12:16], dt,
                )  # fmt: skip
                for lane in range(count):
                    number = np.uint64(((first + lane) * steps + t) * 8)
                    if work[SURE + lane] != 1.0:
                        for d in range(18):
                            posture[0, d] = work[BEFORE + d * LANES + lane]
                            pose[d // 3, d % 3] = work[POINTS + d * LANES + lane]
                        speeds_within_wrist_speed(posture[0], speed, wrist_speed, ceiling)
                        _moved_inside(pose, posture, seed, number, centre[t], spread[t], lower, upper, ceiling, dt)
                        work[MOVED + lane] = work[MOVED + LANES + lane] = 0.0
                        for d in range(18):
                            work[BEFORE + d * LANES + lane] = posture[1, d]
                            work[POINTS + d * LANES + lane] = pose[d // 3, d % 3]
                        for k in range(8):
                            work[ANGLES + k * LANES + lane] = posture[1, 6 + k + 2 * (k // 4)]
                        continue
                    for arm in range(2):
                        held = work[HELD + arm * LANES + lane]
                        work[MOVED + arm * LANES + lane] = 1.0 - held
                        if held != 1.0:
                            _redrawn(work, lane, arm, seed, number, centre[t], spread[t], lower, upper, speed, dt)
                if work[MOVED : MOVED + LANES].any():
                    _placed(work, 0, 0, 0, 0, 1.0)
                if work[MOVED + LANES : MOVED + 2 * LANES].any():
                    _placed(work, ARM_POINTS, ARM_ANGLES, ARM_LENGTHS, LANES, -1.0)
                for k in range(4):
                    for lane in range(LANES):
                        work[BEFORE + (6 + k) * LANES + lane] = work[ANGLES + k * LANES + lane]
                        work[BEFORE + (12 + k) * LANES + lane] = work[ANGLES + (4 + k) * LANES + lane]
            _into_world(work, rotation, origin)
            for lane in range(count):
                for d in range(18):
                    motions[first + lane, t, d // 3, d % 3] = work[WORLD + d * LANES + lane]
    return motions


@njit(cache=True, fastmath={"contract"})
@no_type_check
def _stray(factor: Float[np.ndarray, "K R"], drawn: Float[np.ndarray, " D"], strayed: Float[np.ndarray, " W"]) -> None:
    """strayed = factor · draws of a block. A library's product would start threads of its own in each of ours."""
    for k in range(0, len(factor), 2):
        here, there = factor[k], factor[k + 1]
        out = strayed[k * LANES : (k + 2) * LANES]
        out[:] = 0.0
        for r in range(0, len(here), STRIP):
            f0, f1, f2, f3, f4, f5 = here[r], here[r + 1], here[r + 2], here[r + 3], here[r + 4], here[r + 5]
            g0, g1, g2, g3, g4, g5 = there[r], there[r + 1], there[r + 2], there[r + 3], there[r + 4], there[r + 5]
            strip = drawn[r * LANES : (r + STRIP) * LANES]
            for lane in range(LANES):
                d0, d1, d2 = strip[lane], strip[LANES + lane], strip[2 * LANES + lane]
                d3, d4, d5 = strip[3 * LANES + lane], strip[4 * LANES + lane], strip[5 * LANES + lane]
                f = f0 * d0 + f1 * d1 + f2 * d2 + f3 * d3 + f4 * d4 + f5 * d5
                g = g0 * d0 + g1 * d1 + g2 * d2 + g3 * d3 + g4 * d4 + g5 * d5
                out[lane] += f
                out[LANES + lane] += g


@njit(cache=True, error_model="numpy")
@no_type_check
def _torso(work: Float[np.ndarray, " W"]) -> None:
    """Sine and cosine of the torso's yaw and roll, from the shoulder line; unsure where the shoulders coincide."""
    right = POINTS + ARM_POINTS
    for lane in range(LANES):
        x = work[POINTS + lane] - work[right + lane]
        y = work[POINTS + LANES + lane] - work[right + LANES + lane]
        z = work[POINTS + 2 * LANES + lane] - work[right + 2 * LANES + lane]
        level = math.sqrt(x * x + y * y)
        width = math.sqrt(x * x + y * y + z * z)
        work[TORSO + lane], work[TORSO + LANES + lane] = -x / level, y / level
        work[TORSO + 2 * LANES + lane], work[TORSO + 3 * LANES + lane] = z / width, level / width
        work[SURE + lane] = work[SURE + lane] if (width > COINCIDENT) & (level > UNDEFINED * width) else 0.0


@njit(cache=True, error_model="numpy", forceinline=True)
@no_type_check
def _angles(
    work: Float[np.ndarray, " W"],
    to_points: int,
    to_posture: int,
    to_angles: int,
    to_lengths: int,
    to_flags: int,
    side: float,
    lower: Float[np.ndarray, "4"],
    upper: Float[np.ndarray, "4"],
    speed: Float[np.ndarray, "4"],
    dt: float,
) -> None:
    """The angles of one arm (kinecast.body.arm_angles), on the branch that goes on from the step before.

    They are not sure where an angle is undefined.
    """
    low1, low2, low3, low4 = lower[0], lower[1], lower[2], lower[3]
    up1, up2, up3, up4 = upper[0], upper[1], upper[2], upper[3]
    r1, r2, r3, r4 = speed[0] * dt, speed[1] * dt, speed[2] * dt, speed[3] * dt
    for lane in range(LANES):
        at = POINTS + to_points + lane
        sa, ca = work[TORSO + lane], work[TORSO + LANES + lane]
        sb, cb = work[TORSO + 2 * LANES + lane], work[TORSO + 3 * LANES + lane]
        x, y, z = work[at + 3 * LANES], work[at + 4 * LANES], work[at + 5 * LANES]
        upper_arm = (x - work[at], y - work[at + LANES], z - work[at + 2 * LANES])
        forearm = (work[at + 6 * LANES] - x, work[at + 7 * LANES] - y, work[at + 8 * LANES] - z)
        ux, uy, uz = into_torso(upper_arm, sa, ca, sb, cb)
        fx, fy, fz = into_torso(forearm, sa, ca, sb, cb)

        bone = math.sqrt(ux * ux + uy * uy + uz * uz)
        swing = math.sqrt(ux * ux + uz * uz)
        s2, c2 = side * uy / bone, swing / bone
        s1, c1 = ux / swing, -uz / swing
        flexed = fx * s1 - fz * c1
        along = c2 * flexed + s2 * side * fy
        ahead = fx * c1 + fz * s1
        outward = c2 * side * fy - s2 * flexed
        across = math.sqrt(ahead * ahead + outward * outward)

        at = BEFORE + to_posture + lane
        p1, p2, p3, p4 = work[at + 6 * LANES], work[at + 7 * LANES], work[at + 8 * LANES], work[at + 9 * LANES]
        t1, t2, t3, h4 = arctangent(s1, c1), arctangent(s2, c2), arctangent(outward, ahead), arctangent(across, along)
        h1, h2, h3 = nearest_turn(t1, p1), nearest_turn(t2, p2), nearest_turn(t3, p3)
        g1, g2, g3 = nearest_turn(t1 + math.pi, p1), nearest_turn(math.pi - t2, p2), nearest_turn(t3 + math.pi, p3)
        # What speaks for the other branch.
        e1, e2, d1, d2 = h1 - p1, h2 - p2, g1 - p1, g2 - p2
        gain = e1 * e1 + e2 * e2 - d1 * d1 - d2 * d2 - 4.0 * h4 * p4 * sine_cosine(h3 - p3)[1]
        other = gain > 0.0
        h1, h2, h3 = g1 if other else h1, g2 if other else h2, g3 if other else h3
        at = ANGLES + to_angles + lane
        work[at], work[at + LANES], work[at + 2 * LANES], work[at + 3 * LANES] = h1, h2, h3, h4
        at = LENGTHS + to_lengths + lane
        work[at], work[at + LANES] = bone, math.sqrt(fx * fx + fy * fy + fz * fz)

        held = (h1 >= min(max(low1, p1 - r1), p1 + r1)) & (h1 <= max(min(up1, p1 + r1), p1 - r1))
        held &= (h2 >= min(max(low2, p2 - r2), p2 + r2)) & (h2 <= max(min(up2, p2 + r2), p2 - r2))
        held &= (h3 >= min(max(low3, p3 - r3), p3 + r3)) & (h3 <= max(min(up3, p3 + r3), p3 - r3))
        held &= (h4 >= min(max(low4, p4 - r4), p4 + r4)) & (h4 <= max(min(up4, p4 + r4), p4 - r4))
        work[HELD + to_flags + lane] = 1.0 if held else 0.0
        defined = (bone > COINCIDENT) & (swing > UNDEFINED * bone) & (across > UNDEFINED * abs(along))
        work[SURE + lane] = work[SURE + lane] if defined else 0.0


@njit(cache=True)
@no_type_check
def _redrawn(
    work: Float[np.ndarray, " W"],
    lane: int,
    arm: int,
    seed: np.uint64,
    number: np.uint64,
    centre: Float[np.ndarray, "18"],
    spread: Float[np.ndarray, "18"],
    lower: Float[np.ndarray, "18"],
    upper: Float[np.ndarray, "18"],
    speed: Float[np.ndarray, "18"],
    dt: float,
) -> None:
    """Draws anew the angles of one arm that leave their bounds."""
    for part in range(4):
        k, d = 4 * arm + part, 6 + 6 * arm + part
        angle, before = ANGLES + k * LANES + lane, work[BEFORE + d * LANES + lane]
        work[angle] = _bounded(
            work[angle], before, k, seed, number, centre[d], spread[d], lower[d], upper[d], speed[d], dt
        )


@njit(cache=True)
@no_type_check
def _bounded(
    angle: float,
    before: float,
    k: int,
    seed: np.uint64,
    number: np.uint64,
    centre: float,
    spread: float,
    lower: float,
    upper: float,
    speed: float,
    dt: float,
) -> float:
    """Arm angle k, 0..7, where it keeps Eq. 4's bounds; else drawn anew from Eq. 2 about the mean motion's angle."""
    lb, ub = bounds(lower, upper, speed, before, dt)
    if lb <= angle <= ub:
        return angle
    about = centre if k % 4 == 3 else nearest_turn(centre, before)
    return sample(hashed_uniform(hashed(seed, number + np.uint64(k)), np.uint64(0)), about, spread, lb, ub)


@njit(cache=True, forceinline=True)
@no_type_check
def _placed(
    work: Float[np.ndarray, " W"], to_points: int, to_angles: int, to_lengths: int, to_flags: int, side: float
) -> None:
    """Forward kinematics of one arm in the lanes where it was moved (kinecast.body.arm_angles.arm_vectors)."""
    for lane in range(LANES):
        at = ANGLES + to_angles + lane
        theta = (work[at], work[at + LANES], work[at + 2 * LANES], work[at + 3 * LANES])
        at = LENGTHS + to_lengths + lane
        upper_arm, forearm = arm_vectors(theta, work[at], work[at + LANES], side)
        sa, ca = work[TORSO + lane], work[TORSO + LANES + lane]
        sb, cb = work[TORSO + 2 * LANES + lane], work[TORSO + 3 * LANES + lane]
        ux, uy, uz = out_of_torso(upper_arm, sa, ca, sb, cb)
        fx, fy, fz = out_of_torso(forearm, sa, ca, sb, cb)
        at = POINTS + to_points + lane
        ex, ey, ez = work[at] + ux, work[at + LANES] + uy, work[at + 2 * LANES] + uz
        wx, wy, wz = ex + fx, ey + fy, ez + fz
        moved = work[MOVED + to_flags + lane] == 1.0
        work[at + 3 * LANES] = ex if moved else work[at + 3 * LANES]
        work[at + 4 * LANES] = ey if moved else work[at + 4 * LANES]
        work[at + 5 * LANES] = ez if moved else work[at + 5 * LANES]
        work[at + 6 * LANES] = wx if moved else work[at + 6 * LANES]
        work[at + 7 * LANES] = wy if moved else work[at + 7 * LANES]
        work[at + 8 * LANES] = wz if moved else work[at + 8 * LANES]


@njit(cache=True, fastmath={"contract"})
@no_type_check
def _into_world(work: Float[np.ndarray, " W"], R: Float[np.ndarray, "3 3"], origin: Float[np.ndarray, "3"]) -> None:
    """All six points from the torso frame to the world."""
    r00, r01, r02, r10, r11, r12 = R[0, 0], R[0, 1], R[0, 2], R[1, 0], R[1, 1], R[1, 2]
    r20, r21, r22, o0, o1, o2 = R[2, 0], R[2, 1], R[2, 2], origin[0], origin[1], origin[2]
    for j in range(6):
        for lane in range(LANES):
            at = 3 * j * LANES + lane
            x, y, z = work[POINTS + at], work[POINTS + at + LANES], work[POINTS + at + 2 * LANES]
            work[WORLD + at] = o0 + r00 * x + r01 * y + r02 * z
            work[WORLD + at + LANES] = o1 + r10 * x + r11 * y + r12 * z
            work[WORLD + at + 2 * LANES] = o2 + r20 * x + r21 * y + r22 * z


@njit(cache=True)
@no_type_check
def _moved_inside(
    pose: Float[np.ndarray, "6 3"],
    posture: Float[np.ndarray, "2 18"],
    seed: np.uint64,
    number: np.uint64,
    centre: Float[np.ndarray, "18"],
    spread: Float[np.ndarray, "18"],
    lower: Float[np.ndarray, "18"],
    upper: Float[np.ndarray, "18"],
    ceiling: Float[np.ndarray, "18"],
    dt: float,
) -> None:
    """One pose into its bounds, if it is not there: `posture` holds the one before and receives the new one."""
    before, now = posture[0], posture[1]
    posture_of_points(pose, before, 0.0, now)
    broken = False
    for k in range(8):
        d = 6 + k + 2 * (k // 4)
        angle = _bounded(now[d], before[d], k, seed, number, centre[d], spread[d], lower[d], upper[d], ceiling[d], dt)
        broken |= angle != now[d]
        now[d] = angle
    if broken:
        points_of_posture(now, pose)
