"""How fast the arm may go now, and what holds it back."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np
from jaxtyping import Float

from kinecast.errors import OptionError
from kinecast.robot.outlook import Outlook, Path
from kinecast.robot.separation import Separation, SeparationOptions, separation

__all__ = ["Pace", "PaceOptions", "Restraint", "allowed_pace"]


class Restraint(Enum):
    """What holds the arm back."""

    NOTHING = "nothing"
    DOUBT = "a person of whom nobody can say what they will do"
    SEPARATION = "the safety distance"
    SILENCE = "the camera"
    UNSEEN = "a person whose arms were never seen"


@dataclass(frozen=True)
class PaceOptions:
    """When the arm is held back.

    Attributes:
        silence: without a shot for this long, nobody knows who is there [s].
        doubt: share of the planned speed beside somebody whose prediction is not OK, or too old.
    """

    silence: float = 0.2
    doubt: float = 0.75

    def __post_init__(self) -> None:
        if not self.silence > 0:
            raise OptionError(f"silence {self.silence} s must be above 0")
        if not 0 <= self.doubt <= 1:
            raise OptionError(f"doubt {self.doubt} is outside 0..1")


@dataclass(frozen=True)
class Pace:
    """A speed and its reason.

    Attributes:
        speed: share of the planned speed, 0..1.
        restraint: what holds the arm back most.
        separation: what the measured distance asks for at the present speed.
    """

    speed: float
    restraint: Restraint
    separation: Separation


def allowed_pace(
    outlook: Outlook,
    q: Float[np.ndarray, "6"],
    qd: Float[np.ndarray, "6"],
    path: Path,
    speed: float,
    now: float,
    options: PaceOptions,
) -> Pace:
    """The least of what measurement and camera allow, and less than full speed where predictions are in doubt.

    Args:
        outlook: what is known of the people.
        q: (6,) where the arm is [rad]; qd: (6,) how fast [rad/s].
        path: where it will be at full speed.
        speed: share of the planned speed it has now.
        now: [s].
        options: see PaceOptions.
    """
    present, full = _separations(outlook, q, qd, path, now, outlook.cell.separation)
    # The arm may not yet move as its path says, or not as fast: both what it does and what it is about to do count.
    measured = min(full.scale, present.scale * speed if present.scale < 1.0 else 1.0)
    limits = [(measured, Restraint.SEPARATION)]
    if len(outlook.trusted(now)) < len(outlook.predictions):
        limits.insert(0, (options.doubt, Restraint.DOUBT))
    if now - outlook.basis > options.silence:
        limits.append((0.0, Restraint.SILENCE))
    if outlook.watch.unseen():
        limits.append((0.0, Restraint.UNSEEN))
    least = min(limit for limit, _ in limits)
    if least >= 1.0:
        return Pace(1.0, Restraint.NOTHING, present)
    cause = [restraint for limit, restraint in limits if limit <= least][-1]
    return Pace(least, cause, present)


def _separations(
    outlook: Outlook,
    q: Float[np.ndarray, "6"],
    qd: Float[np.ndarray, "6"],
    path: Path,
    now: float,
    options: SeparationOptions,
) -> tuple[Separation, Separation]:
    """At the present velocity, and at the path's own."""
    moment = 1e-3
    here, soon = path(np.array([0.0, moment]))
    capsules = outlook.arm.capsules(np.stack([q, q + moment * qd, q + (soon - here)]))
    arm = capsules.start[0], capsules.end[0], capsules.radius
    seen = outlook.watch.seen(now)
    person = seen.capsules.start, seen.capsules.end, seen.capsules.radius
    results = []
    for k in (1, 2):
        velocity = (capsules.start[k] - arm[0]) / moment, (capsules.end[k] - arm[1]) / moment
        results.append(
            separation(
                arm, velocity, person, (seen.start_velocity, seen.end_velocity), seen.age, options,
                (seen.start_velocity_now, seen.end_velocity_now),
            )
        )  # fmt: skip
    return results[0], results[1]
