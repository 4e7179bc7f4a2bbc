"""Posture: the six arm points (18 coordinates) as 18 numbers of the body, and back, exactly.

Points are in the reference torso frame (x forward, y from right to left shoulder, z up the torso), in the
order of `ARM_JOINTS`. With p the middle of the shoulders and d from the right to the left one,
d = w (−sin ψ cos ρ, cos ψ cos ρ, sin ρ), the torso turns by R = Rz(ψ) Rx(ρ), and each arm's angles
(kinecast.body.arm_angles) are read in the frame R.

| numbers | meaning | unit |
|---|---|---|
| 0, 1, 2 | p, middle of the shoulders | m |
| 3, 4 | yaw ψ, roll ρ of the shoulder line | rad |
| 5 | w, shoulder width | m |
| 6 … 9 | left flexion, abduction, axial rotation, elbow flexion | rad |
| 10, 11 | left upper arm, forearm | m |
| 12 … 15 | right flexion, abduction, axial rotation, elbow flexion | rad |
| 16, 17 | right upper arm, forearm | m |
"""

from __future__ import annotations

import math
from typing import no_type_check

import numpy as np
from jaxtyping import Float
from numba import njit

from kinecast.body.arm_angles import (
    COINCIDENT,
    LEFT,
    OUTSIDE_WEIGHT,
    RIGHT,
    UNDEFINED,
    Vector,
    arm_angles,
    arm_vectors,
    nearest_turn,
)
from kinecast.body.elementary import sine_cosine

__all__ = [
    "ANGLES", "LEFT_ARM", "LENGTHS", "POSTURE_SIZE", "RIGHT_ARM", "WIDTH",
    "coordinates_from_postures", "into_torso", "log_det_jacobian", "other_branch", "out_of_torso",
    "points_from_postures", "points_of_posture", "posture_of_points", "postures_from_coordinates",
    "postures_from_points",
]  # fmt: skip

POSTURE_SIZE = 18
WIDTH = 5
LEFT_ARM = slice(6, 10)
RIGHT_ARM = slice(12, 16)
ANGLES = (6, 7, 8, 9, 12, 13, 14, 15)
"""Places of the eight arm angles in a posture."""
LENGTHS = (5, 10, 11, 16, 17)
"""Places of the lengths in a posture: shoulder width and the four bones."""


@njit(cache=True)
@no_type_check
def _difference(points: np.ndarray, tip: int, base: int) -> Vector:
    return (
        points[tip, 0] - points[base, 0],
        points[tip, 1] - points[base, 1],
        points[tip, 2] - points[base, 2],
    )


@njit(cache=True, forceinline=True)
@no_type_check
def into_torso(v: Vector, sy: float, cy: float, sr: float, cr: float) -> Vector:
    """Rᵀ v with R = Rz(ψ) Rx(ρ)."""
    level = cy * v[1] - sy * v[0]
    return cy * v[0] + sy * v[1], cr * level + sr * v[2], cr * v[2] - sr * level


