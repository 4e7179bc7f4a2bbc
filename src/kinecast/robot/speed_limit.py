"""How fast the arm may go now, and what holds it back: steady, though what holds it back flickers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum

import numpy as np
from jaxtyping import Float

from kinecast.robot.expected_time import RISE
from kinecast.robot.people import PeopleModel
from kinecast.robot.separation import Separation, SeparationOptions, separation
from kinecast.robot.ur5 import UR5

__all__ = ["Level", "LimitReason", "Path", "SpeedHysteresis", "SpeedLimit", "speed_limit"]

Path = Callable[[Float[np.ndarray, " N"]], Float[np.ndarray, "N 6"]]
"""Configurations [rad] so many seconds from now."""

SILENCE = 0.2
"""Without a shot for this long, nobody knows who is there [s]."""
DOUBT = 0.75
"""Share of the planned speed beside somebody whose prediction is not OK, or too old."""
SETTLE = 0.15
"""Going faster, or another reason for going slowly, is new only after so long [s]."""
STILL = 0.02
"""Share of the planned speed below which the arm stands."""
FREE = 0.95
"""Share above which nothing holds it back."""
BRAKED = 0.5
"""Share below which being held back is said at once."""


class LimitReason(Enum):
    """What holds the arm back."""

    NOTHING = "nothing"
    DOUBT = "a person of whom nobody can say what they will do"
    SEPARATION = "the safety distance"
    SILENCE = "the camera"
    UNSEEN = "a person whose arms were never seen"


AT_ONCE = {LimitReason.SILENCE, LimitReason.UNSEEN}


@dataclass(frozen=True)
class SpeedLimit:
    """How fast the arm may go.

    Attributes:
        speed: share of the planned speed, 0..1.
        reason: what holds the arm back most.
        separation: what the measured distance asks for at the present speed.
    """

    speed: float
    reason: LimitReason
    separation: Separation


def speed_limit(
    arm: UR5,
    people: PeopleModel,
    monitoring: SeparationOptions,
    q: Float[np.ndarray, "6"],
    qd: Float[np.ndarray, "6"],
    path: Path,
    speed: float,
    now: float,
) -> SpeedLimit:
    """The least of what measurement and camera allow, and less than full speed where predictions are in doubt.

    Args:
        arm: its kinematics.
        people: what is known of them.
        monitoring: constants of speed and separation monitoring.
        q: (6,) where the arm is [rad]; qd: (6,) how fast [rad/s].
        path: where it will be at full speed.
        speed: share of the planned speed it has now.
        now: [s].
    """
    moment = 1e-3
    here, soon = path(np.array([0.0, moment]))
    capsules = arm.capsules(np.stack([q, q + moment * qd, q + (soon - here)]))
    seen = people.seen(now)
    present, full = (
        separation(
            (capsules.start[0], capsules.end[0], capsules.radius),
            ((capsules.start[k] - capsules.start[0]) / moment, (capsules.end[k] - capsules.end[0]) / moment),
            (seen.start, seen.end, seen.radius),
            (seen.start_velocity, seen.end_velocity),
            seen.age,
            monitoring,
            (seen.start_velocity_now, seen.end_velocity_now),
        )
        for k in (1, 2)  # at the present velocity, and at the path's own
    )
    # The arm may not yet move as its path says, or not as fast: both what it does and what it is about to do count.
    measured = min(full.scale, present.scale * speed if present.scale < 1.0 else 1.0)
    limits = [(1.0, LimitReason.NOTHING)]
    if len(people.trusted(now)) < len(people.predictions):
        limits.append((DOUBT, LimitReason.DOUBT))
    if measured < 1.0:
        limits.append((measured, LimitReason.SEPARATION))
    if now - people.newest > SILENCE:
        limits.append((0.0, LimitReason.SILENCE))
    if people.unseen():
        limits.append((0.0, LimitReason.UNSEEN))
    least = min(limit for limit, _ in limits)
    return SpeedLimit(least, [reason for limit, reason in limits if limit <= least][-1], present)


class Level(Enum):
    """How fast it has been going for a while."""

    HELD = "not at all"
    SLOW = "more slowly"
    FULL = "at full speed"


class SpeedHysteresis:
    """Brakes at once and speeds up gently; says at once that it is slower, the rest after a while."""

    def __init__(self) -> None:
        self.speed = 0.0
        self.level, self.reason = Level.FULL, LimitReason.NOTHING
        self._now = 0.0
        self._level_since = self._reason_since = -float("inf")

    def begin(self) -> None:
        """On a new path, which begins gently by itself."""
        self.speed = 1.0
        self.level, self._level_since = Level.FULL, self._now

    def update(self, limit: SpeedLimit, most: float, now: float) -> None:
        """Takes in what holds the arm back, and the share that it may go at for other reasons too [0..1]."""
        self.speed = min(most, self.speed + RISE * (now - self._now))
        self._now = now
        level = Level.FULL if limit.speed > FREE else Level.SLOW if limit.speed > STILL else Level.HELD
        braked = level is Level.HELD or (level is Level.SLOW and self.level is Level.FULL and limit.speed < BRAKED)
        if level is self.level:
            self._level_since = now
        elif braked or now - self._level_since >= SETTLE:
            self.level, self._level_since = level, now
        at_once = self.reason is LimitReason.NOTHING or {self.reason, limit.reason} & AT_ONCE
        if limit.reason is self.reason:
            self._reason_since = now
        elif at_once or now - self._reason_since >= SETTLE:
            self.reason, self._reason_since = limit.reason, now
