"""People in the cell: played from recorded or generated positions."""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from kinecast.errors import OptionError
from kinecast.robot.body import TRUE_BODY, body_capsules
from kinecast.robot.capsules import Capsules
from kinecast.robot.separation import SeparationOptions, separation

__all__ = ["Person", "PlayedPerson", "ReactivePerson"]

MARGIN, FORESIGHT = 0.06, 0.25
"""A person goes no nearer to the arm than this [m], and looks so far ahead [s]."""
CHANGE = 5.0
"""How fast they slow down and take up again, of their own speed [1/s]."""


@dataclass(frozen=True, eq=False)
class PlayedPerson:
    """A motion in the cell; between frames it goes on evenly, before and after it stands still.

    A joint that is missing is bridged, or NaN if it always is.
    """

    name: str  # tells persons apart
    joints: tuple[str, ...]  # names of the J joints (kinecast.body.skeleton)
    stamps: Float[np.ndarray, " N"]  # rising, on the simulation's clock [s]
    positions: Float[np.ndarray, "N J 3"]  # in the cell [m]
    present: tuple[float, float] = (-np.inf, np.inf)  # when the person is in the cell, from and until [s]

    def __post_init__(self) -> None:
        if len(self.stamps) == 0 or not np.all(np.diff(self.stamps) > 0):
            raise OptionError(f"person {self.name!r}: stamps must rise, and there must be one")
        whole = self.positions.copy()
        for column in whole.reshape(len(whole), -1).T:
            seen = np.isfinite(column)
            if seen.any():
                column[~seen] = np.interp(self.stamps[~seen], self.stamps[seen], column[seen])
        object.__setattr__(self, "positions", whole)

    def at(self, time: float) -> Float[np.ndarray, "J 3"] | None:
        """(J, 3) positions in the cell [m]; None while not in it."""
        if not self.present[0] <= time < self.present[1]:
            return None
        if len(self.stamps) == 1:
            return self.positions[0]
        after = int(np.clip(np.searchsorted(self.stamps, time, side="right"), 1, len(self.stamps) - 1))
        before, end = self.stamps[after - 1], self.stamps[after]
        share = min(max((time - before) / (end - before), 0.0), 1.0)
        pose: Float[np.ndarray, "J 3"] = (1 - share) * self.positions[after - 1] + share * self.positions[after]
        return pose


class ReactivePerson:
    """Somebody who does what was recorded, but stops short of an arm that is in the way, and goes on when it is gone.

    If it is still there after a while they draw back the way they came, each time farther, and try again. Everybody
    does so who sees a robot; a recording alone would be pushed through it, and two who wait for one another would
    wait for ever.

    Args:
        person: what they want to do.
        patience: how long they wait, and how long they draw back at first [s]; so much longer each time in a row.
    """

    def __init__(self, person: PlayedPerson, patience: float = 1.0) -> None:
        self.person, self.patience = person, patience
        self.name, self.joints = person.name, person.joints
        self._times, self._clocks, self._rate = [0.0], [0.0], 1.0
        self._blocked_since: float | None = None
        self._tries, self._furthest = 1, 0.0

    def at(self, time: float) -> Float[np.ndarray, "J 3"] | None:
        """(J, 3) positions in the cell [m]; what is still to come as if nothing were in the way."""
        return self.person.at(self._clock(time))

    def _clock(self, time: float) -> float:
        """How far into their motion they are at a time [s]."""
        if time >= self._times[-1]:
            return self._clocks[-1] + self._rate * (time - self._times[-1])
        after = max(bisect_right(self._times, time), 1)
        (before, end), (first, last) = self._times[after - 1 : after + 1], self._clocks[after - 1 : after + 1]
        return first + (last - first) / (end - before) * max(time - before, 0.0)

    def mind(self, arm: Capsules, now: float) -> None:
        """Looks at where the arm is now (N = 1), and slows down if it is in the way."""
        clock = self._clock(now)
        self._times.append(now)
        self._clocks.append(clock)
        waited = 0.0 if self._blocked_since is None else now - self._blocked_since
        if clock > self._furthest + self.patience:  # they got past it
            self._tries, self._furthest = 1, clock
        back = self.patience <= waited < (1 + self._tries) * self.patience
        if waited >= (1 + self._tries) * self.patience:
            self._blocked_since, self._tries = None, self._tries + 1
            self._furthest = max(self._furthest, clock)
        wish = -1.0 if back else 1.0
        here, soon = self.person.at(clock), self.person.at(clock + wish * FORESIGHT)
        if here is not None and soon is not None:
            near, later = (self._distance(pose, arm) for pose in (here, soon))
            blocked = later < MARGIN and later < near
            if not back and not blocked:
                self._blocked_since = None
            elif not back and self._blocked_since is None:
                self._blocked_since = now
            wish = 0.0 if blocked else wish
        step = CHANGE * (now - self._times[-2])
        self._rate = min(max(wish, self._rate - step), self._rate + step)

    def _distance(self, pose: Float[np.ndarray, "J 3"], arm: Capsules) -> float:
        """From the body to the arm [m]."""
        body = body_capsules(self.joints, pose, TRUE_BODY)
        still, resting = np.zeros_like(body.start), np.zeros_like(arm.start[0])
        return separation(
            (arm.start[0], arm.end[0], arm.radius), (resting, resting), (body.start, body.end, body.radius),
            (still, still), np.zeros(len(body.radius)), SeparationOptions(),
        ).distance  # fmt: skip


Person = PlayedPerson | ReactivePerson
"""Somebody whose joints are known at every instant: the truth, which only the simulation sees."""
