"""One person over time, as all cameras together see them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from kinecast.cameras.fusion.consensus import LIMITS, Consensus
from kinecast.cameras.fusion.kalman import JointStates
from kinecast.cameras.fusion.measurement import FUSED_JOINTS, Measurement
from kinecast.types import SkeletonFrame

STANDING = 0.8  # share of the variance of what images say that stays in the next: a pose estimator's errors do
SHOWN = 0.15  # a joint that nobody has seen for so long [s] is not given: the predictor knows that it is hidden
CONFIRMED = 3  # rounds in which somebody is seen before they count as somebody
LEAST_SHARED = 3  # joints that must be seen and known for a comparison


class Person:
    """A person, from an instant [s] on."""

    def __init__(self, stamp: float) -> None:
        self.name = ""  # the id that frames carry; empty until they have one
        self.states = JointStates(FUSED_JOINTS, stamp)
        self.rounds = 0  # in which they were seen
        self.seen_at = stamp
        self._standing = np.zeros((len(FUSED_JOINTS), 3, 3))  # of the part of an error that stays in the next image

    @property
    def confirmed(self) -> bool:
        """Whether they have been seen often enough to be somebody."""
        return self.rounds >= CONFIRMED

    def update(self, measurements: Sequence[Measurement]) -> list[Measurement]:
        """Takes at most one measurement of each camera, and returns those that disagree as a whole."""
        states = self.states
        images = Measurement.stacked(measurements)
        consensus = Consensus(images, states, self._standing)
        lost = states.known & ~consensus.past
        located = np.isfinite(consensus.positions).all(axis=1)
        start = located & (lost | ~states.known)
        going_on, delay = ~start[:, None], states.stamp - float(np.mean(images.stamps))
        states.correct(consensus.information * going_on[..., None], consensus.surprise * going_on, delay)
        states.start(start, consensus.positions, consensus.covariance)
        touched = start | (states.known & consensus.used.any(axis=(0, 2)) & ~lost)
        if touched.any():
            states.seen_at[touched] = self.seen_at = states.stamp
            self.rounds += 1
            self._standing[touched & located] = STANDING * consensus.covariance[touched & located]
        return [each for each, wrong in zip(measurements, consensus.wrong_images, strict=True) if wrong]

    def distance(self, measurement: Measurement) -> float:
        """How far a measurement is from where the joints should be, 0..1; inf where too few are seen and known.

        Squared Mahalanobis distances of pixels and depths, each up to its limit: their mean share of the limit.
        """
        both = measurement.seen & self.states.known[:, None]
        if both[..., 0].sum() < LEAST_SHARED:
            return np.inf
        covariance = self.states.covariance[:, :3, :3] + self._standing
        square = measurement.squared_errors(self.states.at(measurement.stamps)[0], covariance)
        limits = LIMITS * both
        return float(np.minimum(square, limits).sum() / limits.sum())

    def apart(self, other: Person) -> float:
        """Median distance between this person's joints and another's [m]; inf where they share none."""
        away: Float[np.ndarray, " J"] = np.linalg.norm(self.states.mean[:, 0] - other.states.mean[:, 0], axis=1)
        away = away[np.isfinite(away)]
        return float(np.median(away)) if len(away) else np.inf

    def frame(self, frame_id: str) -> SkeletonFrame:
        """What is known now, as a skeleton of the joints that were ever seen."""
        states = self.states
        ever = np.flatnonzero(states.known)
        positions, covariance = states.mean[ever, 0].copy(), (states.covariance[:, :3, :3] + self._standing)[ever]
        gone = ~states.seen_within(SHOWN)[ever]
        positions[gone], covariance[gone] = np.nan, np.nan
        std = np.sqrt(np.trace(covariance, axis1=1, axis2=2) / 3)
        joints = tuple(FUSED_JOINTS[column] for column in ever)
        return SkeletonFrame(states.stamp, joints, positions, self.name, frame_id, std, covariance)
