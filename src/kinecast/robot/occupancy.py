"""Where people may be: a prediction turned into capsules that grow, and the distance to them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from kinecast.errors import OptionError
from kinecast.robot.distances import capsules_at, signed_distances
from kinecast.robot.regions import STARTS, STOPS, regions
from kinecast.types import Prediction, SkeletonFrame, Status

__all__ = [
    "PARTS",
    "Occupancy",
    "OccupancyOptions",
    "arms_of",
    "is_trusted",
    "measured",
    "occupied",
    "reachable",
    "seen",
    "standing",
]

PARTS = (
    "left_upper_arm", "left_forearm", "left_hand", "right_upper_arm", "right_forearm", "right_hand",
    "shoulders", "trunk", "head",
)  # fmt: skip
"""The capsules of one person, in this order; persons follow one another."""

_ARM = ("left_shoulder", "left_elbow", "left_wrist", "right_shoulder", "right_elbow", "right_wrist")
_ALONG = np.array([0.0, -0.36, -0.66, 0.45, 0.81, 1.11])
"""The arm joints on a string from wrist to wrist [m], arms and shoulders of a large man (an estimate): no two joints
are ever farther apart than along it."""
_EVERYWHERE = 100.0
"""Radius [m] of what a person may fill who is known to be there but was never seen."""


@dataclass(frozen=True)
class OccupancyOptions:
    """How a prediction becomes space to keep out of.

    Attributes:
        level: probability that each capsule holds its limb, in (0, 1].
        upper_arm, forearm, hand: radii of the limbs [m]. Estimates: a large man's arms have radii of about 0.06 and
            0.05 m; the rest is clothing and the tracker's error, since a joint measured by a camera lies beside the
            bone's axis. The hand's radius holds a spread hand about its middle.
        hand_length: from the wrist to the middle of the fingers [m]: half of a hand of 0.20 m.
        shoulders, trunk, head: radii [m]: half the depth of a clothed chest, half its width, a head with hair.
        trunk_length, head_height: from mid-shoulders down to the hips and up to the middle of the head [m].
        hand_speed: fastest approach of an upper limb, ISO 13855:2010, 6.2.3: 2.0 m/s below 0.5 m.
        body_speed: fastest approach of a body, the same clause: walking, 1.6 m/s.
        reach_speed: at which everything grows after the last predicted time [m/s].
        growth_limit: how far it grows then [m]. Nobody knows where a person will be in three seconds; plans are made
            again long before, and the robot stops on what is measured, so that far ahead this much is kept clear.
        stale_after: a prediction older than this counts as the reachable set [s].
        horizon: of the reachable set [s].
    """

    level: float = 0.95
    upper_arm: float = 0.10
    forearm: float = 0.07
    hand: float = 0.10
    hand_length: float = 0.10
    shoulders: float = 0.13
    trunk: float = 0.18
    head: float = 0.14
    trunk_length: float = 0.50
    head_height: float = 0.25
    hand_speed: float = 2.0
    body_speed: float = 1.6
    reach_speed: float = 1.6
    growth_limit: float = 0.10
    stale_after: float = 0.1
    horizon: float = 0.5

    def __post_init__(self) -> None:
        if not 0 < self.level <= 1:
            raise OptionError(f"level {self.level} is outside (0, 1]")
        for name, value in vars(self).items():
            if not 0 <= value < np.inf:
                raise OptionError(f"{name} {value} must be 0 or more")

    @property
    def radii(self) -> Float[np.ndarray, "9"]:
        """(9,) of the `PARTS` [m]."""
        arm = (self.upper_arm, self.forearm, self.hand)
        return np.array([*arm, *arm, self.shoulders, self.trunk, self.head])

    @property
    def speeds(self) -> Float[np.ndarray, "9"]:
        """(9,) fastest approach of the `PARTS` [m/s]."""
        return np.array([self.hand_speed] * 6 + [self.body_speed] * 3)


@dataclass(frozen=True, eq=False)
class Occupancy:
    """Space that may be filled: K capsules at T times.

    Attributes:
        stamp: when it was made [s].
        times: (T,) increasing, T of 1 or more [s].
        start, end: (T, K, 3) ends of the axes [m].
        radius: (T, K) [m].
        reach_speed: growth of the radii after the last time [m/s].
        growth_limit: greatest growth [m].
    """

    stamp: float
    times: Float[np.ndarray, " T"]
    start: Float[np.ndarray, "T K 3"]
    end: Float[np.ndarray, "T K 3"]
    radius: Float[np.ndarray, "T K"]
    reach_speed: float = OccupancyOptions.reach_speed
    growth_limit: float = OccupancyOptions.growth_limit

    @classmethod
    def empty(cls, now: float = 0.0) -> Occupancy:
        """Nobody is there."""
        return cls(now, np.array([now]), np.empty((1, 0, 3)), np.empty((1, 0, 3)), np.empty((1, 0)))

    @property
    def rows(self) -> Float[np.ndarray, "T K 7"]:
        """(T, K, 7) start, end and radius, for compiled code (kinecast.robot.distances)."""
        return np.concatenate([self.start, self.end, self.radius[..., None]], axis=-1)

    def rows_at(self, times: Float[np.ndarray, " W"]) -> Float[np.ndarray, "W K 7"]:
        """(W, K, 7) capsules at each of the times [s]."""
        rows, known = self.rows, np.ascontiguousarray(self.times)
        out = np.empty((len(times), rows.shape[1], 7))
        for time, row in zip(times, out, strict=True):
            capsules_at(float(time), known, rows, self.reach_speed, self.growth_limit, row)
        return out

    def at(self, time: float) -> tuple[Float[np.ndarray, "K 3"], Float[np.ndarray, "K 3"], Float[np.ndarray, " K"]]:
        """Start (K, 3), end (K, 3) and radius (K,) at one time [s].

        Straight from one known time to the next; the first before its time; grown past the last.
        """
        [rows] = self.rows_at(np.array([time]))
        return rows[:, :3], rows[:, 3:6], rows[:, 6]

    def signed_distance(
        self, points: Float[np.ndarray, "W P 3"], times: Float[np.ndarray, " W"]
    ) -> tuple[Float[np.ndarray, "W P"], Float[np.ndarray, "W P 3"]]:
        """Distance of points to the nearest capsule, each row of points at its own time, and its gradient.

        Args:
            points: (W, P, 3) [m].
            times: (W,) [s].

        Returns:
            Distance (W, P) [m], > 0 free, inf where nobody is; and its gradient (W, P, 3), of length 1, away from the
            capsule; 0 where nobody is.
        """
        distance, gradient = signed_distances(
            np.ascontiguousarray(points, dtype=np.float64),
            np.ascontiguousarray(times, dtype=np.float64),
            np.ascontiguousarray(self.times, dtype=np.float64),
            self.rows,
            float(self.reach_speed),
            float(self.growth_limit),
        )
        return distance, gradient


def occupied(predictions: Sequence[Prediction], now: float, options: OccupancyOptions | None = None) -> Occupancy:
    """What several people may fill, one prediction each.

    Each capsule holds its limb with probability `level` and is grown by the limb's radius. Where what the person can
    reach at all since the prediction's stamp is smaller, that is taken. A prediction whose status is not OK, or which
    is older than `stale_after`, counts as the reachable set.

    Args:
        predictions: the newest of each person.
        now: the present time on the predictions' clock [s].
        options: see OccupancyOptions.
    """
    options = options or OccupancyOptions()
    persons = []
    for prediction in predictions:
        trusted = is_trusted(prediction, now, options) and bool(np.isfinite(prediction.samples).all())
        persons.append(_predicted(prediction, options) if trusted else _unpredicted(prediction, now, options))
    return _joined(persons, now, options)


def is_trusted(prediction: Prediction, now: float, options: OccupancyOptions) -> bool:
    """Whether a prediction says more than what can be reached: its status is OK, and it is not too old."""
    return prediction.status is Status.OK and now - prediction.stamp <= options.stale_after + 1e-9


def reachable(predictions: Sequence[Prediction], now: float, options: OccupancyOptions | None = None) -> Occupancy:
    """What several people can reach at all, whatever is predicted; arguments as `occupied`."""
    options = options or OccupancyOptions()
    return _joined([_unpredicted(prediction, now, options) for prediction in predictions], now, options)


def seen(frames: Sequence[SkeletonFrame], now: float, options: OccupancyOptions | None = None) -> Occupancy:
    """What several people can reach from where they were last seen, one frame each; arguments as `occupied`."""
    options = options or OccupancyOptions()
    return _joined([_reach(arms_of(frame), frame.stamp, now, options) for frame in frames], now, options)


def measured(frames: Sequence[SkeletonFrame], now: float, options: OccupancyOptions | None = None) -> Occupancy:
    """The bodies of several people as they were last seen, one frame each; arguments as `occupied`.

    They do not grow: this is for distances to what was measured.
    """
    options = replace(options or OccupancyOptions(), reach_speed=0.0, growth_limit=0.0)
    persons = [_Person(np.array([now]), _bodies(arms_of(frame)[None], options)) for frame in frames]
    return _joined(persons, now, options)


@dataclass(frozen=True, eq=False)
class _Person:
    """One person's capsules (T, 9, 7) at times (T,)."""

    times: Float[np.ndarray, " T"]
    rows: Float[np.ndarray, "T 9 7"]


