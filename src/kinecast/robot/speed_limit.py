"""How fast the arm may go now, and what holds it back: steady, though what holds it back flickers."""

from __future__ import annotations

from enum import Enum
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from kinecast.robot.expected_time import RISE
from kinecast.robot.people import PeopleModel
from kinecast.robot.separation import Separation, SeparationOptions, moving, separation
from kinecast.robot.ur5 import UR5

SILENCE = 0.2  # without a shot for this long, nobody knows who is there [s]
DOUBT = 0.75  # share of the planned speed beside somebody whose prediction is not OK, or too old
SETTLE = 0.15  # going faster, or another reason for going slowly, is new only after so long [s]
STILL = 0.02  # share of the planned speed below which the arm stands
FREE = 0.95  # share above which nothing holds it back
BRAKED = 0.5  # share below which being held back is said at once
MOMENT = 1e-3  # capsules' velocities are taken over this time [s]


class LimitReason(Enum):
    """What holds the arm back, as it is said of an arm that is slow, or stands."""

    NOTHING = "nothing"
    DOUBT = "nobody can say what the person will do"
    SEPARATION = "A person is too near to move."
    SILENCE = "The camera is silent: nobody knows who is there."
    UNSEEN = "Somebody is there whose arms were never seen."


HELD, SLOW, FULL = range(3)  # how fast it has been going for a while
BLIND = {LimitReason.SILENCE, LimitReason.UNSEEN}  # nobody knows where somebody is


class SpeedLimit(NamedTuple):
    """How fast the arm may go."""

    speed: float  # share of the planned speed, 0..1
    reason: LimitReason  # what holds the arm back most
    separation: Separation  # what the measured distance asks for at the present speed


def speed_limit(
    arm: UR5,
    people: PeopleModel,
    monitoring: SeparationOptions,
    q: Float[np.ndarray, "6"],
    velocities: tuple[Float[np.ndarray, "6"], Float[np.ndarray, "6"]],
    speed: float,
    now: float,
) -> SpeedLimit:
    """The least of what measurement and camera allow, and less than full speed where predictions are in doubt.

    Args:
        arm: its kinematics.
        people: what is known of them.
        monitoring: constants of speed and separation monitoring.
        q: (6,) where the arm is [rad].
        velocities: the present one, and that of the planned path [rad/s].
        speed: share of the planned speed it has now.
        now: [s].
    """
    seen = people.seen(now)
    present, full = (
        separation(moving(arm.capsules(np.stack([q, q + MOMENT * qd])), MOMENT), seen, monitoring) for qd in velocities
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
    least, reason = min(reversed(limits), key=lambda each: each[0])
    return SpeedLimit(least, reason, present)


class SpeedHysteresis:
    """Brakes at once and speeds up gently; says at once that it has to brake, the rest after a while."""

    def __init__(self) -> None:
        self.speed = 0.0
        self.level, self.reason = FULL, LimitReason.NOTHING
        self._now, self._since = 0.0, -float("inf")

    def begin(self) -> None:
        """On a new path, which begins gently by itself."""
        self.speed = 1.0
        self.level, self._since = FULL, self._now

    def update(self, limit: SpeedLimit, most: float, now: float) -> None:
        """Takes in what holds the arm back, and the share that it may go at for other reasons too [0..1]."""
        self.speed = min(most, self.speed + RISE * (now - self._now))
        self._now = now
        level = sum(limit.speed > share for share in (STILL, FREE))
        same = level == self.level and limit.reason is self.reason
        braked = level == HELD or (level == SLOW and self.level == FULL and limit.speed < BRAKED)
        blind = BLIND & {self.reason, limit.reason}
        if same or braked or blind or now - self._since >= SETTLE:
            self.level, self.reason, self._since = level, limit.reason, now
