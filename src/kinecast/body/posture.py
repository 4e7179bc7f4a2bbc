"""Posture: the six arm points (18 coordinates) as 18 numbers of the body, and back, exactly.

Points are in the reference torso frame (x forward, y from right to left shoulder, z up the torso), in the
order of `ARM_JOINTS`. With p the middle of the shoulders and d from the right to the left one,
d = w (−sin ψ cos ρ, cos ψ cos ρ, sin ρ), the torso turns by R = Rz(ψ) Rx(ρ), and each arm's angles are read
in the frame R.

| numbers | meaning | unit |
|---|---|---|
| 0, 1, 2 | p, middle of the shoulders | m |
| 3, 4 | yaw ψ, roll ρ of the shoulder line | rad |
| 5 | w, shoulder width | m |
| 6 … 9 | left flexion, abduction, axial rotation, elbow flexion | rad |
| 10, 11 | left upper arm, forearm | m |
| 12 … 15 | right flexion, abduction, axial rotation, elbow flexion | rad |
| 16, 17 | right upper arm, forearm | m |

| angle of an arm | positive is | zero is |
|---|---|---|
| θ1 flexion | forward and up | upper arm in the plane of the shoulders |
| θ2 abduction | sideways, away from the body | upper arm in the plane of forward and up |
| θ3 axial rotation | external: a bent forearm turns outward | a bent forearm points along flexion |
| θ4 elbow flexion | bent | straight |

Two sets of angles describe the same arm: (θ1, θ2, θ3, θ4) and (θ1 + π, π − θ2, θ3 + π, θ4), its two branches.
In kernels a vector is a tuple of floats, and side is +1 left, −1 right.
"""

from __future__ import annotations

import math
from typing import TypeAlias, no_type_check

import numpy as np
from jaxtyping import Float
from numba import njit

LEFT_ARM = slice(6, 10)
RIGHT_ARM = slice(12, 16)
ANGLES = (6, 7, 8, 9, 12, 13, 14, 15)
"""Places of the eight arm angles in a posture."""
AXIAL, ELBOW = [8, 14], [9, 15]
"""Places of axial rotation and elbow flexion in a posture."""
LENGTHS = (5, 10, 11, 16, 17)
"""Places of the lengths in a posture: shoulder width and the four bones."""

Postures: TypeAlias = Float[np.ndarray, "*batch 18"]
Points: TypeAlias = Float[np.ndarray, "*batch 6 3"]
Vector: TypeAlias = tuple[float, float, float]
Angles: TypeAlias = tuple[float, float, float, float]

LEFT, RIGHT = 1.0, -1.0
TURN = 2.0 * math.pi

# Normal motion after the American Academy of Orthopaedic Surgeons, "Joint Motion: Method of Measuring and
# Recording" (1965): flexion 180, extension 60; abduction 180; external rotation 90, internal 70; elbow 150.
# Wider are adduction, which goes across the body, and internal rotation, which real work takes to 88.
USUAL_RANGE = (
    (math.radians(-60.0), math.radians(180.0)),
    (math.radians(-50.0), math.radians(180.0)),
    (math.radians(-100.0), math.radians(90.0)),
    (math.radians(0.0), math.radians(150.0)),
)
"""Lower and upper end of each angle [rad]: branches are judged by it, and the default limits are these."""

REST = (0.0, 0.0, 0.0, 0.5 * math.pi)
"""The previous angles where there are none: arm hanging, elbow bent at a right angle."""

OUTSIDE_WEIGHT = 16.0
"""A branch 45° (π/4) outside loses against one inside that lies half a turn (π) away: 16 (π/4)² = π²."""

FAR = math.radians(195.0)
"""Whole turns are given up this far from the middle of the range: half a turn, and 15° against chatter."""

UNDEFINED = 1e-13
"""Sine below which a direction is round-off: the angle about it is undefined and keeps its previous value."""

COINCIDENT = 1e-140
"""Points nearer than this [m] are one: squares of what is UNDEFINED times smaller still have all their digits."""


