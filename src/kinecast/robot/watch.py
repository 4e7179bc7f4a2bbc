"""What is known of everybody in the cell: where each joint was last seen, how long ago, and how fast it moves."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float

from kinecast.robot.body import BodyCapsules, OccupancyOptions, body_capsules
from kinecast.robot.camera import Shot
from kinecast.types import SkeletonFrame

__all__ = ["Seen", "Watch", "WatchOptions"]

ARM_PARTS = ("shoulder", "elbow", "wrist")
HARDEST = 10.0
"""No joint gains speed faster [m/s²]: beyond that it is the tracking."""
AS_THEY_ARE = OccupancyOptions(hand_length=0.0)
"""For values that belong to joints but are no places."""


@dataclass(frozen=True)
class WatchOptions:
    """How long what was seen is kept.

    Attributes:
        slope: span of measurements over which a joint's speed is taken [s].
        forget: a person who was not on any shot for this long has left [s].
        body: radii around the joints.
    """

    slope: float = 0.14
    forget: float = 0.5
    body: OccupancyOptions = field(default_factory=OccupancyOptions)


@dataclass(frozen=True)
class Seen:
    """Capsules of everybody, K in all.

    Attributes:
        capsules: where they were last seen; NaN where never.
        start_velocity, end_velocity: (K, 3) of their ends [m/s], in the middle of the last measurements; NaN where not
            known.
        start_velocity_now, end_velocity_now: (K, 3) as they are by now, gaining speed as they did [m/s]; NaN where not
            known.
        age: (K,) of the oldest joint behind each [s].
    """

    capsules: BodyCapsules
    start_velocity: Float[np.ndarray, "K 3"]
    end_velocity: Float[np.ndarray, "K 3"]
    start_velocity_now: Float[np.ndarray, "K 3"]
    end_velocity_now: Float[np.ndarray, "K 3"]
    age: Float[np.ndarray, " K"]


class Watch:
    """Keeps the last measurements of every person.

    Args:
        options: see WatchOptions.
    """

    def __init__(self, options: WatchOptions | None = None) -> None:
        self.options = options or WatchOptions()
        self.newest = -np.inf
        self._tracks: dict[str, _Track] = {}

    @property
    def persons(self) -> tuple[str, ...]:
        """Who is there, as far as is known."""
        return tuple(self._tracks)

    def add(self, shot: Shot) -> None:
        """Takes in a shot; one older than the newest is passed over."""
        if not np.isfinite(shot.stamp) or shot.stamp <= self.newest:
            return
        self.newest = shot.stamp
        for frame in shot.frames:
            track = self._tracks.get(frame.person)
            if track is None or track.joints != frame.joints:
                track = self._tracks[frame.person] = _Track(frame.joints)
            track.add(frame, self.options.slope)
        for name, track in list(self._tracks.items()):
            if shot.stamp - track.stamp > self.options.forget:
                del self._tracks[name]

    def wrists(self) -> Float[np.ndarray, "W 3"]:
        """(W, 3) where every wrist was last seen [m]; NaN where never."""
        found = [
            track.last[track.joints.index(name)]
            for track in self._tracks.values()
            for name in ("left_wrist", "right_wrist")
            if name in track.joints
        ]
        return np.array(found).reshape(-1, 3)

    def unseen(self) -> list[str]:
        """Persons of whom an arm's joint was never seen: nobody knows where it is."""
        return [name for name, track in self._tracks.items() if not np.isfinite(track.arms).all()]

    def seen(self, now: float) -> Seen:
        """Everybody's capsules as last seen."""
        parts = [track.seen(now, self.options.body) for track in self._tracks.values()]
        if not parts:
            nothing = np.empty((0, 3))
            return Seen(BodyCapsules(nothing, nothing, np.empty(0)), nothing, nothing, nothing, nothing, np.empty(0))
        return Seen(
            BodyCapsules(
                np.concatenate([part.capsules.start for part in parts]),
                np.concatenate([part.capsules.end for part in parts]),
                np.concatenate([part.capsules.radius for part in parts]),
            ),
            np.concatenate([part.start_velocity for part in parts]),
            np.concatenate([part.end_velocity for part in parts]),
            np.concatenate([part.start_velocity_now for part in parts]),
            np.concatenate([part.end_velocity_now for part in parts]),
            np.concatenate([part.age for part in parts]),
        )


