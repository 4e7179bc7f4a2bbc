"""What people may do in the next seconds: predicted motions, gone on with as the same person went on before.

A prediction ends after half a second or a second; a path takes three. After it each sample goes on as the person did
in the last minute when they were in nearly the same posture, moving alike: who holds a hand over the table draws it
back after as long as they did before, who rests begins as often. Nothing is trained for it, so it holds for anybody.
"""

from __future__ import annotations

from collections import deque

import numpy as np
from jaxtyping import Float, Int

from kinecast.body.skeleton import ARM_JOINTS
from kinecast.robot.body import body_capsules, interpolated
from kinecast.types import Prediction, Status

STEP = 0.1  # between two instants of a motion, steps of the roll-out and looked-at configurations of a path [s]
STALE_AFTER = 0.1  # a prediction older than this says no more than what can be reached [s]
AHEAD = 6.0  # motions are carried on so far [s]
SAMPLES = 40  # motions looked at
KEPT = 600  # postures kept of a person: a minute
ENOUGH = 20  # postures from which on the past says something
LEAST = 3  # postures from which on the usual one is known
RETURN = 1.0  # who does what they never did returns to their usual posture in this time [s]
ALIKE = 6  # moments of the past between which is drawn
LOOKBACK = 0.3  # a difference in speed counts as the difference in place that it makes in so long [s]
FADE = 0.5  # the difference between now and then fades in this time [s]
NEW = 0.3  # root mean square difference of joints [m] from which on nothing in the past is alike


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


class PoseHistory:
    """What one person did in the last minute, ten postures a second."""

    def __init__(self) -> None:
        self._newest = -np.inf
        self._poses: deque[Float[np.ndarray, "6 3"]] = deque(maxlen=KEPT)

    def add(self, stamp: float, arms: Float[np.ndarray, "6 3"]) -> None:
        """Keeps a posture, unless a joint is not seen or the last is too recent; a gap begins a new past."""
        if not np.isfinite(arms).all() or stamp < self._newest + 0.9 * STEP:
            return
        if stamp > self._newest + 10 * STEP:
            self._poses.clear()
        self._newest = stamp
        self._poses.append(arms)

    def ahead(self, prediction: Prediction, now: float, rng: np.random.Generator) -> Float[np.ndarray, "S N 9 7"]:
        """Possible motions from now [s] on: as predicted to the horizon, then as the person went on before.

        Who is not to be trusted with a prediction stands where they were last seen, until they go on as before.

        Returns:
            Capsules (kinecast.robot.body) in S samples at N instants, `STEP` apart.
        """
        times, samples = prediction.times, prediction.samples
        if not is_trusted(prediction, now):
            samples = np.tile(arms_at_stamp(prediction), (1, len(times), 1, 1))
        samples = samples[np.arange(SAMPLES) * len(samples) // SAMPLES]
        instants = now + STEP * np.arange(round(AHEAD / STEP) + 1)
        first = instants <= times[-1] + 1e-9
        predicted = interpolated(instants[first], times, samples.swapaxes(0, 1)).swapaxes(0, 1)
        last, before = samples[:, -1], max(len(times) - 4, 0)
        velocity = (last - samples[:, before]) / max(times[-1] - times[before], 1e-9)
        later = self._carry_on(last, velocity, int((~first).sum()), rng)
        return body_capsules(ARM_JOINTS, np.concatenate([predicted, later], axis=1))

    def _carry_on(
        self,
        pose: Float[np.ndarray, "S 6 3"],
        velocity: Float[np.ndarray, "S 6 3"],
        count: int,
        rng: np.random.Generator,
    ) -> Float[np.ndarray, "S count 6 3"]:
        """How motions that are at a pose [m], moving so fast [m/s], may go on: the next `count` instants.

        Where the past shows nothing like it they return to their usual posture; without a past they stand still.
        """
        if len(self._poses) < LEAST:
            return np.repeat(pose[:, None], count, axis=1)
        past = np.array(self._poses)
        speed = np.gradient(past, STEP, axis=0)
        known = np.concatenate([past, LOOKBACK * speed], axis=1).reshape(len(past), -1)
        out = np.empty((len(pose), count, 6, 3))
        usual = np.median(past, axis=0)
        moment, strange = _alike(known, pose, velocity, rng)
        offset = pose - past[moment]
        offset[strange] = 0.0
        now = pose.copy()
        for n in range(count):
            moment = moment + 1
            ended = (moment >= len(past)) & ~strange
            if ended.any():
                previous = past[np.minimum(moment - 2, len(past) - 1)]
                moment[ended], lost = _alike(known, now[ended], ((past[-1] - previous) / STEP)[ended], rng)
                strange[ended] |= lost
                offset[ended] = now[ended] - past[moment[ended]]
            offset *= 1.0 - STEP / FADE
            gone_on = past[np.minimum(moment, len(past) - 1)] + offset
            now = np.where(strange[:, None, None], now + STEP / RETURN * (usual - now), gone_on)
            out[:, n] = now
        return out


def _alike(
    known: Float[np.ndarray, "M 36"],
    pose: Float[np.ndarray, "S 6 3"],
    velocity: Float[np.ndarray, "S 6 3"],
    rng: np.random.Generator,
) -> tuple[Int[np.ndarray, " S"], np.ndarray]:
    """A moment of the past like each of S, one of the nearest by lot; and whether none is like it."""
    wanted = np.concatenate([pose, LOOKBACK * velocity], axis=1).reshape(len(pose), -1)
    if len(known) < ENOUGH:
        return np.zeros(len(pose), dtype=np.int64), np.ones(len(pose), dtype=np.bool_)
    usable = known[: -ENOUGH // 2]
    square = (wanted**2).sum(axis=1)[:, None] + (usable**2).sum(axis=1) - 2.0 * wanted @ usable.T
    nearest = np.argpartition(square, min(ALIKE, len(usable) - 1), axis=1)[:, :ALIKE]
    moment = np.take_along_axis(nearest, rng.integers(nearest.shape[1], size=(len(pose), 1)), axis=1)[:, 0]
    return moment, square[np.arange(len(pose)), moment] > 6 * NEW**2
