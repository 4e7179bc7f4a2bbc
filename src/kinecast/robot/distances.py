"""Compiled distances between moving capsules, obstacles and the arm.

Capsules of a person are rows of seven floats: start (3), end (3), radius [m]. Obstacles are rows of
kinecast.geometry.distances.
"""

from __future__ import annotations

import math
from typing import no_type_check

import numpy as np
from numba import njit

from kinecast.geometry.distances import HALF_SPACE

__all__ = ["capsules_at", "columns", "nearest_capsule", "nearest_obstacle", "segments_apart", "signed_distances"]

TOUCHING = 1e-12
"""Distance [m] under which two points are one, and a direction between them has no meaning."""


@njit(cache=True)
@no_type_check
def capsules_at(
    time: float, times: np.ndarray, capsules: np.ndarray, speed: float, limit: float, out: np.ndarray
) -> None:
    """Writes the capsules (K, 7) at one time [s] from those (T, K, 7) at `times` (T,).

    Straight from one to the next; the first before its time; past the last they grow at `speed` up to `limit`.
    """
    last = len(times) - 1
    before = 0
    while before < last and times[before + 1] <= time:
        before += 1
    after, share = before, 0.0
    if before < last and time > times[before]:
        after = before + 1
        share = (time - times[before]) / (times[after] - times[before])
    growth = min(max(time - times[last], 0.0) * speed, limit)
    for k in range(capsules.shape[1]):
        for i in range(7):
            a = capsules[before, k, i]
            out[k, i] = a + share * (capsules[after, k, i] - a)
        out[k, 6] += growth


@njit(cache=True)
@no_type_check
def columns(capsules: np.ndarray, out: np.ndarray) -> None:
    """Writes capsules (K, 7) as (8, K) columns: start, end − start, 1 / length², radius."""
    for k in range(len(capsules)):
        squared = 0.0
        for i in range(3):
            out[i, k] = capsules[k, i]
            out[3 + i, k] = capsules[k, 3 + i] - capsules[k, i]
            squared += out[3 + i, k] ** 2
        out[6, k] = 1.0 / squared if squared > 0.0 else 0.0
        out[7, k] = capsules[k, 6]


@njit(cache=True, error_model="numpy")  # without checks for a division by 0 the loop runs in vector instructions
@no_type_check
def nearest_capsule(
    columns: np.ndarray, x: float, y: float, z: float, distances: np.ndarray
) -> tuple[float, float, float, float]:
    """Signed distance [m] of a point to the nearest capsule, and its gradient; inf and 0 without capsules.

    Args:
        columns: (8, K) as `columns` writes them.
        x, y, z: the point [m].
        distances: (K,) working space.
    """
    for k in range(len(distances)):
        px, py, pz = x - columns[0, k], y - columns[1, k], z - columns[2, k]
        share = (px * columns[3, k] + py * columns[4, k] + pz * columns[5, k]) * columns[6, k]
        share = 0.0 if share < 0.0 else share
        share = 1.0 if share > 1.0 else share
        px -= share * columns[3, k]
        py -= share * columns[4, k]
        pz -= share * columns[5, k]
        distances[k] = math.sqrt(px * px + py * py + pz * pz) - columns[7, k]
    least, nearest = np.inf, -1
    for k in range(len(distances)):
        if distances[k] < least:
            least, nearest = distances[k], k
    if nearest < 0:
        return np.inf, 0.0, 0.0, 0.0
    k = nearest
    px, py, pz = x - columns[0, k], y - columns[1, k], z - columns[2, k]
    share = min(max((px * columns[3, k] + py * columns[4, k] + pz * columns[5, k]) * columns[6, k], 0.0), 1.0)
    px, py, pz = px - share * columns[3, k], py - share * columns[4, k], pz - share * columns[5, k]
    length = math.sqrt(px * px + py * py + pz * pz)
    if length < TOUCHING:
        return least, 0.0, 0.0, 1.0  # on the axis every way out is as good: up
    return least, px / length, py / length, pz / length


