"""What is known and predicted of everybody in the cell: where they were last seen, how fast they move, what comes."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from kinecast.body.skeleton import ARM_JOINTS, arms_of
from kinecast.geometry.distances import limb_distances
from kinecast.geometry.shapes import Sphere
from kinecast.robot.body import HAND_LENGTH, MEASURED_BODY, body_capsules, held, interpolated
from kinecast.robot.motions import PoseHistory, arms_at_stamp, is_trusted
from kinecast.robot.separation import Moving
from kinecast.types import Prediction, SkeletonFrame

SLOPE = 0.14  # span of the measurements over which a joint's speed is taken [s]
FORGET = 0.5  # a person who was not on any shot for this long has left [s]
HARDEST = 10.0  # no joint gains speed faster [m/s²]: beyond that it is the tracking
FASTEST = np.array([2.0] * 6 + [1.6] * 3)
"""Approach of the capsules (kinecast.robot.body.PARTS) [m/s], ISO 13855:2010, 6.2.3: upper limbs 2.0 below 0.5 m, a
body at a walk 1.6."""
TOUCH = 0.06  # a limb that comes this near to a cube's middle may take it [m]
MOST_SAMPLES = 100
"""Samples that a probability is counted over: more cost time, and its standard error is 0.05 at most."""
MOMENT = 1e-5  # capsules' velocities are those of their joints over so long [s]
ARM_PARTS = ("shoulder", "elbow", "wrist")

NOBODY = Moving(np.empty((0, 7)), np.empty((0, 6)), np.empty(0))


@dataclass(frozen=True)
class CameraFrame:
    """Everybody seen at one instant. An empty one says that nobody is there; a silent camera says nothing."""

    stamp: float  # when it was taken [s]
    frames: tuple[SkeletonFrame, ...]  # one for each person


class PeopleModel:
    """Keeps the last measurements, the newest prediction and the last minute of every person."""

    def __init__(self) -> None:
        self.newest = -np.inf
        """Stamp of the newest shot [s]."""
        self.predictions: tuple[Prediction, ...] = ()
        self._tracks: dict[str, _Track] = {}

    def see(self, shot: CameraFrame, predictions: Sequence[Prediction] = ()) -> None:
        """Takes in a shot, and what is predicted from it for each person; an older shot is passed over."""
        if not np.isfinite(shot.stamp) or shot.stamp <= self.newest:
            return
        self.newest = shot.stamp
        for frame in shot.frames:
            track = self._tracks.get(frame.person)
            if track is None or track.joints != frame.joints:
                track = self._tracks[frame.person] = _Track(frame.joints)
            track.add(frame)
        self._tracks = {name: track for name, track in self._tracks.items() if shot.stamp - track.stamp <= FORGET}
        kept = {each.person: each for each in (*self.predictions, *predictions)}
        self.predictions = tuple(kept[name] for name in self._tracks if name in kept)

    def unseen(self) -> list[str]:
        """Persons of whom an arm's joint was never seen: nobody knows where it is."""
        return [name for name, track in self._tracks.items() if not np.isfinite(track.arms).all()]

    def seen(self, now: float) -> Moving:
        """Everybody's capsules where they were last seen.

        Each as fast as it was in the middle of the last measurements, and, where that is known, once more as fast as it
        is by now, gaining speed as it did.
        """
        each = [NOBODY, *(track.seen(now) for track in self._tracks.values())]
        return Moving(*map(np.concatenate, zip(*each, strict=True)))

    def trusted(self, now: float) -> list[Prediction]:
        """Predictions that say more than what can be reached."""
        return [each for each in self.predictions if is_trusted(each, now)]

    def motions(self, now: float) -> Float[np.ndarray, "S N K 7"] | None:
        """What everybody may do in the next seconds (kinecast.robot.motions); None where nothing is predicted."""
        rng = np.random.default_rng(round(1e3 * now))
        each = [self._tracks[one.person].history.ahead(one, now, rng) for one in self.predictions]
        return np.concatenate(each, axis=2) if each else None

    def taken(self, cubes: Mapping[str, Float[np.ndarray, "3"]], now: float) -> dict[str, float]:
        """Probability that somebody reaches for each of the cubes, given where they are [m]; 1 where a hand is."""
        places = np.array(list(cubes.values())).reshape(-1, 3)
        chance = np.zeros(len(places))
        for track in self._tracks.values():
            for wrist in track.arms[[2, 5]]:
                near = np.linalg.norm(places - wrist, axis=1) <= HAND_LENGTH + MEASURED_BODY[2] + TOUCH
                chance = np.maximum(chance, near)
        for prediction in self.trusted(now):
            chance = np.maximum(chance, reach_probabilities(prediction, places))
        return dict(zip(cubes, chance.tolist(), strict=True))


