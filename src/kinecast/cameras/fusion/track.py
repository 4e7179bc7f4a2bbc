"""One person over time, as all cameras together see them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool

from kinecast.body.skeleton import without_side
from kinecast.cameras.fusion.consensus import Agreement, agree, stacked
from kinecast.cameras.fusion.motion import JointStates
from kinecast.cameras.fusion.reach import ANCHOR_STD, Reach
from kinecast.cameras.fusion.sighting import Sighting
from kinecast.types import SkeletonFrame

__all__ = ["PersonTrack"]

ACCELERATIONS = {"elbow": 2.0, "wrist": 3.0, "hand": 4.0}
ACCELERATION = 1.0
"""Standard deviation of a joint's acceleration along each axis [m/s²]: two to three times what it is in recorded work,
for the sake of a small lag (docs/decisions/0022)."""
WRONG_SHARE, WRONG_LEAST = 0.5, 3
"""A view of which so many joints, and this share, disagree with all else is wrong as a whole."""
PATIENCE = 10
"""After so many rounds in which images contradict the past, and nothing supports it, it is given up."""
STANDING = 0.8
"""Share of the variance of what images say that is the same in the next image: a pose estimator's errors stay."""
MOST_BEYOND = 0.5
"""A joint too far from more than this share of its neighbours is something else."""
LOOSE = 0.2
"""Uncertainty from which a joint is held near the body [m]."""
SHOWN = 0.15
"""A joint that nobody has seen for so long [s] is no longer given: the predictor then knows that it is hidden."""
CONFIRMED = 3
"""Rounds in which somebody is seen before they count as somebody."""


class PersonTrack:
    """A person.

    Args:
        joints: names.
        stamp: now [s].
        reach: how far joints can be from one another.

    Attributes:
        person: the id that frames carry; empty until they have one.
        states: what is known of the joints.
        rounds: in how many rounds they were seen.
        seen_at: when they were last seen [s].
        blamed: the cameras whose view was thrown out in the newest round.
    """

    def __init__(self, joints: tuple[str, ...], stamp: float, reach: Reach) -> None:
        self.person = ""
        self.joints = joints
        accelerations = np.array([ACCELERATIONS.get(without_side(joint), ACCELERATION) for joint in joints])
        self.states = JointStates(accelerations, stamp)
        self.rounds = 0
        self._doubts = np.zeros(len(joints), dtype=np.int64)
        self._reach = reach
        self.seen_at = stamp
        self.blamed: tuple[str, ...] = ()

    @property
    def confirmed(self) -> bool:
        """Whether they have been seen often enough to be somebody."""
        return self.rounds >= CONFIRMED

    def see(self, sightings: Sequence[Sighting]) -> None:
        """All that was seen of them in one round, at most one sighting for each camera, none later than `states`."""
        stack = stacked(sightings)
        agreement = agree(stack, self.states, self._reach)
        wrong = _wrong_as_a_whole(agreement, stack.seen)
        self.blamed = tuple(s.camera for s, out in zip(sightings, wrong, strict=True) if out)
        if wrong.any():
            sightings = [s for s, out in zip(sightings, wrong, strict=True) if not out]
            if not sightings:
                return
            stack = stacked(sightings)
            agreement = agree(stack, self.states, self._reach)
        self._doubts = np.where(agreement.doubted, self._doubts + 1, 0)
        lost = self.states.known & (~agreement.past | (self._doubts > PATIENCE))
        if (self._doubts > PATIENCE).any():
            self.states.forget(self._doubts > PATIENCE)
            agreement = agree(stack, self.states, self._reach)
            self._doubts[self._doubts > PATIENCE] = 0
        start = (lost | ~self.states.known) & np.isfinite(agreement.positions).all(axis=1)
        weighted = agreement.precision[..., None] * stack.rows
        information = np.einsum("vjrx,vjry->vjxy", stack.rows, weighted) * ~start[:, None, None]
        then = np.stack([self.states.at(stamp)[0] for stamp in stack.stamps])
        off = stack.values - np.einsum("vjrx,vjx->vjr", stack.rows, np.where(np.isfinite(then), then, 0.0))
        surprise = np.einsum("vjrx,vjr->vjx", weighted, off) * ~start[:, None]
        self.states.correct(stack.stamps, information, surprise)
        self.states.start(start, agreement.positions, agreement.covariance)
        touched = start | (self.states.known & agreement.used.any(axis=(0, 2)) & ~lost)
        if not touched.any():
            return
        self.states.seen_at[touched] = self.states.stamp
        self.seen_at = self.states.stamp
        self.rounds += 1
        known = touched & np.isfinite(agreement.positions).all(axis=1)
        self.states.standing[known] = STANDING * agreement.covariance[known]
        self._hold(touched & ~agreement.used[..., 1].any(axis=0) & (agreement.used[..., 0].sum(axis=0) < 2))
        self.states.forget(self._reach.beyond(self.states.mean[:, 0], self.states) > MOST_BEYOND)

    def _hold(self, joints: Bool[np.ndarray, " J"]) -> None:
        """Keeps joints near the body that one pixel alone was seen of: nothing else says how far they are."""
        anchors, anchored = self._reach.anchors(self.states)
        anchored &= np.sqrt(np.trace(self.states.covariance[:, :3, :3], axis1=1, axis2=2)) > LOOSE
        information = (joints & anchored)[None, :, None, None] * np.eye(3) / ANCHOR_STD**2
        off = np.where((joints & anchored)[:, None], anchors - self.states.mean[:, 0], 0.0) / ANCHOR_STD**2
        self.states.correct(np.array([self.states.stamp]), information, off[None])

    def apart(self, other: PersonTrack) -> float:
        """Median distance between this person's joints and another's [m]; inf where they share none."""
        away = np.linalg.norm(self.states.mean[:, 0] - other.states.mean[:, 0], axis=1)
        away = np.sort(away[np.isfinite(away)])
        return float(away[len(away) // 2]) if len(away) else np.inf

    def frame(self, frame_id: str) -> SkeletonFrame:
        """What is known now, as a skeleton of the joints that were ever seen."""
        states = self.states
        ever = np.flatnonzero(states.known)
        positions, covariance = states.mean[ever, 0].copy(), (states.covariance[:, :3, :3] + states.standing)[ever]
        gone = states.stamp - states.seen_at[ever] > SHOWN
        positions[gone], covariance[gone] = np.nan, np.nan
        std = np.sqrt(np.trace(covariance, axis1=1, axis2=2) / 3)
        joints = tuple(self.joints[column] for column in ever)
        return SkeletonFrame(states.stamp, joints, positions, self.person, frame_id, std, covariance)


def _wrong_as_a_whole(agreement: Agreement, seen: Bool[np.ndarray, "V J 2"]) -> Bool[np.ndarray, " V"]:
    """(V,) whether a view disagrees with the others, or with the past, in most of its joints."""
    checked = seen[..., 0] & ((seen[..., 0].sum(axis=0) > 1) | agreement.past)
    off = checked & ~agreement.used[..., 0]
    return (off.sum(axis=1) >= WRONG_LEAST) & (off.sum(axis=1) > WRONG_SHARE * checked.sum(axis=1))
