"""Compiled: exact distances of the whole arm, as capsules, to persons, to the scene and to itself."""

from __future__ import annotations

import math
from typing import no_type_check

import numpy as np
from numba import njit

from kinecast.geometry.distances import segment_distance
from kinecast.robot.distances import segments_apart
from kinecast.robot.kinematics import joint_frames, site_position

__all__ = ["arm_clearances", "arm_ends", "edge_is_free"]


@njit(cache=True)
@no_type_check
def arm_ends(q: np.ndarray, arm: tuple[np.ndarray, ...], frames: np.ndarray, ends: np.ndarray) -> None:
    """Writes the starts, then the ends (2 L, 3) of the capsules' axes at one configuration (6,).

    `arm` is base (3, 4), joint origins (6, 3, 4), capsule sites (2 L, 3), their joints (L,), radii (L,), pairs of
    capsules that may meet (M, 2), and the pedestal (7,), which counts as capsule −1.
    """
    joint_frames(q, arm[0], arm[1], frames)
    links = len(arm[3])
    for k in range(2 * links):
        x, y, z = site_position(frames[arm[3][k % links]], arm[2][k])
        ends[k, 0], ends[k, 1], ends[k, 2] = x, y, z


@njit(cache=True)
@no_type_check
def _apart(
    a: np.ndarray, b: np.ndarray, radius: float, c: np.ndarray, d: np.ndarray, other: float, least: float
) -> float:
    """Distance [m] between two capsules if it is less than `least`; else `least`."""
    squared, half, rest = 0.0, 0.0, 0.0
    for i in range(3):
        squared += (0.5 * (a[i] + b[i] - c[i] - d[i])) ** 2
        half += (0.5 * (b[i] - a[i])) ** 2
        rest += (0.5 * (d[i] - c[i])) ** 2
    if math.sqrt(squared) - math.sqrt(half) - math.sqrt(rest) - radius - other >= least:
        return least
    return min(least, segments_apart(a, b, c, d) - radius - other)


@njit(cache=True)
@no_type_check
def _clearances(
    ends: np.ndarray,
    arm: tuple[np.ndarray, ...],
    capsules: np.ndarray,
    obstacles: np.ndarray,
    first_link: np.ndarray,
    most: tuple[float, float, float],
) -> tuple[float, float, float]:
    """Distances [m] to persons, scene and itself, each no more than its `most`."""
    radius, pairs, pedestal = arm[4], arm[5], arm[6]
    links = len(radius)
    person, scene, own = most
    for k in range(links):
        a, b = ends[k], ends[links + k]
        for c in range(len(capsules)):
            row = capsules[c]
            person = _apart(a, b, radius[k], row[:3], row[3:6], row[6], person)
        start, end = (a[0], a[1], a[2]), (b[0], b[1], b[2])
        for o in range(len(obstacles)):
            if k >= first_link[o]:
                scene = min(scene, segment_distance(obstacles[o], start, end) - radius[k])
    for m in range(len(pairs)):
        k, other = pairs[m, 0], pairs[m, 1]
        a, b = ends[k], ends[links + k]
        if other < 0:
            own = _apart(a, b, radius[k], pedestal[:3], pedestal[3:6], pedestal[6], own)
        else:
            own = _apart(a, b, radius[k], ends[other], ends[links + other], radius[other], own)
    return person, scene, own


@njit(cache=True)
@no_type_check
def arm_clearances(
    q: np.ndarray,
    arm: tuple[np.ndarray, ...],
    capsules: np.ndarray,
    obstacles: np.ndarray,
    first_link: np.ndarray,
    most: float,
) -> np.ndarray:
    """(N, 3) distances [m] to persons, to the scene and to itself at configurations (N, 6), each no more than `most`.

    Args:
        q: (N, 6) [rad].
        arm: as in `arm_ends`.
        capsules: (N, K, 7) of persons.
        obstacles: (N, O, 17).
        first_link: (O,) the first link each obstacle counts for.
        most: distances beyond it are not looked for.
    """
    out = np.empty((len(q), 3))
    frames = np.empty((6, 3, 4))
    ends = np.empty((2 * len(arm[3]), 3))
    for n in range(len(q)):
        arm_ends(q[n], arm, frames, ends)
        found = _clearances(ends, arm, capsules[n], obstacles[n], first_link, (most, most, most))
        out[n, 0], out[n, 1], out[n, 2] = found
    return out


@njit(cache=True)
@no_type_check
def edge_is_free(
    start: np.ndarray,
    end: np.ndarray,
    step: float,
    arm: tuple[np.ndarray, ...],
    capsules: np.ndarray,
    obstacles: np.ndarray,
    first_link: np.ndarray,
    margins: tuple[float, float, float],
) -> bool:
    """Whether the straight way between two configurations keeps the margins, looked at every `step` [rad].

    Args:
        start, end: (6,) [rad]; the start itself is not looked at.
        step: largest change of an angle between two looks [rad].
        arm: as in `arm_ends`.
        capsules: (K, 7), all in the way all the time.
        obstacles: (O, 17).
        first_link: (O,).
        margins: from persons, the scene and itself [m].
    """
    frames = np.empty((6, 3, 4))
    ends = np.empty((2 * len(arm[3]), 3))
    q = np.empty(6)
    count = max(math.ceil(np.abs(end - start).max() / step), 1)
    stride = 1
    while stride < count:
        stride *= 2
    # The middle first, then the quarters: what is in the way is found early.
    while stride >= 1:
        look = stride
        while look <= count:
            if (look // stride) % 2 == 1 or look == count:
                for j in range(6):
                    q[j] = start[j] + (end[j] - start[j]) * look / count
                arm_ends(q, arm, frames, ends)
                person, scene, own = _clearances(ends, arm, capsules, obstacles, first_link, margins)
                if person < margins[0] or scene < margins[1] or own < margins[2]:
                    return False
            look += stride
        stride //= 2
    return True