class _Track:
    """The last measurements of one person."""

    def __init__(self, joints: tuple[str, ...]) -> None:
        self.joints = joints
        self.history = PoseHistory()
        self._last = np.full((len(joints), 3), np.nan)
        self._seen_at = np.full((len(joints), 3), -np.inf)
        self._recent: deque[SkeletonFrame] = deque(maxlen=64)

    @property
    def arms(self) -> Float[np.ndarray, "6 3"]:
        """(6, 3) the last places of shoulders, elbows and wrists, left and right [m]; NaN where never seen."""
        return arms_of(SkeletonFrame(self.stamp, self.joints, self._last))

    def add(self, frame: SkeletonFrame) -> None:
        self.stamp = frame.stamp
        self.history.add(frame.stamp, arms_of(frame))
        self._last[frame.valid] = frame.positions[frame.valid]
        self._seen_at[frame.valid] = frame.stamp
        self._recent.append(frame)
        while frame.stamp - self._recent[0].stamp > SLOPE:
            self._recent.popleft()
        velocity, acceleration, self._lag = self._rates()
        self._capsules = body_capsules(self.joints, self._last)
        self._velocity, self._acceleration = self._of_capsules(velocity), self._of_capsules(acceleration)
        # As if stamps were places, for the oldest joint behind each capsule.
        self._oldest = body_capsules(self.joints, self._seen_at, hand_length=0.0)[:, [0, 3]].min(axis=1)

    def _of_capsules(self, rate: Float[np.ndarray, "J 3"]) -> Float[np.ndarray, "K 6"]:
        """Rates of starts and ends, whatever joints they hang on: by the capsules of joints a moment later."""
        moved = body_capsules(self.joints, self._last + MOMENT * rate)
        return (moved - self._capsules)[:, :6] / MOMENT

    def _rates(self) -> tuple[Float[np.ndarray, "J 3"], Float[np.ndarray, "J 3"], float]:
        """Velocity (J, 3) [m/s] and acceleration (J, 3) [m/s²] of each joint, and how long ago the velocity was [s].

        Of the straight line and of the parabola through the last measurements; NaN with fewer than three, and four.
        Joints of trunk and head that were not always seen move with the shoulders.
        """
        unknown = np.full_like(self._last, np.nan)
        if len(self._recent) < 3:
            return unknown, unknown, 0.0
        stamps = np.array([frame.stamp for frame in self._recent])
        places = np.array([frame.positions for frame in self._recent])
        lever = stamps - stamps.mean()
        slope: Float[np.ndarray, "J 3"] = np.einsum("n,njk->jk", lever, places) / (lever @ lever)
        bend = np.linalg.pinv(np.vander(lever, 3))[0]
        curve = unknown if len(stamps) < 4 else 2.0 * np.einsum("n,njk->jk", bend, places)
        size = np.linalg.norm(curve, axis=1, keepdims=True)
        curve = curve * np.minimum(1.0, HARDEST / np.maximum(size, 1e-9))
        shoulders = [row for row, name in enumerate(self.joints) if name.endswith("shoulder")]
        rest = [row for row, name in enumerate(self.joints) if not name.endswith(ARM_PARTS)]
        lost = [row for row in rest if not np.isfinite(slope[row]).all()]
        for values in (slope, curve):
            values[lost] = values[shoulders].mean(axis=0)
        return slope, curve, float(stamps[-1] - stamps.mean())

    def seen(self, now: float) -> Moving:
        later = self._velocity + (self._lag + now - self.stamp) * self._acceleration
        known = np.append(np.full(len(later), True), np.isfinite(later).all(axis=1))
        twice = (self._capsules, self._capsules), (self._velocity, later), (now - self._oldest,) * 2
        return Moving(*(np.concatenate(each)[known] for each in twice))


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
        rows = body_capsules(ARM_JOINTS, arms_at_stamp(prediction))
        rows[:, 6] += FASTEST * max(at - prediction.stamp, 0.0)
        if is_trusted(prediction, now) and np.isfinite(prediction.samples).all():
            [arms] = interpolated(np.array([at]), prediction.times, prediction.samples.swapaxes(0, 1))
            likely = held(body_capsules(ARM_JOINTS, arms), level)
            rows = np.where(rows[:, 6:] < likely[:, 6:], rows, likely)
        found.append(rows[np.isfinite(rows).all(axis=1)])
    return np.concatenate(found)


def reach_probabilities(prediction: Prediction, points: Float[np.ndarray, "C 3"]) -> Float[np.ndarray, " C"]:
    """(C,) P(arm or hand comes within `TOUCH` of each point [m] at some step): the share of samples in which one does.

    A limb that is NaN may be anywhere, so it does.
    """
    samples = prediction.samples[:: max(1, -(-len(prediction.samples) // MOST_SAMPLES))]
    arms, thick = body_capsules(ARM_JOINTS, samples)[..., :6, :], MEASURED_BODY[:6]
    ends = np.concatenate([arms[..., :3], arms[..., 3:6]], axis=-2)
    axes, most = np.arange(12).reshape(2, 6).T, float(thick.max()) + 1e-6
    balls = (np.tile(Sphere(point, TOUCH).row, (samples.shape[1], 1, 1)) for point in points)
    touched = (~(limb_distances(ball, ends, axes, most) > thick) for ball in balls)
    return np.array([each.any(axis=(1, 2)).mean() for each in touched])
