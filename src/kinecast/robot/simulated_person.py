"""People in the cell, played from recorded or generated positions, and what a depth camera makes of them."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from kinecast.robot.body import TRUE_BODY, body_capsules, interpolated
from kinecast.robot.people import CameraFrame
from kinecast.robot.separation import Moving, SeparationOptions, moving, separation
from kinecast.types import SkeletonFrame

RATE = 30.0  # of the camera's shots [Hz]
MARGIN, FORESIGHT = 0.06, 0.25  # a person goes no nearer to the arm than this at first [m], and looks so far ahead [s]
PATIENCE = 1.0
"""How long they wait, and how long they draw back at first [s]; so much longer each time in a row."""
CHANGE = 5.0  # how fast they slow down and take up again, of their own speed [1/s]


@dataclass(frozen=True, eq=False)
class PlayedPerson:
    """A motion in the cell; between frames it goes on evenly, before and after it stands still.

    A joint that is missing is bridged, or NaN if it always is.
    """

    name: str  # tells persons apart
    joints: tuple[str, ...]  # names of the J joints (kinecast.body.skeleton)
    stamps: Float[np.ndarray, " N"]  # rising, on the simulation's clock [s]
    positions: Float[np.ndarray, "N J 3"]  # in the cell [m]

    def __post_init__(self) -> None:
        whole = self.positions.copy()
        for column in whole.reshape(len(whole), -1).T:
            seen = np.isfinite(column)
            if seen.any():
                column[~seen] = np.interp(self.stamps[~seen], self.stamps[seen], column[seen])
        object.__setattr__(self, "positions", whole)

    def at(self, time: float) -> Float[np.ndarray, "J 3"]:
        """(J, 3) positions in the cell [m]."""
        return interpolated(np.array([time]), self.stamps, self.positions)[0]


class ReactivePerson:
    """Somebody who does what was recorded, but stops short of an arm that is in the way, and goes on when it is gone.

    If it is still there after a while they draw back the way they came, and try again, each time farther and nearer
    past it. Everybody does so who sees a robot; a recording alone would be pushed through it, and two who wait for one
    another would wait for ever.

    Args:
        person: what they want to do.
    """

    def __init__(self, person: PlayedPerson) -> None:
        self.person = person
        self.name, self.joints = person.name, person.joints
        self._times, self._clocks, self._rate = [0.0], [0.0], 1.0
        self._blocked_since: float | None = None
        self._tries, self._furthest = 1, 0.0

    def at(self, time: float) -> Float[np.ndarray, "J 3"]:
        """(J, 3) positions in the cell [m]; what is still to come as if nothing were in the way."""
        return self.person.at(self._clock(time))

    def _clock(self, time: float) -> float:
        """How far into their motion they are at a time [s]."""
        if time >= self._times[-1]:
            return self._clocks[-1] + self._rate * (time - self._times[-1])
        after = max(bisect_right(self._times, time), 1)
        (before, end), (first, last) = self._times[after - 1 : after + 1], self._clocks[after - 1 : after + 1]
        return first + (last - first) / (end - before) * max(time - before, 0.0)

    def mind(self, arm: Moving, now: float) -> None:
        """Looks at where the arm is now, and slows down if it is in the way."""
        clock = self._clock(now)
        self._times.append(now)
        self._clocks.append(clock)
        waited = 0.0 if self._blocked_since is None else now - self._blocked_since
        if clock > self._furthest + PATIENCE:  # they got past it
            self._tries, self._furthest = 1, clock
        back = PATIENCE <= waited < (1 + self._tries) * PATIENCE
        if waited >= (1 + self._tries) * PATIENCE:
            self._blocked_since, self._tries = None, self._tries + 1
            self._furthest = max(self._furthest, clock)
        wish = -1.0 if back else 1.0
        poses = (self.person.at(each) for each in (clock, clock + wish * FORESIGHT))
        bodies = (body_capsules(self.joints, np.stack([pose, pose]), TRUE_BODY) for pose in poses)
        near, later = (separation(arm, moving(body, 1.0), SeparationOptions()).distance for body in bodies)
        blocked = later < MARGIN / self._tries and later < near
        if not back and not blocked:
            self._blocked_since = None
        elif not back and self._blocked_since is None:
            self._blocked_since = now
        wish = 0.0 if blocked else wish
        step = CHANGE * (now - self._times[-2])
        self._rate = min(max(wish, self._rate - step), self._rate + step)


Person = PlayedPerson | ReactivePerson
"""Somebody whose joints are known at every instant: the truth, which only the simulation sees."""


@dataclass
class Camera:
    """A camera and its tracker: takes a shot at every multiple of its period, noisy, late, with gaps."""

    delay: float = 0.04  # from taking to knowing [s]: exposure, pose estimation, network
    noise: float = 0.002  # standard deviation of each coordinate [m]; HA4M: 1.3 mm at the neck to 2.4 mm at a wrist
    lost: float = 0.01  # share of shots in which one arm is not seen
    dropped: float = 0.005  # share of shots that never arrive
    seed: int = 0  # of the noise
    _next: int = field(default=0, init=False)

    def shots(self, now: float, people: Sequence[Person]) -> list[CameraFrame]:
        """Shots that have become known by now and were not handed over before, oldest first."""
        due = []
        while (stamp := self._next / RATE) + self.delay <= now + 1e-9:
            rng = np.random.default_rng([self.seed, self._next])  # of this shot: what happens before changes nothing
            if rng.random() >= self.dropped:
                due.append(CameraFrame(stamp, tuple(self._frame(rng, stamp, person) for person in people)))
            self._next += 1
        return due

    def _frame(self, rng: np.random.Generator, stamp: float, person: Person) -> SkeletonFrame:
        pose = person.at(stamp)
        seen = pose + rng.normal(0.0, 1.0, pose.shape) * self.noise
        if rng.random() < self.lost:
            side = "left" if rng.random() < 0.5 else "right"
            parts = ("wrist",) if rng.random() < 0.5 else ("elbow", "wrist")
            seen[[name in {f"{side}_{part}" for part in parts} for name in person.joints]] = np.nan
        return SkeletonFrame(stamp, person.joints, seen, person.name, "cell")