@njit(cache=True)
@no_type_check
def nearest_turn(angle: float, target: float) -> float:
    """The angle [rad], moved by whole turns to within π of target."""
    return angle + TURN * math.floor((target - angle) / TURN + 0.5)


@njit(cache=True)
@no_type_check
def arm_vectors(theta: Angles, upper: float, fore: float, side: float) -> tuple[Vector, Vector]:
    """Forward kinematics (Eq. 1) of four angles [rad] and two lengths [m]: shoulder to elbow, elbow to wrist [m].

    They are L1·u and L2·(cos θ4 u + sin θ4 (cos θ3 e1 + sin θ3 e2)), with u, e1, e2 the upper arm's axes.
    """
    s1, c1 = math.sin(theta[0]), math.cos(theta[0])
    s2, c2 = math.sin(theta[1]), math.cos(theta[1])
    s3, c3 = math.sin(theta[2]), math.cos(theta[2])
    s4, c4 = math.sin(theta[3]), math.cos(theta[3])
    along, across = fore * c4, fore * s4
    ahead, outward = across * c3, across * s3
    ux, uy, uz = c2 * s1, side * s2, -c2 * c1
    fx = along * ux + ahead * c1 - outward * s2 * s1
    fy = along * uy + outward * side * c2
    fz = along * uz + ahead * s1 + outward * s2 * c1
    return (upper * ux, upper * uy, upper * uz), (fx, fy, fz)


@njit(cache=True)
@no_type_check
def _turned(angle: float, previous: float, usual: tuple[float, float], weight: float) -> tuple[float, float]:
    """The angle by whole turns nearest to previous, or to the usual range; its weighted squared distance from that."""
    middle = 0.5 * (usual[0] + usual[1])
    turned = nearest_turn(angle, previous)
    if weight > 0.0 and math.fabs(turned - middle) > FAR:
        turned = nearest_turn(angle, middle)
    beyond = usual[0] - turned if turned < usual[0] else turned - usual[1] if turned > usual[1] else 0.0
    return turned, weight * beyond * beyond


@njit(cache=True)
@no_type_check
def _branch(theta: Vector, bend: float, previous: Angles, weight: float) -> Angles:
    """θ1 to θ3 of a branch by whole turns, and what speaks against it; `bend` is θ4 where θ3 is defined, else 0."""
    theta1, outside1 = _turned(theta[0], previous[0], USUAL_RANGE[0], weight)
    theta2, outside2 = _turned(theta[1], previous[1], USUAL_RANGE[1], weight)
    theta3, outside3 = _turned(theta[2], previous[2], USUAL_RANGE[2], weight)
    cost = (theta1 - previous[0]) ** 2 + (theta2 - previous[1]) ** 2 + outside1 + outside2
    cost += bend * (bend * outside3 - 2.0 * previous[3] * math.cos(theta3 - previous[2]))
    return theta1, theta2, theta3, cost


