"""Where people may be: whether a prediction can be trusted, what it says of a moment, and what they reach for."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from kinecast.body.skeleton import ARM_JOINTS
from kinecast.geometry.distances import limb_distances
from kinecast.geometry.shapes import Sphere
from kinecast.robot.body import MEASURED_BODY, body_capsules
from kinecast.robot.capsules import interpolated
from kinecast.types import Prediction, Status

__all__ = ["TOUCH", "arms_at_stamp", "is_trusted", "occupied", "reach_probabilities"]

STALE_AFTER = 0.1
"""A prediction older than this says no more than what can be reached [s]."""
FASTEST = np.array([2.0] * 6 + [1.6] * 3)
"""Approach of the capsules (kinecast.robot.body.PARTS) [m/s], ISO 13855:2010, 6.2.3: upper limbs 2.0 below 0.5 m, a
body at a walk 1.6."""
TOUCH = 0.06
"""A limb that comes this near to a cube's middle may take it [m]."""
MOST_SAMPLES = 100
"""Samples that a probability is counted over: more cost time, and its standard error is 0.05 at most."""


def is_trusted(prediction: Prediction, now: float) -> bool:
    """Whether a prediction says more than what can be reached: its status is OK, and it is not too old."""
    return prediction.status is Status.OK and now - prediction.stamp <= STALE_AFTER + 1e-9


def arms_at_stamp(prediction: Prediction) -> Float[np.ndarray, "6 3"]:
    """(6, 3) the arm joints at the newest frame [m]: the mean, carried back in time from its first two steps."""
    if len(prediction.times) < 2:
        return prediction.mean[0]
    first, second = prediction.times[:2]
    share = min((first - prediction.stamp) / (second - first), 1.0)
    return prediction.mean[0] - share * (prediction.mean[1] - prediction.mean[0])


def occupied(predictions: Sequence[Prediction], now: float, at: float, level: float = 0.95) -> Float[np.ndarray, "K 7"]:
    """Capsules of several people at a moment ahead, one prediction each: start, end and radius [m].

    Each holds its limb with probability `level` and is grown by the limb's radius. Where what the person can reach at
    all since the prediction's stamp is smaller, and where the prediction is not to be trusted, that is taken. A limb
    of which nothing is known is left out.

    Args:
        predictions: the newest of each person.
        now: the present time on the predictions' clock [s].
        at: the moment [s].
        level: in (0, 1].
    """
    found = [np.empty((0, 7))]
    for prediction in predictions:
        start, end, radius = body_capsules(ARM_JOINTS, arms_at_stamp(prediction))
        reached = radius + FASTEST * max(at - prediction.stamp, 0.0)
        rows = np.column_stack([start, end, reached])
        if is_trusted(prediction, now) and np.isfinite(prediction.samples).all():
            [arms] = interpolated(np.array([at]), prediction.times, prediction.samples.swapaxes(0, 1))
            held = body_capsules(ARM_JOINTS, arms).regions(level)
            rows = np.where((rows[:, 6] < held[:, 6])[:, None], rows, held)
        found.append(rows[np.isfinite(rows).all(axis=1)])
    return np.concatenate(found)


def reach_probabilities(prediction: Prediction, points: Float[np.ndarray, "C 3"]) -> Float[np.ndarray, " C"]:
    """(C,) P(arm or hand comes within `TOUCH` of each point [m] at some step): the share of samples in which one does.

    A limb that is NaN may be anywhere, so it does.
    """
    samples = prediction.samples[:: max(1, -(-len(prediction.samples) // MOST_SAMPLES))]
    body, thick = body_capsules(ARM_JOINTS, samples), MEASURED_BODY.radii[:6]
    ends = np.concatenate([body.start[..., :6, :], body.end[..., :6, :]], axis=-2)
    axes, most = np.arange(12).reshape(2, 6).T, float(thick.max()) + 1e-6
    balls = (np.tile(Sphere(point, TOUCH).row, (samples.shape[1], 1, 1)) for point in points)
    touched = (~(limb_distances(ball, ends, axes, most) > thick) for ball in balls)
    return np.array([each.any(axis=(1, 2)).mean() for each in touched])