class _Track:
    """The last measurements of one person."""

    def __init__(self, joints: tuple[str, ...]) -> None:
        self.joints = joints
        self.stamp = -np.inf
        self.last = np.full((len(joints), 3), np.nan)
        self._seen_at = np.full(len(joints), -np.inf)
        self._seen: Seen | None = None
        self._gain = (np.empty((0, 3)), np.empty((0, 3)))
        self._history: deque[tuple[float, Float[np.ndarray, "J 3"]]] = deque(maxlen=64)

    @property
    def arms(self) -> Float[np.ndarray, "A 3"]:
        """(A, 3) the last places of shoulders, elbows and wrists [m]."""
        return self.last[[name.endswith(ARM_PARTS) for name in self.joints]]

    def add(self, frame: SkeletonFrame, span: float) -> None:
        valid = frame.valid
        self._seen = None
        self.stamp = frame.stamp
        self.last[valid] = frame.positions[valid]
        self._seen_at[valid] = frame.stamp
        self._history.append((frame.stamp, frame.positions))
        while frame.stamp - self._history[0][0] > span:
            self._history.popleft()

    def motion(self) -> tuple[Float[np.ndarray, "J 3"], Float[np.ndarray, "J 3"], float]:
        """Velocity (J, 3) [m/s] and acceleration (J, 3) [m/s²] of each joint, and how long ago the velocity was [s].

        Of the straight line and of the parabola through the last measurements; NaN with fewer than three, and four.
        Joints of trunk and head that were not always seen move with the shoulders.
        """
        unknown = np.full_like(self.last, np.nan)
        if len(self._history) < 3:
            return unknown, unknown, 0.0
        stamps = np.array([stamp for stamp, _ in self._history])
        places = np.array([positions for _, positions in self._history])
        lever = stamps - stamps.mean()
        slope: Float[np.ndarray, "J 3"] = np.einsum("n,njk->jk", lever, places) / (lever @ lever)
        bend = lever**2 - np.mean(lever**2)
        bend -= lever * (bend @ lever) / (lever @ lever)
        curve = unknown if len(stamps) < 4 else 2.0 * np.einsum("n,njk->jk", bend, places) / (bend @ bend)
        size = np.linalg.norm(curve, axis=1, keepdims=True)
        curve = curve * np.minimum(1.0, HARDEST / np.maximum(size, 1e-9))
        shoulders = [row for row, name in enumerate(self.joints) if name.endswith("shoulder")]
        rest = [row for row, name in enumerate(self.joints) if not name.endswith(ARM_PARTS)]
        lost = [row for row in rest if not np.isfinite(slope[row]).all()]
        for values in (slope, curve):
            values[lost] = values[shoulders].mean(axis=0)
        return slope, curve, float(stamps[-1] - stamps.mean())

    def seen(self, now: float, body: OccupancyOptions) -> Seen:
        if self._seen is None:
            self._seen, self._gain = self._find(body)
        since = now - self.stamp
        return replace(
            self._seen,
            start_velocity_now=self._seen.start_velocity_now + since * self._gain[0],
            end_velocity_now=self._seen.end_velocity_now + since * self._gain[1],
            age=self._seen.age + since,
        )

    def _find(self, body: OccupancyOptions) -> tuple[Seen, tuple[np.ndarray, np.ndarray]]:
        """What was seen, as of the newest frame, and how fast the velocities of starts and ends change [m/s²]."""
        capsules = body_capsules(self.joints, self.last, body)
        velocity, acceleration, lag = self.motion()
        start, end = self._rate(velocity, capsules, body)
        gain = self._rate(acceleration, capsules, body)
        ages = np.repeat((self.stamp - self._seen_at)[:, None], 3, axis=1)
        age = body_capsules(self.joints, ages, AS_THEY_ARE)
        seen = Seen(
            capsules, start, end, start + lag * gain[0], end + lag * gain[1],
            np.maximum(age.start[:, 0], age.end[:, 0]),
        )  # fmt: skip
        return seen, gain

    def _rate(
        self, values: Float[np.ndarray, "J 3"], capsules: BodyCapsules, body: OccupancyOptions
    ) -> tuple[np.ndarray, np.ndarray]:
        """Of starts and ends, whatever joints they hang on: by the capsules of joints a moment later."""
        moment, known = 1e-3, np.isfinite(values)
        moved = body_capsules(self.joints, self.last + moment * np.where(known, values, 0.0), body)
        unknown = body_capsules(self.joints, np.where(known, 0.0, np.nan), body)
        return (
            np.where(np.isfinite(unknown.start), (moved.start - capsules.start) / moment, np.nan),
            np.where(np.isfinite(unknown.end), (moved.end - capsules.end) / moment, np.nan),
        )
