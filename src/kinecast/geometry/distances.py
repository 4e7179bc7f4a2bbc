"""Compiled signed distances of points and limbs to obstacles.

Two kinds of obstacle suffice. A half-space; and a box whose surface is moved outwards by a radius, since a
capsule is such a box without width and depth, and a sphere one without any size. Moving the surface of a
convex body outwards by r lowers its signed distance by exactly r, inside and outside, so all are exact.

An obstacle is one row of floats:

| columns | half-space | rounded box |
|---|---|---|
| 0 | 0 | 1 |
| 1:4 | a point of the surface [m] | centre [m] |
| 4:13 | outward normal, then zeros | rotation matrix, row by row; its columns are the box's axes |
| 13:16 | – | half extents along these axes [m] |
| 16 | – | radius [m] |
"""

from __future__ import annotations

import math
from typing import TypeAlias, no_type_check

import numpy as np
from numba import njit, prange
from numba.np.unsafe.ndarray import to_fixed_tuple

__all__ = [
    "HALF_SPACE",
    "ROUNDED_BOX",
    "ROW",
    "arms_are_free",
    "point_distance",
    "point_distances",
    "scene_distances",
    "segment_distance",
    "segment_distances",
]

HALF_SPACE = 0.0
ROUNDED_BOX = 1.0
ROW = 17
"""Floats per obstacle."""

TOUCHING = 1e-20
"""Squared distance [m^2] under which a segment may pass through a box: (1e-10 m)^2, beyond round-off."""

Point: TypeAlias = tuple[float, float, float]
Row: TypeAlias = tuple[float, ...]


@njit(cache=True)
@no_type_check
def _local(row: np.ndarray, p: Point) -> Point:
    """A world point in the box's own frame: Rᵀ (p − c)."""
    x, y, z = p[0] - row[1], p[1] - row[2], p[2] - row[3]
    return (
        row[4] * x + row[7] * y + row[10] * z,
        row[5] * x + row[8] * y + row[11] * z,
        row[6] * x + row[9] * y + row[12] * z,
    )


@njit(cache=True)
@no_type_check
def _height(row: np.ndarray, p: Point) -> float:
    """Distance of a point in front of a half-space: n · (p − p0)."""
    return row[4] * (p[0] - row[1]) + row[5] * (p[1] - row[2]) + row[6] * (p[2] - row[3])


@njit(cache=True)
@no_type_check
def _excess(x: float, half: float) -> float:
    """How far a coordinate lies beyond ± half, with its sign; 0 between."""
    return x - min(max(x, -half), half)


@njit(cache=True)
@no_type_check
def _depth(p: Point, h: Point) -> float:
    """max(|p| − h): minus the depth of a point inside the box, above 0 outside."""
    return max(abs(p[0]) - h[0], abs(p[1]) - h[1], abs(p[2]) - h[2])


@njit(cache=True)
@no_type_check
def _squared_outside(p: Point, h: Point) -> float:
    """Squared distance of a point to the box, 0 inside."""
    x, y, z = _excess(p[0], h[0]), _excess(p[1], h[1]), _excess(p[2], h[2])
    return x * x + y * y + z * z


@njit(cache=True)
@no_type_check
def _along(a: Point, d: Point, t: float) -> Point:
    return (a[0] + t * d[0], a[1] + t * d[1], a[2] + t * d[2])


@njit(cache=True)
@no_type_check
def _slope(a: Point, d: Point, h: Point, t: float) -> float:
    """Half the derivative of the squared distance along a + t d; rises with t, linear between faces."""
    p = _along(a, d, t)
    return d[0] * _excess(p[0], h[0]) + d[1] * _excess(p[1], h[1]) + d[2] * _excess(p[2], h[2])


@njit(cache=True)
@no_type_check
def _closest(a: Point, d: Point, h: Point) -> float:
    """The t in [0, 1] at which a + t d is closest to the box, exact.

    The squared distance to a convex body is convex along a line, and here quadratic between the six places
    where the line crosses a face's plane. Each crossing halves the bracket of the slope's zero; between the
    last two the slope is linear.
    """
    low, high = 0.0, 1.0
    at_low, at_high = _slope(a, d, h, low), _slope(a, d, h, high)
    if at_low >= 0.0:
        return low
    if at_high <= 0.0:
        return high
    for axis in range(3):
        if d[axis] != 0.0:
            for side in (-1.0, 1.0):
                t = (side * h[axis] - a[axis]) / d[axis]
                if low < t < high:
                    slope = _slope(a, d, h, t)
                    if slope < 0.0:
                        low, at_low = t, slope
                    else:
                        high, at_high = t, slope
    return low + (high - low) * at_low / (at_low - at_high)


