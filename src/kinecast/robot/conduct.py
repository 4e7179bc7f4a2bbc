"""How fast the arm goes on, and what that is called: steady, though what holds it back flickers."""

from __future__ import annotations

from enum import Enum

from kinecast.robot.pace import Pace, Restraint

__all__ = ["STILL", "Conduct", "Level"]

STILL = 0.02
"""Share of the planned speed below which the arm stands."""
FREE = 0.95
"""Share above which nothing holds it back."""
BRAKED = 0.5
"""Share below which being held back is said at once."""
AT_ONCE = {Restraint.SILENCE, Restraint.UNSEEN}


class Level(Enum):
    """How fast it has been going for a while."""

    HELD = "not at all"
    SLOW = "more slowly"
    FULL = "at full speed"


class Conduct:
    """Brakes at once and speeds up gently; says that it is slower at once, faster or for another reason after a while.

    Args:
        rise: how fast the speed may rise again [1/s].
        settle: a faster level or another cause is new only after so long [s].
    """

    def __init__(self, rise: float, settle: float) -> None:
        self.speed = 0.0
        self.level, self.cause = Level.FULL, Restraint.NOTHING
        self._rise, self._settle = rise, settle
        self._now = 0.0
        self._level_since = self._cause_since = -float("inf")

    def begin(self, at_rest: bool) -> None:
        """On a new path; from rest it begins gently by itself."""
        if at_rest:
            self.speed = 1.0
        self.level, self._level_since = Level.FULL, self._now

    def update(self, pace: Pace, limit: float, now: float) -> None:
        """Takes in what holds the arm back, and the share that it may go at for other reasons too [0..1]."""
        self.speed = min(limit, self.speed + self._rise * (now - self._now))
        self._now = now
        level = Level.FULL if pace.speed > FREE else Level.SLOW if pace.speed > STILL else Level.HELD
        braked = level is Level.HELD or (level is Level.SLOW and self.level is Level.FULL and pace.speed < BRAKED)
        if level is self.level:
            self._level_since = now
        elif braked or now - self._level_since >= self._settle:
            self.level, self._level_since = level, now
        at_once = self.cause is Restraint.NOTHING or {self.cause, pace.restraint} & AT_ONCE
        if pace.restraint is self.cause:
            self._cause_since = now
        elif at_once or now - self._cause_since >= self._settle:
            self.cause, self._cause_since = pace.restraint, now