def _predicted(prediction: Prediction, options: OccupancyOptions) -> _Person:
    """The predicted region, or what can be reached where that is smaller."""
    rows: Float[np.ndarray, "T 9 7"] = regions(
        np.ascontiguousarray(prediction.samples),
        *(options.hand_length, options.trunk_length, options.head_height),
        options.level,
    )
    rows[..., 6] += options.radii
    reach = _bodies(np.repeat(_arms_at_stamp(prediction)[None], len(rows), axis=0), options)
    reach[..., 6] += options.speeds * np.maximum(prediction.times - prediction.stamp, 0.0)[:, None]
    smaller = reach[..., 6] < rows[..., 6]
    return _Person(prediction.times, np.where(smaller[..., None], reach, rows))


def _unpredicted(prediction: Prediction, now: float, options: OccupancyOptions) -> _Person:
    """What can be reached since the prediction's stamp."""
    return _reach(_arms_at_stamp(prediction), prediction.stamp, now, options)


def _reach(arms: Float[np.ndarray, "6 3"], stamp: float, now: float, options: OccupancyOptions) -> _Person:
    """What can be reached from these joints, seen at the stamp; it grows evenly, so that two times say it all."""
    times = np.array([now, now + options.horizon])
    rows = _bodies(np.repeat(arms[None], 2, axis=0), options)
    rows[..., 6] += options.speeds * np.maximum(times - stamp, 0.0)[:, None]
    return _Person(times, rows)