@njit(cache=True, error_model="numpy")
@no_type_check
def arm_angles(u: Vector, f: Vector, side: float, previous: Angles, weight: float) -> Angles:
    """Inverse kinematics: of the two branches, the one nearest to the previous angles and to the usual range.

    It has the least squared distance in (θ1, θ2, θ4 cos θ3, θ4 sin θ3), which is smooth at a straight elbow,
    plus `weight` times the squared distance from the usual range. So continuous motion keeps its branch, but with
    `OUTSIDE_WEIGHT` a tracker that jumps across the shoulder cannot leave an arm on a branch no arm can be on. Whole
    turns are the nearest to the previous angles, until that is more than 195° from the middle of the usual range.
    With weight 0 the angles go on from the previous ones wherever those are: the angles of a motion that kept
    limits are then found again from its points, even where limits are wider than the usual range.

    An angle that is undefined keeps its previous value, 0 when there is none: θ3 at a straight elbow, θ1 with
    the arm straight out sideways. A forearm that is NaN gives NaN for θ3 and θ4 alone.

    Takes shoulder to elbow and elbow to wrist, of any length [m]; side +1 left, −1 right; the angles one step earlier
    [rad], NaN for none, an arm at rest then; and the weight, `OUTSIDE_WEIGHT` or 0. Returns [rad]; θ4 lies in [0, π].
    """
    upper = math.sqrt(u[0] * u[0] + u[1] * u[1] + u[2] * u[2])
    if math.isnan(upper):
        return math.nan, math.nan, math.nan, math.nan
    shoulder = REST[:2] if math.isnan(previous[0] + previous[1]) else previous[:2]
    elbow = REST[2:] if math.isnan(previous[2] + previous[3]) else previous[2:]
    before = shoulder + elbow

    swing = math.sqrt(u[0] * u[0] + u[2] * u[2])
    s2, c2 = (side * u[1] / upper, swing / upper) if upper > COINCIDENT else (0.0, 1.0)
    theta2 = math.atan2(s2, c2)
    if upper > COINCIDENT and swing > UNDEFINED * upper:
        theta1 = math.atan2(u[0], -u[2])
        s1, c1 = u[0] / swing, -u[2] / swing
    else:
        theta1 = before[0]
        s1, c1 = math.sin(theta1), math.cos(theta1)

    flexed = f[0] * s1 - f[2] * c1
    along = c2 * flexed + s2 * side * f[1]
    ahead = f[0] * c1 + f[2] * s1
    outward = c2 * side * f[1] - s2 * flexed
    across = math.sqrt(ahead * ahead + outward * outward)
    theta4 = math.atan2(across, along)
    bent = across > UNDEFINED * math.fabs(along)
    theta3 = math.atan2(outward, ahead) if bent else before[2]

    bend = theta4 if bent else 0.0
    here = _branch((theta1, theta2, theta3), bend, before, weight)
    there = (theta1 + math.pi, math.pi - theta2, theta3 + math.pi if bent else theta3)
    there = _branch(there, bend, before, weight)
    theta1, theta2, theta3, _ = there if there[3] < here[3] else here
    return theta1, theta2, math.nan if math.isnan(across) else theta3, theta4


@njit(cache=True)
@no_type_check
def _difference(points: np.ndarray, tip: int, base: int) -> Vector:
    a, b = points[tip], points[base]
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@njit(cache=True)
@no_type_check
def into_torso(v: Vector, sy: float, cy: float, sr: float, cr: float) -> Vector:
    """Rᵀ v with R = Rz(ψ) Rx(ρ)."""
    level = cy * v[1] - sy * v[0]
    return cy * v[0] + sy * v[1], cr * level + sr * v[2], cr * v[2] - sr * level


@njit(cache=True)
@no_type_check
def out_of_torso(v: Vector, sy: float, cy: float, sr: float, cr: float) -> Vector:
    """R v with R = Rz(ψ) Rx(ρ)."""
    level = cr * v[1] - sr * v[2]
    return cy * v[0] - sy * level, sy * v[0] + cy * level, sr * v[1] + cr * v[2]


@njit(cache=True)
@no_type_check
def _length(v: Vector) -> float:
    return math.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])


