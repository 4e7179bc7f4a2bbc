"""Compiled: capsules that hold each part of a body in a share of all samples."""

from __future__ import annotations

import math
from typing import no_type_check

import numpy as np
from numba import njit

__all__ = ["STARTS", "STOPS", "body_points", "regions"]

STARTS = np.array([0, 1, 2, 3, 4, 5, 0, 8, 10])
STOPS = np.array([1, 2, 6, 4, 5, 7, 3, 9, 10])
"""Ends of each part (kinecast.robot.occupancy.PARTS), as columns of eleven points: the six arm joints, the left and the
right hand's middle, mid-shoulders, hips, the middle of the head."""


@njit(cache=True)
@no_type_check
def regions(
    samples: np.ndarray, hand_length: float, trunk_length: float, head_height: float, level: float
) -> np.ndarray:
    """(T, 9, 7) start, end and radius [m] of a capsule for each part, about its mean place.

    A capsule is convex: a limb lies inside as soon as both its ends lie within the radius of the axis's ends.

    Args:
        samples: (S, T, 6, 3) arm joints [m].
        hand_length: from the wrist on along the forearm [m].
        trunk_length: from mid-shoulders down [m].
        head_height: from mid-shoulders up [m].
        level: the share of samples held, in (0, 1].
    """
    count, steps = samples.shape[:2]
    out = np.zeros((steps, 9, 7))
    points = np.empty((count, 11, 3))
    reach = np.empty(count)
    held = min(max(math.ceil(level * count - 1e-9), 1), count) - 1
    for t in range(steps):
        for s in range(count):
            _points(samples[s, t], hand_length, trunk_length, head_height, points[s])
        for k in range(9):
            first, last = STARTS[k], STOPS[k]
            for s in range(count):
                for i in range(3):
                    out[t, k, i] += points[s, first, i]
                    out[t, k, 3 + i] += points[s, last, i]
            out[t, k] /= count
            for s in range(count):
                start, end = 0.0, 0.0
                for i in range(3):
                    start += (points[s, first, i] - out[t, k, i]) ** 2
                    end += (points[s, last, i] - out[t, k, 3 + i]) ** 2
                reach[s] = max(start, end)
            out[t, k, 6] = math.sqrt(_ranked(reach, held))
    return out


@njit(cache=True)
@no_type_check
def body_points(arms: np.ndarray, hand_length: float, trunk_length: float, head_height: float) -> np.ndarray:
    """(N, 11, 3) points of bodies whose arm joints are (N, 6, 3) [m]; lengths as in `regions`."""
    points = np.empty((len(arms), 11, 3))
    for n in range(len(arms)):
        _points(arms[n], hand_length, trunk_length, head_height, points[n])
    return points


@njit(cache=True)
@no_type_check
def _ranked(values: np.ndarray, rank: int) -> float:
    """The value with `rank` smaller ones; puts the values in another order (C. A. R. Hoare's quickselect)."""
    low, high = 0, len(values) - 1
    while low < high:
        pivot = values[(low + high) // 2]
        i, j = low, high
        while i <= j:
            while values[i] < pivot:
                i += 1
            while values[j] > pivot:
                j -= 1
            if i <= j:
                values[i], values[j] = values[j], values[i]
                i += 1
                j -= 1
        if rank <= j:
            high = j
        elif rank >= i:
            low = i
        else:
            break
    return values[rank]


@njit(cache=True)
@no_type_check
def _points(arms: np.ndarray, hand_length: float, trunk_length: float, head_height: float, points: np.ndarray) -> None:
    """Writes the eleven points (11, 3) of one body from its arm joints (6, 3)."""
    points[:6] = arms
    for side in range(2):
        elbow, wrist = arms[3 * side + 1], arms[3 * side + 2]
        length = math.sqrt((wrist[0] - elbow[0]) ** 2 + (wrist[1] - elbow[1]) ** 2 + (wrist[2] - elbow[2]) ** 2)
        share = hand_length / max(length, 1e-9)
        for i in range(3):
            points[6 + side, i] = wrist[i] + share * (wrist[i] - elbow[i])
    for i in range(3):
        points[8:, i] = 0.5 * (arms[0, i] + arms[3, i])
    points[9, 2] -= trunk_length
    points[10, 2] += head_height
