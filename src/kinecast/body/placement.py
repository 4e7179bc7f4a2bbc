"""Where many postures put both arms in the world: forward kinematics and the torso's place in one pass."""

from __future__ import annotations

from typing import no_type_check

import numpy as np
from jaxtyping import Float
from numba import njit, prange

from kinecast.body.arm_angles import LEFT, RIGHT, arm_vectors
from kinecast.body.elementary import sine_cosine
from kinecast.body.posture import POSTURE_SIZE, out_of_torso

__all__ = ["moved", "placed"]

LANES = 64
"""Postures handled side by side, one number of each next to the other, so that loops become vector instructions."""
SIZE = POSTURE_SIZE * LANES


def placed(
    postures: Float[np.ndarray, "*batch 18"], rotation: Float[np.ndarray, "3 3"], origin: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "*batch 6 3"]:
    """Arms of postures in the world: R · points_from_postures(postures) + o.

    Args:
        postures: (…, 18) postures (kinecast.body.posture).
        rotation, origin: of the reference torso frame in the world [m].
    """
    points = np.empty((*postures.shape[:-1], 6, 3))
    flat = np.ascontiguousarray(postures, dtype=np.float64).reshape(-1, POSTURE_SIZE)
    _place(flat, np.ascontiguousarray(rotation), np.ascontiguousarray(origin), points.reshape(-1, POSTURE_SIZE))
    return points


def moved(
    points: Float[np.ndarray, "*batch 3"], rotation: Float[np.ndarray, "3 3"], shift: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "*batch 3"]:
    """R · p + s for every point.

    Args:
        points: (…, 3) [m].
        rotation, shift: of the motion [m].
    """
    out = np.empty(points.shape)
    flat = np.ascontiguousarray(points, dtype=np.float64).reshape(-1, 3)
    _move(flat, np.ascontiguousarray(rotation), np.ascontiguousarray(shift), out.reshape(-1, 3))
    return out


@njit(cache=True)
@no_type_check
def _move(
    points: Float[np.ndarray, "K 3"],
    rotation: Float[np.ndarray, "3 3"],
    shift: Float[np.ndarray, "3"],
    out: Float[np.ndarray, "K 3"],
) -> None:
    for k in range(len(points)):
        x, y, z = points[k, 0], points[k, 1], points[k, 2]
        for i in range(3):
            out[k, i] = rotation[i, 0] * x + rotation[i, 1] * y + rotation[i, 2] * z + shift[i]


@njit(cache=True, parallel=True)
@no_type_check
def _place(
    postures: Float[np.ndarray, "K 18"],
    rotation: Float[np.ndarray, "3 3"],
    origin: Float[np.ndarray, "3"],
    points: Float[np.ndarray, "K 18"],
) -> None:
    for block in prange((len(postures) + LANES - 1) // LANES):
        first = block * LANES
        count = min(LANES, len(postures) - first)
        numbers, places = np.zeros(SIZE), np.empty(SIZE)
        for lane in range(count):
            for i in range(POSTURE_SIZE):
                numbers[i * LANES + lane] = postures[first + lane, i]
        _place_arm(numbers, numbers[6 * LANES :], LEFT, rotation, origin, places)
        _place_arm(numbers, numbers[12 * LANES :], RIGHT, rotation, origin, places[9 * LANES :])
        for lane in range(count):
            for i in range(POSTURE_SIZE):
                points[first + lane, i] = places[i * LANES + lane]


@njit(cache=True, fastmath={"contract"})
@no_type_check
def _place_arm(
    torso: Float[np.ndarray, " K"],
    arm: Float[np.ndarray, " K"],
    side: float,
    rotation: Float[np.ndarray, "3 3"],
    origin: Float[np.ndarray, "3"],
    points: Float[np.ndarray, " K"],
) -> None:
    """One arm's points in every lane: number i of lane k is at LANES i + k, in all three arrays."""
    r00, r01, r02 = rotation[0, 0], rotation[0, 1], rotation[0, 2]
    r10, r11, r12 = rotation[1, 0], rotation[1, 1], rotation[1, 2]
    r20, r21, r22 = rotation[2, 0], rotation[2, 1], rotation[2, 2]
    o0, o1, o2 = origin[0], origin[1], origin[2]
    for k in range(LANES):
        sy, cy = sine_cosine(torso[3 * LANES + k])
        sr, cr = sine_cosine(torso[4 * LANES + k])
        half = 0.5 * side * torso[5 * LANES + k]
        x = torso[k] - half * sy * cr
        y = torso[LANES + k] + half * cy * cr
        z = torso[2 * LANES + k] + half * sr
        points[k] = r00 * x + r01 * y + r02 * z + o0
        points[LANES + k] = r10 * x + r11 * y + r12 * z + o1
        points[2 * LANES + k] = r20 * x + r21 * y + r22 * z + o2

        theta = (arm[k], arm[LANES + k], arm[2 * LANES + k], arm[3 * LANES + k])
        upper, fore = arm_vectors(theta, arm[4 * LANES + k], arm[5 * LANES + k], side)
        u0, u1, u2 = out_of_torso(upper, sy, cy, sr, cr)
        x, y, z = x + u0, y + u1, z + u2
        points[3 * LANES + k] = r00 * x + r01 * y + r02 * z + o0
        points[4 * LANES + k] = r10 * x + r11 * y + r12 * z + o1
        points[5 * LANES + k] = r20 * x + r21 * y + r22 * z + o2

        f0, f1, f2 = out_of_torso(fore, sy, cy, sr, cr)
        x, y, z = x + f0, y + f1, z + f2
        points[6 * LANES + k] = r00 * x + r01 * y + r02 * z + o0
        points[7 * LANES + k] = r10 * x + r11 * y + r12 * z + o1
        points[8 * LANES + k] = r20 * x + r21 * y + r22 * z + o2
