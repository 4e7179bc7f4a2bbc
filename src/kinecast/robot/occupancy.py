"""Where people may be: a prediction turned into capsules, and whether it can be trusted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from kinecast.body.skeleton import ARM_JOINTS
from kinecast.geometry.distances import limb_distances
from kinecast.geometry.shapes import Sphere
from kinecast.robot.body import OccupancyOptions, body_capsules
from kinecast.types import Prediction, Status

__all__ = ["Occupancy", "is_trusted", "occupied", "reach_probabilities", "regions", "standing"]

STALE_AFTER = 0.1
"""A prediction older than this says no more than what can be reached [s]."""
FASTEST = np.array([2.0] * 6 + [1.6] * 3)
"""Approach of the capsules (kinecast.robot.body.PARTS) [m/s], ISO 13855:2010, 6.2.3: upper limbs 2.0 below 0.5 m, a
body at a walk 1.6."""
MOST_SAMPLES = 100
"""Samples that a probability is counted over: more cost time, and its standard error is 0.05 at most."""


@dataclass(frozen=True, eq=False)
class Occupancy:
    """K capsules at T times.

    Attributes:
        times: (T,) increasing, T of 1 or more [s].
        rows: (T, K, 7) start, end and radius [m].
    """

    times: Float[np.ndarray, " T"]
    rows: Float[np.ndarray, "T K 7"]

    def rows_at(self, times: Float[np.ndarray, " W"]) -> Float[np.ndarray, "W K 7"]:
        """(W, K, 7) at other times [s]: straight from one to the next, the first before its time, the last after it."""
        return _interpolated(times, self.times, self.rows)


def _interpolated(
    at: Float[np.ndarray, " W"], times: Float[np.ndarray, " T"], values: Float[np.ndarray, "T *each"]
) -> Float[np.ndarray, "W *each"]:
    """Values at times in a row, at other times."""
    place = np.interp(at, times, np.arange(len(times)))
    before = place.astype(np.int64)
    share = (place - before).reshape(-1, *[1] * (values.ndim - 1))
    return values[before] + share * (values[np.minimum(before + 1, len(times) - 1)] - values[before])


def regions(
    start: Float[np.ndarray, "S T K 3"], end: Float[np.ndarray, "S T K 3"], level: float
) -> Float[np.ndarray, "T K 7"]:
    """(T, K, 7) start, end and radius [m] of capsules, each of which holds its limb's axis in a share of S samples.

    A capsule is convex: a limb lies inside as soon as both its ends lie within the radius of the axis's ends.
    """
    middle = np.concatenate([start.mean(axis=0), end.mean(axis=0)], axis=-1)
    away = np.concatenate([start, end], axis=-1) - middle
    far = np.sqrt(np.maximum((away[..., :3] ** 2).sum(axis=-1), (away[..., 3:] ** 2).sum(axis=-1)))
    held = min(max(int(np.ceil(level * len(far) - 1e-9)), 1), len(far)) - 1
    return np.concatenate([middle, np.partition(far, held, axis=0)[held][..., None]], axis=-1)


def occupied(
    predictions: Sequence[Prediction], now: float, at: float, options: OccupancyOptions
) -> Float[np.ndarray, "K 7"]:
    """Capsules of several people at a moment ahead, one prediction each: start, end and radius [m].

    Each holds its limb with probability `level` and is grown by the limb's radius. Where what the person can reach at
    all since the prediction's stamp is smaller, and where the prediction is not to be trusted, that is taken. A limb
    of which nothing is known is left out.

    Args:
        predictions: the newest of each person.
        now: the present time on the predictions' clock [s].
        at: the moment [s].
        options: see OccupancyOptions.
    """
    found = [np.empty((0, 7))]
    for prediction in predictions:
        body = body_capsules(ARM_JOINTS, _arms_at_stamp(prediction), options)
        reached = body.radius + FASTEST * max(at - prediction.stamp, 0.0)
        rows = np.concatenate([body.start, body.end, reached[:, None]], axis=1)
        if is_trusted(prediction, now) and np.isfinite(prediction.samples).all():
            moment = _interpolated(np.array([at]), prediction.times, np.moveaxis(prediction.samples, 1, 0))
            bodies = body_capsules(ARM_JOINTS, np.moveaxis(moment, 0, 1), options)
            [held] = regions(bodies.start, bodies.end, options.level)
            held[:, 6] += body.radius
            rows = np.where((rows[:, 6] < held[:, 6])[:, None], rows, held)
        found.append(rows[np.isfinite(rows).all(axis=1)])
    return np.concatenate(found)


def is_trusted(prediction: Prediction, now: float) -> bool:
    """Whether a prediction says more than what can be reached: its status is OK, and it is not too old."""
    return prediction.status is Status.OK and now - prediction.stamp <= STALE_AFTER + 1e-9


def standing(prediction: Prediction) -> Prediction:
    """Nothing but where the person was at the stamp: one motion that stays there."""
    still = np.repeat(_arms_at_stamp(prediction)[None], len(prediction.times), axis=0)
    return replace(prediction, samples=still[None], mean=still)


def _arms_at_stamp(prediction: Prediction) -> Float[np.ndarray, "6 3"]:
    """(6, 3) the arm joints at the newest frame: the mean, carried back in time from its first two steps."""
    if len(prediction.times) < 2:
        return prediction.mean[0]
    first, second = prediction.times[:2]
    share = min((first - prediction.stamp) / (second - first), 1.0)
    return prediction.mean[0] - share * (prediction.mean[1] - prediction.mean[0])


def reach_probabilities(
    prediction: Prediction, points: Float[np.ndarray, "C 3"], radius: float, options: OccupancyOptions
) -> Float[np.ndarray, " C"]:
    """(C,) P(some limb comes within a radius [m] of each point at some step): the share of samples in which one does.

    A limb that is NaN may be anywhere, so it does.
    """
    samples = prediction.samples[:: max(1, -(-len(prediction.samples) // MOST_SAMPLES))]
    limbs = slice(6)
    bodies, thick = body_capsules(ARM_JOINTS, samples, options), options.radii[limbs]
    ends = np.concatenate([bodies.start[..., limbs, :], bodies.end[..., limbs, :]], axis=-2)
    pairs = np.stack([np.arange(6), np.arange(6) + 6], axis=1)
    chances = []
    for point in points:
        ball = np.tile(Sphere(point, radius).row, (samples.shape[1], 1, 1))
        apart = limb_distances(ball, ends, pairs, most=float(thick.max()) + 1e-6)
        chances.append(float((~(apart > thick)).any(axis=(1, 2)).mean()))
    return np.array(chances)
