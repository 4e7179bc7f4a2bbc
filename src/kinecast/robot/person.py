"""People in the cell: played from recorded or generated positions."""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from kinecast.errors import OptionError
from kinecast.geometry.transforms import apply
from kinecast.robot.body import TRUE_BODY, body_capsules
from kinecast.robot.separation import SeparationOptions, separation
from kinecast.robot.ur5 import LinkCapsules

__all__ = ["Person", "PlayedPerson", "ReactivePerson"]


@runtime_checkable
class Person(Protocol):
    """Somebody whose joints are known at every instant: the truth, which only the simulation sees."""

    @property
    def name(self) -> str:
        """Tells persons apart."""
        ...

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the J joints (kinecast.body.skeleton)."""
        ...

    def at(self, time: float) -> Float[np.ndarray, "J 3"] | None:
        """(J, 3) positions in the cell [m]; None while not in it."""
        ...


@dataclass(frozen=True, eq=False)
class PlayedPerson:
    """A motion placed in the cell; between frames it goes on evenly, before and after it stands still.

    Attributes:
        name: tells persons apart.
        joints: names of the J joints.
        stamps: (N,) rising [s], on the simulation's clock.
        positions: (N, J, 3) in the person's own frame [m]; a joint that is missing is bridged, or NaN if it always is.
        placement: (4, 4) T_cell_person.
        present: when the person is in the cell, from and until [s].
    """

    name: str
    joints: tuple[str, ...]
    stamps: Float[np.ndarray, " N"]
    positions: Float[np.ndarray, "N J 3"]
    placement: Float[np.ndarray, "4 4"]
    present: tuple[float, float] = (-np.inf, np.inf)

    def __post_init__(self) -> None:
        if len(self.stamps) == 0 or not np.all(np.diff(self.stamps) > 0):
            raise OptionError(f"person {self.name!r}: stamps must rise, and there must be one")
        if self.positions.shape != (len(self.stamps), len(self.joints), 3):
            raise OptionError(
                f"person {self.name!r}: positions {self.positions.shape} do not fit "
                f"{len(self.stamps)} stamps and {len(self.joints)} joints"
            )
        whole = np.array(apply(self.placement, self.positions))
        for joint in range(len(self.joints)):
            seen = np.isfinite(whole[:, joint]).all(axis=-1)
            if seen.any() and not seen.all():
                for axis in range(3):
                    whole[~seen, joint, axis] = np.interp(
                        self.stamps[~seen], self.stamps[seen], whole[seen, joint, axis]
                    )
        object.__setattr__(self, "positions", whole)
        object.__setattr__(self, "placement", np.eye(4))

    def at(self, time: float) -> Float[np.ndarray, "J 3"] | None:
        """(J, 3) positions in the cell [m]; None while not in it."""
        if not self.present[0] <= time < self.present[1]:
            return None
        after = int(np.clip(np.searchsorted(self.stamps, time, side="right"), 1, max(len(self.stamps) - 1, 1)))
        if len(self.stamps) == 1:
            return self.positions[0]
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
        margin: to the arm [m].
        foresight: how far ahead they look [s].
        change: how fast they slow down and take up again, of their own speed [1/s].
        patience: how long they wait, and how long they draw back at first [s]; so much longer each time in a row.
    """

    def __init__(
        self, person: PlayedPerson, margin: float = 0.06, foresight: float = 0.25, change: float = 5.0,
        patience: float = 1.0,
    ) -> None:  # fmt: skip
        self.person, self.margin, self.foresight, self.change = person, margin, foresight, change
        self.patience = patience
        self._times, self._clocks, self._rate = [0.0], [0.0], 1.0
        self._blocked_since: float | None = None
        self._tries, self._furthest = 1, 0.0

    @property
    def name(self) -> str:
        """Tells persons apart."""
        return self.person.name

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the J joints."""
        return self.person.joints

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

    def mind(self, arm: LinkCapsules, now: float) -> None:
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
        here, soon = self.person.at(clock), self.person.at(clock + wish * self.foresight)
        if here is not None and soon is not None:
            near, later = (self._distance(pose, arm) for pose in (here, soon))
            blocked = later < self.margin and later < near
            if not back and not blocked:
                self._blocked_since = None
            elif not back and self._blocked_since is None:
                self._blocked_since = now
            wish = 0.0 if blocked else wish
        step = self.change * (now - self._times[-2])
        self._rate = min(max(wish, self._rate - step), self._rate + step)

    def _distance(self, pose: Float[np.ndarray, "J 3"], arm: LinkCapsules) -> float:
        """From the body to the arm [m]."""
        body = body_capsules(self.joints, pose, TRUE_BODY)
        still = np.zeros_like(body.start), np.zeros_like(body.end)
        links = arm.start[0], arm.end[0], arm.radius
        resting = np.zeros_like(links[0]), np.zeros_like(links[1])
        thickness = body.start, body.end, body.radius
        return separation(links, resting, thickness, still, np.zeros(len(body.radius)), SeparationOptions()).distance