def arms_of(frame: SkeletonFrame) -> Float[np.ndarray, "6 3"]:
    """(6, 3) the six arm joints of a frame; NaN where it has none."""
    place = dict(zip(frame.joints, frame.positions, strict=True))
    return np.stack([place.get(name, np.full(3, np.nan)) for name in _ARM])


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


def _bodies(arms: Float[np.ndarray, "T 6 3"], options: OccupancyOptions) -> Float[np.ndarray, "T 9 7"]:
    """(T, 9, 7) the `PARTS` at their own thickness; one not seen fills all it may from the nearest that was."""
    known = np.isfinite(arms).all(axis=-1)
    apart = np.where(known[:, None, :], np.abs(_ALONG[:, None] - _ALONG), np.inf)
    nearest = apart.argmin(axis=-1)
    slack = apart.min(axis=-1)
    seen_at_all = known.any(axis=-1)
    filled = np.take_along_axis(np.where(known[..., None], arms, 0.0), nearest[..., None], axis=1)
    slack = np.where(seen_at_all[:, None], slack, _EVERYWHERE)
    slack = np.concatenate(
        [slack, slack[:, [2, 5]], np.repeat(slack[:, [0, 3]].max(axis=1)[:, None], 3, axis=1)], axis=1
    )
    radius = options.radii + np.maximum(slack[:, STARTS], slack[:, STOPS])
    lengths = (options.hand_length, options.trunk_length, options.head_height)
    bodies: Float[np.ndarray, "T 9 7"] = regions(filled[None], *lengths, 1.0)
    bodies[..., 6] = radius
    return bodies


def _joined(persons: Sequence[_Person], now: float, options: OccupancyOptions) -> Occupancy:
    """Several persons' capsules side by side, at every time that one of them is known at."""
    if not persons:
        return Occupancy.empty(now)
    times = np.unique(np.concatenate([person.times for person in persons]))
    rows = np.concatenate([_at(person, times, options) for person in persons], axis=1)
    start, end, radius = np.split(rows, [3, 6], axis=-1)
    return Occupancy(now, times, start, end, radius[..., 0], options.reach_speed, options.growth_limit)


def _at(person: _Person, times: Float[np.ndarray, " T"], options: OccupancyOptions) -> Float[np.ndarray, "T 9 7"]:
    """One person's capsules at other times."""
    if np.array_equal(times, person.times):
        return person.rows
    start, end, radius = np.split(person.rows, [3, 6], axis=-1)
    alone = Occupancy(times[0], person.times, start, end, radius[..., 0], options.reach_speed, options.growth_limit)
    return alone.rows_at(times)