@njit(cache=True)
@no_type_check
def signed_distances(
    points: np.ndarray,
    when: np.ndarray,
    times: np.ndarray,
    capsules: np.ndarray,
    speed: float,
    limit: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Signed distances (W, P) of points (W, P, 3) at times (W,) to the nearest capsule, and gradients (W, P, 3)."""
    waypoints, count = points.shape[:2]
    distance = np.empty((waypoints, count))
    gradient = np.empty((waypoints, count, 3))
    now = np.empty((capsules.shape[1], 7))
    prepared = np.empty((8, capsules.shape[1]))
    scratch = np.empty(capsules.shape[1])
    for w in range(waypoints):
        capsules_at(when[w], times, capsules, speed, limit, now)
        columns(now, prepared)
        for p in range(count):
            d, gx, gy, gz = nearest_capsule(prepared, points[w, p, 0], points[w, p, 1], points[w, p, 2], scratch)
            distance[w, p] = d
            gradient[w, p, 0], gradient[w, p, 1], gradient[w, p, 2] = gx, gy, gz
    return distance, gradient


@njit(cache=True)
@no_type_check
def nearest_obstacle(
    rows: np.ndarray, first_link: np.ndarray, link: int, x: float, y: float, z: float, least: float
) -> tuple[float, float, float, float]:
    """Signed distance [m] of a link's point to the nearest of the obstacles (O, 17), and its gradient.

    An obstacle counts for links from its `first_link` on. Only distances below `least` are looked for.
    """
    gx, gy, gz = 0.0, 0.0, 0.0
    for o in range(len(rows)):
        if link < first_link[o]:
            continue
        row = rows[o]
        x0, y0, z0 = x - row[1], y - row[2], z - row[3]
        if row[0] == HALF_SPACE:
            distance = row[4] * x0 + row[5] * y0 + row[6] * z0
            if distance < least:
                least, gx, gy, gz = distance, row[4], row[5], row[6]
            continue
        u = row[4] * x0 + row[7] * y0 + row[10] * z0
        v = row[5] * x0 + row[8] * y0 + row[11] * z0
        w = row[6] * x0 + row[9] * y0 + row[12] * z0
        eu = u - min(max(u, -row[13]), row[13])
        ev = v - min(max(v, -row[14]), row[14])
        ew = w - min(max(w, -row[15]), row[15])
        squared = eu * eu + ev * ev + ew * ew
        bound = least + row[16]
        if bound > 0.0 and squared >= bound * bound:
            continue
        outside = math.sqrt(squared)
        if outside > TOUCHING:
            distance = outside - row[16]
            eu, ev, ew = eu / outside, ev / outside, ew / outside
        else:  # inside: out through the nearest face
            du, dv, dw = abs(u) - row[13], abs(v) - row[14], abs(w) - row[15]
            distance = max(du, dv, dw) - row[16]
            eu = math.copysign(1.0, u) if du >= max(dv, dw) else 0.0
            ev = math.copysign(1.0, v) if eu == 0.0 and dv >= dw else 0.0
            ew = math.copysign(1.0, w) if eu == 0.0 and ev == 0.0 else 0.0
        if distance < least:
            least = distance
            gx = row[4] * eu + row[5] * ev + row[6] * ew
            gy = row[7] * eu + row[8] * ev + row[9] * ew
            gz = row[10] * eu + row[11] * ev + row[12] * ew
    return least, gx, gy, gz


@njit(cache=True)
@no_type_check
def segments_apart(p: np.ndarray, q: np.ndarray, a: np.ndarray, b: np.ndarray) -> float:
    """Least distance [m] between the segments from p to q and from a to b, exact.

    The distance is convex in both places at once: the free optimum where it lies within both, else the best of
    the four ends against the other segment.
    """
    ux, uy, uz = q[0] - p[0], q[1] - p[1], q[2] - p[2]
    vx, vy, vz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    wx, wy, wz = p[0] - a[0], p[1] - a[1], p[2] - a[2]
    uu, vv, uv = ux * ux + uy * uy + uz * uz, vx * vx + vy * vy + vz * vz, ux * vx + uy * vy + uz * vz
    uw, vw = ux * wx + uy * wy + uz * wz, vx * wx + vy * wy + vz * wz
    cross = uu * vv - uv * uv
    if cross > 1e-12 * uu * vv:
        s, t = (uv * vw - vv * uw) / cross, (uu * vw - uv * uw) / cross
        if 0.0 <= s <= 1.0 and 0.0 <= t <= 1.0:
            dx, dy, dz = wx + s * ux - t * vx, wy + s * uy - t * vy, wz + s * uz - t * vz
            return math.sqrt(dx * dx + dy * dy + dz * dz)
    return math.sqrt(min(_squared(p, a, b), _squared(q, a, b), _squared(a, p, q), _squared(b, p, q)))


@njit(cache=True)
@no_type_check
def _squared(p: np.ndarray, a: np.ndarray, b: np.ndarray) -> float:
    """Squared distance of a point to the segment from a to b."""
    dx, dy, dz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    x, y, z = p[0] - a[0], p[1] - a[1], p[2] - a[2]
    length = dx * dx + dy * dy + dz * dz
    if length > 0.0:
        share = min(max((x * dx + y * dy + z * dz) / length, 0.0), 1.0)
        x, y, z = x - share * dx, y - share * dy, z - share * dz
    return x * x + y * y + z * z