@njit(cache=True)
@no_type_check
def _deepest(a: Point, d: Point, h: Point) -> float:
    """Least max(|p| − h) along a + t d, exact: the lowest point of an upper envelope of six lines.

    It lies at an end or where two of the lines cross.
    """
    best = min(_depth(a, h), _depth(_along(a, d, 1.0), h))
    for i in range(6):
        offset, slope = (a[i // 2], d[i // 2]) if i % 2 else (-a[i // 2], -d[i // 2])
        for j in range(i):
            other, other_slope = (a[j // 2], d[j // 2]) if j % 2 else (-a[j // 2], -d[j // 2])
            if slope != other_slope:
                t = ((other - h[j // 2]) - (offset - h[i // 2])) / (slope - other_slope)
                if 0.0 < t < 1.0:
                    best = min(best, _depth(_along(a, d, t), h))
    return best


@njit(cache=True)
@no_type_check
def point_distance(row: np.ndarray, p: Point) -> float:
    """Signed distance [m] of a point to one obstacle, above 0 outside, exact everywhere."""
    if row[0] == HALF_SPACE:
        return _height(row, p)
    q = _local(row, p)
    h = (row[13], row[14], row[15])
    outside = _squared_outside(q, h)
    return (math.sqrt(outside) if outside > 0.0 else _depth(q, h)) - row[16]


@njit(cache=True)
@no_type_check
def segment_distance(row: np.ndarray, a: Point, b: Point) -> float:
    """Least signed distance [m] over the points of a segment to one obstacle, exact."""
    if row[0] == HALF_SPACE:
        return min(_height(row, a), _height(row, b))
    p, q = _local(row, a), _local(row, b)
    d = (q[0] - p[0], q[1] - p[1], q[2] - p[2])
    h = (row[13], row[14], row[15])
    outside = _squared_outside(_along(p, d, _closest(p, d, h)), h)
    distance = math.sqrt(outside)
    if outside < TOUCHING:
        distance = min(distance, _deepest(p, d, h))
    return distance - row[16]


@njit(cache=True)
@no_type_check
def _stays_out(p: Point, q: Point, h: Point, reach: float) -> bool:
    """Whether a segment in the box's frame keeps more than `reach` away from the box."""
    if (  # wholly beyond one face: most limbs, most of the time
        abs(p[0] + q[0]) - abs(p[0] - q[0]) > 2.0 * (h[0] + reach)
        or abs(p[1] + q[1]) - abs(p[1] - q[1]) > 2.0 * (h[1] + reach)
        or abs(p[2] + q[2]) - abs(p[2] - q[2]) > 2.0 * (h[2] + reach)
    ):
        return True
    d = (q[0] - p[0], q[1] - p[1], q[2] - p[2])
    return _squared_outside(_along(p, d, _closest(p, d, h)), h) > max(reach * reach, TOUCHING)


@njit(cache=True)
@no_type_check
def point_distances(row: np.ndarray, points: np.ndarray) -> np.ndarray:
    """(N,) signed distances of (N, 3) points to one obstacle."""
    distances = np.empty(len(points))
    for n in range(len(points)):
        distances[n] = point_distance(row, (points[n, 0], points[n, 1], points[n, 2]))
    return distances


@njit(cache=True)
@no_type_check
def segment_distances(row: np.ndarray, starts: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """(N,) signed distances of (N, 3) to (N, 3) segments to one obstacle."""
    distances = np.empty(len(starts))
    for n in range(len(starts)):
        a = (starts[n, 0], starts[n, 1], starts[n, 2])
        b = (ends[n, 0], ends[n, 1], ends[n, 2])
        distances[n] = segment_distance(row, a, b)
    return distances


@njit(cache=True)
@no_type_check
def scene_distances(rows: np.ndarray, points: np.ndarray) -> np.ndarray:
    """(S, T, J) distances of (S, T, J, 3) points to the nearest of the obstacles (T, O, ROW) of each time."""
    samples, times, joints = points.shape[:3]
    distances = np.full((samples, times, joints), np.inf)
    for s in range(samples):
        for t in range(times):
            for j in range(joints):
                p = (points[s, t, j, 0], points[s, t, j, 1], points[s, t, j, 2])
                for o in range(rows.shape[1]):
                    distance = point_distance(rows[t, o], p)
                    if not distance >= distances[s, t, j]:  # a NaN stays
                        distances[s, t, j] = distance
    return distances


LANES = 32
"""Samples tested side by side: a loop over them without branches becomes vector instructions."""
COORDINATES = 18
"""Of the six joints, a row of lanes each."""


@njit(cache=True, parallel=True)
@no_type_check
def arms_are_free(rows: np.ndarray, arms: np.ndarray, radius: float) -> np.ndarray:
    """(S, T) whether no limb of (S, T, 6, 3) arm joints touches an obstacle (T, O, ROW) of its time.

    Most arms lie wholly beyond one face of most obstacles: that is found out for all lanes at once. The others are
    looked at one by one. An arm with a NaN is not free: nobody knows.
    """
    samples, times = arms.shape[:2]
    free = np.empty((samples, times), dtype=np.bool_)
    for block in prange((samples + LANES - 1) // LANES):
        first, count = block * LANES, min(LANES, samples - block * LANES)
        points = np.zeros(COORDINATES * LANES)
        beyond = np.zeros(LANES, dtype=np.bool_)
        for t in range(times):
            for lane in range(count):
                known = 0.0
                for j in range(6):
                    x, y, z = arms[first + lane, t, j, 0], arms[first + lane, t, j, 1], arms[first + lane, t, j, 2]
                    known += x + y + z
                    at = 3 * j * LANES + lane
                    points[at], points[at + LANES], points[at + 2 * LANES] = x, y, z
                free[first + lane, t] = not math.isnan(known)
            for o in range(rows.shape[1]):
                row = to_fixed_tuple(rows[t, o], ROW)  # in registers, for all lanes
                for shoulder in (0, 3):
                    _beyond_a_face(row, points[3 * shoulder * LANES :], radius, beyond)
                    for lane in range(count):
                        if not beyond[lane] and free[first + lane, t]:
                            free[first + lane, t] = _arm_is_free(row, arms, first + lane, t, shoulder, radius)
    return free


@njit(cache=True, fastmath={"contract"})
@no_type_check
def _beyond_a_face(row: Row, points: np.ndarray, radius: float, beyond: np.ndarray) -> None:
    """In which lanes all three joints lie beyond the same face of an obstacle, by more than the radius."""
    flat = row[0] == HALF_SPACE
    beyond[:] = False
    for axis in range(1 if flat else 3):
        # A half-space has one face, whose normal stands where a box has the first row of its rotation.
        nx, ny, nz = (row[4], row[5], row[6]) if flat else (row[4 + axis], row[7 + axis], row[10 + axis])
        offset = nx * row[1] + ny * row[2] + nz * row[3]
        near = radius if flat else radius + row[16] + row[13 + axis]
        far = -math.inf if flat else -near
        for lane in range(LANES):
            a = nx * points[lane] + ny * points[lane + LANES] + nz * points[lane + 2 * LANES] - offset
            b = nx * points[lane + 3 * LANES] + ny * points[lane + 4 * LANES] + nz * points[lane + 5 * LANES] - offset
            c = nx * points[lane + 6 * LANES] + ny * points[lane + 7 * LANES] + nz * points[lane + 8 * LANES] - offset
            beyond[lane] |= ((a > near) & (b > near) & (c > near)) | ((a < far) & (b < far) & (c < far))


@njit(cache=True)
@no_type_check
def _arm_is_free(row: Row, arms: np.ndarray, s: int, t: int, first: int, radius: float) -> bool:
    """Whether the upper arm and forearm from shoulder joint `first` on stay clear of one obstacle."""
    shoulder = (arms[s, t, first, 0], arms[s, t, first, 1], arms[s, t, first, 2])
    elbow = (arms[s, t, first + 1, 0], arms[s, t, first + 1, 1], arms[s, t, first + 1, 2])
    wrist = (arms[s, t, first + 2, 0], arms[s, t, first + 2, 1], arms[s, t, first + 2, 2])
    if row[0] == HALF_SPACE:
        return min(_height(row, shoulder), _height(row, elbow), _height(row, wrist)) > radius
    p, q, r = _local(row, shoulder), _local(row, elbow), _local(row, wrist)
    h = (row[13], row[14], row[15])
    reach = radius + row[16]
    return _stays_out(p, q, h, reach) and _stays_out(q, r, h, reach)