@njit(cache=True)
@no_type_check
def posture_of_points(points: np.ndarray, previous: np.ndarray, weight: float, out: np.ndarray) -> None:
    """The posture (18,) of six points (6, 3) [m], on the branch nearest to the previous posture (kernel).

    A NaN point gives NaN where it is needed, a NaN in `previous` (18,) means none. `weight` is as in `arm_angles`;
    `out` (18,) may be the same array as `previous`.
    """
    d = _difference(points, 0, 3)
    level = math.sqrt(d[0] * d[0] + d[1] * d[1])
    width = _length(d)
    yaw = math.nan if math.isnan(width) else previous[3]
    if width > COINCIDENT and level > UNDEFINED * width:
        turned = math.atan2(-d[0], d[1])
        yaw = turned if math.isnan(yaw) else nearest_turn(turned, yaw)
        sy, cy = -d[0] / level, d[1] / level
    else:
        yaw = 0.0 if math.isnan(yaw) and not math.isnan(width) else yaw
        sy, cy = math.sin(yaw), math.cos(yaw)
    for axis in range(3):
        out[axis] = 0.5 * (points[0, axis] + points[3, axis])
    out[3] = yaw
    out[4] = math.atan2(d[2], level) if width > COINCIDENT else 0.0 * width
    out[5] = width
    sr, cr = (d[2] / width, level / width) if width > COINCIDENT else (0.0, 1.0)

    for arm in range(2):
        shoulder, at = 3 * arm, 6 + 6 * arm
        upper = _difference(points, shoulder + 1, shoulder)
        fore = _difference(points, shoulder + 2, shoulder + 1)
        before = (previous[at], previous[at + 1], previous[at + 2], previous[at + 3])
        side = LEFT if arm == 0 else RIGHT
        u, f = into_torso(upper, sy, cy, sr, cr), into_torso(fore, sy, cy, sr, cr)
        theta = arm_angles(u, f, side, before, weight)
        out[at], out[at + 1], out[at + 2], out[at + 3] = theta
        out[at + 4], out[at + 5] = _length(upper), _length(fore)


@njit(cache=True)
@no_type_check
def points_of_posture(posture: np.ndarray, out: np.ndarray) -> None:
    """Writes the six points (6, 3) of a posture (18,), in the reference torso frame [m] (kernel)."""
    sy, cy = math.sin(posture[3]), math.cos(posture[3])
    sr, cr = math.sin(posture[4]), math.cos(posture[4])
    half = 0.5 * posture[5]
    d = (-half * sy * cr, half * cy * cr, half * sr)
    for arm in range(2):
        shoulder, at = 3 * arm, 6 + 6 * arm
        side = LEFT if arm == 0 else RIGHT
        theta = (posture[at], posture[at + 1], posture[at + 2], posture[at + 3])
        upper, fore = arm_vectors(theta, posture[at + 4], posture[at + 5], side)
        upper = out_of_torso(upper, sy, cy, sr, cr)
        fore = out_of_torso(fore, sy, cy, sr, cr)
        for axis in range(3):
            out[shoulder, axis] = posture[axis] + side * d[axis]
            out[shoulder + 1, axis] = out[shoulder, axis] + upper[axis]
            out[shoulder + 2, axis] = out[shoulder + 1, axis] + fore[axis]


@njit(cache=True)
@no_type_check
def _posture_series(points: np.ndarray, previous: np.ndarray, continuous: bool, weight: float, out: np.ndarray) -> None:
    for series in range(points.shape[0]):
        last = previous[series].copy()
        for step in range(points.shape[1]):
            posture_of_points(points[series, step], last, weight, out[series, step])
            if continuous:
                for i in range(18):
                    if not math.isnan(out[series, step, i]):
                        last[i] = out[series, step, i]


@njit(cache=True)
@no_type_check
def _points_series(postures: np.ndarray, out: np.ndarray) -> None:
    for i in range(postures.shape[0]):
        points_of_posture(postures[i], out[i])


def postures_from_points(
    points: Float[np.ndarray, "*batch N 6 3"],
    previous: Float[np.ndarray, "*#batch 18"] | None = None,
    continuous: bool = True,
    usual: bool = True,
) -> Float[np.ndarray, "*batch N 18"]:
    """Postures of point series: x ↦ (p, ψ, ρ, w, θ, L), exact inverse of `points_from_postures`.

    Args:
        points: (…, N, 6, 3) points in the reference torso frame [m], in the order of `ARM_JOINTS`.
        previous: (…, 18) posture before the first frame of each series; None or NaN for none.
        continuous: each frame continues from the last one known in its series (over NaN gaps too);
            else each frame continues from `previous` alone.
        usual: whether an arm far outside its usual range changes to its other branch, as fits a tracked person; a
            motion drawn within limits of its own goes on from its own branch without.

    Returns:
        (…, N, 18) postures. NaN points give NaN in the numbers that need them.
    """
    batch, frames = points.shape[:-3], points.shape[-3]
    series = math.prod(batch)
    start = np.full(18, np.nan) if previous is None else previous
    start = np.broadcast_to(start, (*batch, 18)).reshape(series, 18)
    start = np.ascontiguousarray(start, dtype=np.float64)
    flat = np.ascontiguousarray(points, dtype=np.float64).reshape(series, frames, 6, 3)
    out = np.empty((series, frames, 18))
    _posture_series(flat, start, continuous, OUTSIDE_WEIGHT if usual else 0.0, out)
    return out.reshape(*batch, frames, 18)