@njit(cache=True, forceinline=True)
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
    """The posture of six points, on the branch nearest to the previous posture (kernel).

    Args:
        points: (6, 3) points in the reference torso frame [m]; a NaN point gives NaN where it is needed.
        previous: (18,) posture one step earlier; NaN for none, number by number.
        weight: of the usual range in the choice of the branch (kinecast.body.arm_angles).
        out: (18,) receives the posture; may be the same array as previous.
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
        theta = arm_angles(
            into_torso(upper, sy, cy, sr, cr),
            into_torso(fore, sy, cy, sr, cr),
            LEFT if arm == 0 else RIGHT,
            (previous[at], previous[at + 1], previous[at + 2], previous[at + 3]),
            weight,
        )
        out[at], out[at + 1], out[at + 2], out[at + 3] = theta
        out[at + 4] = _length(upper)
        out[at + 5] = _length(fore)


@njit(cache=True)
@no_type_check
def points_of_posture(posture: np.ndarray, out: np.ndarray) -> None:
    """The six points of a posture (kernel).

    Args:
        posture: (18,) posture.
        out: (6, 3) receives the points in the reference torso frame [m].
    """
    sy, cy = sine_cosine(posture[3])
    sr, cr = sine_cosine(posture[4])
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
    last = np.empty(18)
    for series in range(points.shape[0]):
        last[:] = previous[series]
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
    out = np.empty((series, frames, 18))
    _posture_series(
        np.ascontiguousarray(points, dtype=np.float64).reshape(series, frames, 6, 3),
        np.ascontiguousarray(start, dtype=np.float64),
        continuous,
        OUTSIDE_WEIGHT if usual else 0.0,
        out,
    )
    return out.reshape(*batch, frames, 18)


def points_from_postures(postures: Float[np.ndarray, "*batch 18"]) -> Float[np.ndarray, "*batch 6 3"]:
    """Points of postures: shoulders p ± d/2, elbows L1·R u from them, wrists L2·R f from the elbows.

    Args:
        postures: (…, 18) postures.

    Returns:
        (…, 6, 3) points in the reference torso frame [m], in the order of `ARM_JOINTS`.
    """
    flat = np.ascontiguousarray(postures, dtype=np.float64).reshape(-1, 18)
    out = np.empty((len(flat), 6, 3))
    _points_series(flat, out)
    return out.reshape(*postures.shape[:-1], 6, 3)


def log_det_jacobian(postures: Float[np.ndarray, "*batch 18"]) -> Float[np.ndarray, "*batch"]:
    """log |∂points/∂posture| = log(w² cos ρ) + Σ_arms log(L1² |cos θ2| L2² |sin θ4|).

    The density of points is that of postures divided by this determinant.

    Args:
        postures: (…, 18) postures.

    Returns:
        (…) natural logarithm; −inf at a straight elbow, a sideways arm or an upright shoulder line.
    """
    squared = postures[..., list(LENGTHS)]
    single = np.stack(
        [
            np.cos(postures[..., 4]),
            np.cos(postures[..., 7]), np.sin(postures[..., 9]),
            np.cos(postures[..., 13]), np.sin(postures[..., 15]),
        ],
        axis=-1,
    )  # fmt: skip
    with np.errstate(divide="ignore"):
        logs = 2.0 * np.log(np.abs(squared)) + np.log(np.abs(single))
    return np.asarray(logs.sum(axis=-1))


def other_branch(theta: Float[np.ndarray, "*batch 4"]) -> Float[np.ndarray, "*batch 4"]:
    """The other angles of the same arm: (θ1, θ2, θ3, θ4) ↦ (θ1 + π, π − θ2, θ3 + π, θ4).

    Args:
        theta: (…, 4) angles of one arm [rad].

    Returns:
        (…, 4) angles [rad], not wrapped.
    """
    other = np.array(theta, dtype=np.float64)
    other[..., :3] = np.pi + theta[..., :3] * np.array([1.0, -1.0, 1.0])
    return other


def coordinates_from_postures(postures: Float[np.ndarray, "*batch 18"]) -> Float[np.ndarray, "*batch 18"]:
    """Smooth coordinates for regression: (θ3, θ4) of each arm become (θ4 cos θ3, θ4 sin θ3).

    θ3 is undefined at a straight elbow; these two are smooth there. |∂coordinates/∂posture| = θ4 an arm.

    Args:
        postures: (…, 18) postures.

    Returns:
        (…, 18) the same numbers with places 8, 9 and 14, 15 replaced [rad].
    """
    coordinates = np.array(postures, dtype=np.float64)
    for at in (8, 14):
        theta3, theta4 = postures[..., at], postures[..., at + 1]
        coordinates[..., at] = theta4 * np.cos(theta3)
        coordinates[..., at + 1] = theta4 * np.sin(theta3)
    return coordinates


def postures_from_coordinates(coordinates: Float[np.ndarray, "*batch 18"]) -> Float[np.ndarray, "*batch 18"]:
    """Postures of smooth coordinates: θ4 = |(a, b)|, θ3 = atan2(b, a) in [−π, π], 0 at a straight elbow.

    Args:
        coordinates: (…, 18) from `coordinates_from_postures`.

    Returns:
        (…, 18) postures.
    """
    postures = np.array(coordinates, dtype=np.float64)
    for at in (8, 14):
        a, b = coordinates[..., at], coordinates[..., at + 1]
        postures[..., at] = np.arctan2(b, a)
        postures[..., at + 1] = np.hypot(a, b)
    return postures
