"""Compiled signed distances of points and limbs to obstacles: > 0 is free, exact outside and inside.

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
from jaxtyping import Float, Int
from numba import njit

HALF_SPACE = 0.0
ROUNDED_BOX = 1.0
ROW = 17  # floats per obstacle
TOUCHING = 1e-20  # squared distance [m^2] under which a segment may pass through a box: (1e-10 m)^2, beyond round-off

Point: TypeAlias = tuple[float, float, float]


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
    return x + half if x < -half else x - half if x > half else 0.0


@njit(cache=True)
@no_type_check
def _depth(a: Point, d: Point, h: Point, t: float) -> float:
    """max(|p| − h) at p = a + t d: minus the depth of a point inside the box, above 0 outside."""
    return max(abs(a[0] + t * d[0]) - h[0], abs(a[1] + t * d[1]) - h[1], abs(a[2] + t * d[2]) - h[2])


@njit(cache=True)
@no_type_check
def _squared(a: Point, d: Point, h: Point, t: float) -> tuple[float, float]:
    """Squared distance of a + t d to the box, 0 inside, and half its derivative by t.

    The derivative rises with t, and is linear between the planes of the faces.
    """
    x, y, z = _excess(a[0] + t * d[0], h[0]), _excess(a[1] + t * d[1], h[1]), _excess(a[2] + t * d[2], h[2])
    return x * x + y * y + z * z, x * d[0] + y * d[1] + z * d[2]


@njit(cache=True)
@no_type_check
def _closest(a: Point, d: Point, h: Point) -> float:
    """The t in [0, 1] at which a + t d is closest to the box, exact.

    The squared distance to a convex body is convex along a line, and here quadratic between the six places
    where the line crosses a face's plane. Each crossing halves the bracket of the slope's zero; between the
    last two the slope is linear.
    """
    low, high = 0.0, 1.0
    at_low, at_high = _squared(a, d, h, low)[1], _squared(a, d, h, high)[1]
    if at_low >= 0.0:
        return low
    if at_high <= 0.0:
        return high
    for axis in range(3):
        if d[axis] != 0.0:
            for side in (-1.0, 1.0):
                t = (side * h[axis] - a[axis]) / d[axis]
                if low < t < high:
                    slope = _squared(a, d, h, t)[1]
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
    best = min(_depth(a, d, h, 0.0), _depth(a, d, h, 1.0))
    for i in range(6):
        offset, slope = (a[i // 2], d[i // 2]) if i % 2 else (-a[i // 2], -d[i // 2])
        for j in range(i):
            other, other_slope = (a[j // 2], d[j // 2]) if j % 2 else (-a[j // 2], -d[j // 2])
            if slope != other_slope:
                t = ((other - h[j // 2]) - (offset - h[i // 2])) / (slope - other_slope)
                if 0.0 < t < 1.0:
                    best = min(best, _depth(a, d, h, t))
    return best


@njit(cache=True)
@no_type_check
def _box_distance(row: np.ndarray, start: Point, end: Point) -> float:
    """Least signed distance [m] over the points of a segment to one rounded box, exact."""
    a, b = _local(row, start), _local(row, end)
    d = (b[0] - a[0], b[1] - a[1], b[2] - a[2])
    h = (row[13], row[14], row[15])
    squared = _squared(a, d, h, _closest(a, d, h))[0]
    distance = math.sqrt(squared)
    if squared < TOUCHING:
        distance = min(distance, _deepest(a, d, h))
    return distance - row[16]


@njit(cache=True)
@no_type_check
def point_distance(row: np.ndarray, p: Point) -> tuple[float, Point]:
    """Signed distance [m] of a point to one obstacle, exact, and its gradient, of length 1."""
    if row[0] == HALF_SPACE:
        return _height(row, p), (row[4], row[5], row[6])
    a = _local(row, p)
    x, y, z = _excess(a[0], row[13]), _excess(a[1], row[14]), _excess(a[2], row[15])
    distance = math.sqrt(x * x + y * y + z * z)
    if distance * distance > TOUCHING:
        x, y, z = x / distance, y / distance, z / distance
    else:  # inside: out through the nearest face
        u, v, w = abs(a[0]) - row[13], abs(a[1]) - row[14], abs(a[2]) - row[15]
        distance = max(u, v, w)
        x = math.copysign(1.0, a[0]) if u == distance else 0.0
        y = math.copysign(1.0, a[1]) if x == 0.0 and v == distance else 0.0
        z = math.copysign(1.0, a[2]) if x == 0.0 and y == 0.0 else 0.0
    return distance - row[16], (
        row[4] * x + row[5] * y + row[6] * z,
        row[7] * x + row[8] * y + row[9] * z,
        row[10] * x + row[11] * y + row[12] * z,
    )


@njit(cache=True)
@no_type_check
def _nearest(
    rows: np.ndarray, half: np.ndarray, points: np.ndarray, limbs: np.ndarray, most: float, out: np.ndarray
) -> None:
    """`half` (T, O, 3) are half widths of upright boxes around rounded boxes: most limbs are off."""
    for s in range(out.shape[0]):
        for t in range(out.shape[1]):
            for k in range(out.shape[2]):
                i, j = limbs[k, 0], limbs[k, 1]
                ax, ay, az = points[s, t, i, 0], points[s, t, i, 1], points[s, t, i, 2]
                bx, by, bz = points[s, t, j, 0], points[s, t, j, 1], points[s, t, j, 2]
                nearest = most
                for o in range(rows.shape[1]):
                    cx, cy, cz = rows[t, o, 1], rows[t, o, 2], rows[t, o, 3]
                    if rows[t, o, 0] == HALF_SPACE:
                        start, end = _height(rows[t, o], (ax, ay, az)), _height(rows[t, o], (bx, by, bz))
                        nearest = min(nearest, start, end)
                        continue
                    x, y, z = half[t, o, 0] + nearest, half[t, o, 1] + nearest, half[t, o, 2] + nearest
                    if (
                        (ax - cx > x and bx - cx > x) or (cx - ax > x and cx - bx > x)
                        or (ay - cy > y and by - cy > y) or (cy - ay > y and cy - by > y)
                        or (az - cz > z and bz - cz > z) or (cz - az > z and cz - bz > z)
                    ):  # fmt: skip
                        continue
                    distance = _box_distance(rows[t, o], (ax, ay, az), (bx, by, bz))
                    if distance < nearest:
                        nearest = distance
                out[s, t, k] = math.nan if math.isnan(ax + ay + az + bx + by + bz) else nearest


def limb_distances(
    rows: Float[np.ndarray, "T O 17"],
    points: Float[np.ndarray, "*batch T J 3"],
    limbs: Int[np.ndarray, "L 2"],
    most: float = math.inf,
) -> Float[np.ndarray, "*batch T L"]:
    """Distances [m] of limbs to the nearest obstacle of their time; those from `most` on are `most`.

    Args:
        rows: (T, O, ROW) obstacles at each time.
        points: (…, T, J, 3) [m].
        limbs: (L, 2) the points each limb goes from and to; they may be one.

    Returns:
        (…, T, L) [m]; NaN where a coordinate is NaN.
    """
    batch, shape = points.shape[:-3], points.shape[-3:]
    half = (np.abs(rows[..., 4:13]).reshape(*rows.shape[:2], 3, 3) @ rows[..., 13:16, None])[..., 0] + rows[..., 16:]
    out = np.empty((math.prod(batch), shape[0], len(limbs)))
    _nearest(rows, half, np.ascontiguousarray(points, dtype=np.float64).reshape(len(out), *shape), limbs, most, out)
    return out.reshape(*batch, shape[0], len(limbs))