def points_from_postures(postures: Postures) -> Points:
    """Points of postures: shoulders p ± d/2, elbows L1·R u from them, wrists L2·R f from the elbows.

    Returns (…, 6, 3) points in the reference torso frame [m], in the order of `ARM_JOINTS`.
    """
    flat = np.ascontiguousarray(postures, dtype=np.float64).reshape(-1, 18)
    out = np.empty((len(flat), 6, 3))
    _points_series(flat, out)
    return out.reshape(*postures.shape[:-1], 6, 3)


def block_log_det(postures: Postures) -> Float[np.ndarray, "*batch 3"]:
    """(…, 3) log |∂ points / ∂ posture| of shoulders, left arm and right arm, whose sum is that of the whole posture.

    log(w² cos ρ) and, of each arm, log(L1² |cos θ2| L2² |sin θ4|). The density of points is that of postures divided by
    this determinant. It is zero at a straight elbow, a sideways arm or an upright shoulder line: sines and cosines are
    kept off zero.
    """
    lengths = [postures[..., 5], postures[..., 10] * postures[..., 11], postures[..., 16] * postures[..., 17]]
    folds = [np.cos(postures[..., [4, 7, 13]]), np.sin(postures[..., ELBOW])]
    cosines, sines = (np.log(np.maximum(np.abs(fold), 1e-12)) for fold in folds)
    log_det = 2.0 * np.log(np.stack(lengths, axis=-1)) + cosines
    log_det[..., 1:] += sines
    return np.asarray(log_det)


def other_branch(theta: Float[np.ndarray, "*batch 4"]) -> Float[np.ndarray, "*batch 4"]:
    """The other angles (…, 4) [rad] of the same arm, not wrapped: (θ1, θ2, θ3, θ4) ↦ (θ1 + π, π − θ2, θ3 + π, θ4)."""
    other = np.array(theta, dtype=np.float64)
    other[..., :3] = np.pi + theta[..., :3] * np.array([1.0, -1.0, 1.0])
    return other


def coordinates_from_postures(postures: Postures) -> Postures:
    """Smooth coordinates for regression: (θ3, θ4) of each arm become (θ4 cos θ3, θ4 sin θ3).

    θ3 is undefined at a straight elbow; these two are smooth there. |∂coordinates/∂posture| = θ4 an arm.
    Returns (…, 18) the same numbers with places 8, 9 and 14, 15 replaced [rad].
    """
    coordinates = np.array(postures, dtype=np.float64)
    theta3, theta4 = postures[..., AXIAL], postures[..., ELBOW]
    coordinates[..., AXIAL], coordinates[..., ELBOW] = theta4 * np.cos(theta3), theta4 * np.sin(theta3)
    return coordinates


def postures_from_coordinates(coordinates: Postures) -> Postures:
    """Postures (…, 18) of smooth coordinates: θ4 = |(a, b)|, θ3 = atan2(b, a) in [−π, π], 0 at a straight elbow."""
    postures = np.array(coordinates, dtype=np.float64)
    a, b = coordinates[..., AXIAL], coordinates[..., ELBOW]
    postures[..., AXIAL], postures[..., ELBOW] = np.arctan2(b, a), np.hypot(a, b)
    return postures
