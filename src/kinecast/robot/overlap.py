"""Probability that a person reaches for a cube: counted over the samples."""

from __future__ import annotations

from typing import no_type_check

import numpy as np
from jaxtyping import Float
from numba import njit

from kinecast.robot.occupancy import OccupancyOptions
from kinecast.types import Prediction

__all__ = ["reach_probabilities"]

MOST_SAMPLES = 100
"""More samples cost time and tell little more: the standard error of a probability is 0.05 at most."""


def reach_probabilities(
    prediction: Prediction,
    points: Float[np.ndarray, "C 3"],
    radius: float,
    body: OccupancyOptions | None = None,
) -> Float[np.ndarray, " C"]:
    """(C,) P(some limb comes within a radius [m] of each point at some step)."""
    steps = len(prediction.times)
    positions = np.repeat(points[None], steps, axis=0)
    hits = _hits(prediction, positions, np.full(len(points), radius), body)
    return np.asarray(hits.mean(axis=0))


def _hits(
    prediction: Prediction,
    positions: Float[np.ndarray, "T P 3"],
    radius: Float[np.ndarray, " P"],
    body: OccupancyOptions | None,
) -> np.ndarray:
    """(S, P) whether a sample touches a ball at any step."""
    o = body or OccupancyOptions()
    every = max(1, -(-len(prediction.samples) // MOST_SAMPLES))
    return _touched(
        np.ascontiguousarray(prediction.samples[::every], dtype=np.float64),
        np.ascontiguousarray(positions, dtype=np.float64),
        np.ascontiguousarray(radius, dtype=np.float64),
        np.array([o.upper_arm, o.forearm, o.hand]),
        o.hand_length,
    )


@njit(cache=True)
@no_type_check
def _touched(
    samples: np.ndarray, positions: np.ndarray, radius: np.ndarray, limbs: np.ndarray, palm: float
) -> np.ndarray:
    """(S, P) for samples (S, T, 6, 3) and balls (T, P, 3); a limb that is NaN may be anywhere, so it touches."""
    count, steps = samples.shape[:2]
    balls = len(radius)
    hit = np.zeros((count, balls), dtype=np.bool_)
    boxes = np.empty((steps, 2, 3))
    for t in range(steps):
        _box(positions[t], radius, boxes[t])
    a, b, middle = np.empty(3), np.empty(3), np.empty(3)
    for s in range(count):
        for t in range(steps):
            for side in range(0, 6, 3):
                for limb in range(3):
                    for k in range(3):
                        if limb < 2:
                            a[k], b[k] = samples[s, t, side + limb, k], samples[s, t, side + limb + 1, k]
                        else:
                            b[k] = samples[s, t, side + 2, k] - samples[s, t, side + 1, k]
                    if limb == 2:
                        length = max(np.sqrt(b[0] * b[0] + b[1] * b[1] + b[2] * b[2]), 1e-6)
                        for k in range(3):
                            a[k] = samples[s, t, side + 2, k]
                            b[k] = a[k] + palm * b[k] / length
                    reach = limbs[limb]
                    for k in range(3):
                        middle[k] = 0.5 * (a[k] + b[k])
                    half = 0.5 * np.sqrt((b[0] - a[0]) ** 2 + (b[1] - a[1]) ** 2 + (b[2] - a[2]) ** 2)
                    outside = 0.0
                    for k in range(3):
                        outside += max(boxes[t, 0, k] - middle[k], middle[k] - boxes[t, 1, k], 0.0) ** 2
                    if outside > (half + reach + 1e-9) ** 2:  # never if the limb is NaN
                        continue
                    for p in range(balls):
                        if not hit[s, p]:
                            ball = positions[t, p]
                            x, y, z = ball[0] - middle[0], ball[1] - middle[1], ball[2] - middle[2]
                            far = half + reach + radius[p]
                            if not x * x + y * y + z * z > far * far:  # most are far away
                                hit[s, p] = not _distance(a, b, ball) > reach + radius[p]
    return hit


@njit(cache=True)
@no_type_check
def _box(balls: np.ndarray, radius: np.ndarray, box: np.ndarray) -> None:
    """Writes the least and the greatest corner (2, 3) of what balls (P, 3) fill: everything where one is NaN."""
    box[0], box[1] = np.inf, -np.inf
    if not np.isfinite(balls.sum()):
        box[0], box[1] = -np.inf, np.inf
    for k in range(3):
        for p in range(len(balls)):
            box[0, k] = min(box[0, k], balls[p, k] - radius[p])
            box[1, k] = max(box[1, k], balls[p, k] + radius[p])


@njit(cache=True)
@no_type_check
def _distance(a: np.ndarray, b: np.ndarray, p: np.ndarray) -> float:
    """From a point to a segment."""
    along = length = 0.0
    for k in range(3):
        along += (p[k] - a[k]) * (b[k] - a[k])
        length += (b[k] - a[k]) ** 2
    share = min(max(along / max(length, 1e-12), 0.0), 1.0)
    away = 0.0
    for k in range(3):
        away += (p[k] - a[k] - share * (b[k] - a[k])) ** 2
    return np.sqrt(away)
