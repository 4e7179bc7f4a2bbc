"""Speed and separation monitoring, ISO/TS 15066:2016, 5.5.4, on measured positions.

    S_p = S_h + S_r + S_s + C + Z_d + Z_r

S_h = v_h (T_a + T_r + T_s) the person's way until the arm stands, S_r = v_r T_r the arm's way before it brakes,
S_s = v_r² / 2a while it brakes, T_s = v_r / a. v_h and v_r are the speeds of the nearest points towards one another;
part of the arm's speed across counts as v_r, since its way bends (docs/decisions/0021). For a distance d this is a
quadratic in v_r: its root is the speed the arm may have.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import no_type_check

import numpy as np
from jaxtyping import Float
from numba import njit

from kinecast.errors import OptionError
from kinecast.robot.capsules import Capsules

__all__ = ["Moving", "Separation", "SeparationOptions", "allowed_speed", "closest_points", "moving", "separation"]

UNKNOWN = 1.6
"""v_h of a person whose speed is not measured [m/s] (ISO 13855:2010, clause 5)."""
OLDEST = 0.1
"""A measurement older than this does not say how fast the person is [s]."""

Rows = Float[np.ndarray, "_ 3"]
Moving = tuple[Rows, Rows, Float[np.ndarray, " _"], Rows, Rows]
"""K capsules: start and end (K, 3) [m], radius (K,) [m], velocities of start and end (K, 3) [m/s]."""


@dataclass(frozen=True)
class SeparationOptions:
    """The terms of S_p.

    Attributes:
        reaction: T_r, from a measurement's arrival to the first braking [s]: two control cycles and the bus.
        braking: a, at which the nearest point of the arm surely slows down [m/s²].
        least_speed: v_h is never below this [m/s]: who stands still may start.
        intrusion: C [m]. 0, since hands are capsules that reach over the fingertips.
        person_error: Z_d, of a measured joint [m].
        robot_error: Z_r [m]. UR5: repeatability 0.1 mm; its calibration to the camera counts.
        across: share of the arm's speed across the line between the nearest points that counts as towards the person.
    """

    reaction: float = 0.03
    braking: float = 2.5
    least_speed: float = 0.15
    intrusion: float = 0.0
    person_error: float = 0.02
    robot_error: float = 0.005
    across: float = 0.3

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            least = 1e-6 if name in ("reaction", "braking") else 0.0
            if not value >= least:
                raise OptionError(f"{name} {value} must be {least:g} or more")

    @property
    def constant(self) -> float:
        """C + Z_d + Z_r [m]."""
        return self.intrusion + self.person_error + self.robot_error


@dataclass(frozen=True)
class Separation:
    """What the distance between arm and persons allows.

    Attributes:
        distance: least distance between them [m]; inf without a person.
        required: S_p at the present speed of the pair of capsules with the least margin [m].
        margin: least d − S_p over all pairs [m].
        scale: share of the present speed at which d ≥ S_p for every pair, 0..1; 1 where it may go on or draws back.
    """

    distance: float = math.inf
    required: float = 0.0
    margin: float = math.inf
    scale: float = 1.0


def moving(capsules: Capsules, seconds: float) -> Moving:
    """The first of two sets of capsules (2, K), as fast as it becomes the second in so long [s]."""
    (start, later), (end, end_later) = capsules.start, capsules.end
    return start, end, capsules.radius, (later - start) / seconds, (end_later - end) / seconds


def separation(
    arm: Moving,
    person: Moving,
    options: SeparationOptions,
    age: Float[np.ndarray, " K"] | None = None,
    person_now: tuple[Rows, Rows] | None = None,
) -> Separation:
    """Compares every capsule of the arm with every capsule of the persons.

    Args:
        arm: its capsules.
        person: those of all persons; one that is NaN is left out: nobody knows where it is. A velocity that is NaN is
            not known.
        options: see SeparationOptions.
        age: (K,) of the measurements [s]; 0 by default.
        person_now: other estimates of the velocities: the one that is faster towards the arm counts; NaN where there is
            none.
    """
    o = options
    age = np.zeros(len(person[2])) if age is None else age
    constants = o.reaction, o.braking, o.least_speed, o.constant, o.across
    return Separation(*map(float, _separation(*arm, *person, *(person_now or person[3:]), age, *constants)))


@njit(cache=True)
@no_type_check
def closest_points(a0: np.ndarray, a1: np.ndarray, b0: np.ndarray, b1: np.ndarray) -> tuple[float, float]:
    """Where along two segments their nearest points lie, 0..1 each (Ericson, Real-Time Collision Detection, 5.1.9)."""
    aa = bb = ab = ar = br = 0.0
    for k in range(3):
        u, v, r = a1[k] - a0[k], b1[k] - b0[k], a0[k] - b0[k]
        aa, bb, ab = aa + u * u, bb + v * v, ab + u * v
        ar, br = ar + u * r, br + v * r
    cross = aa * bb - ab * ab
    s = min(max((ab * br - ar * bb) / cross, 0.0), 1.0) if cross > 1e-12 else 0.0
    t = min(max((ab * s + br) / bb, 0.0), 1.0) if bb > 1e-12 else 0.0
    s = min(max((ab * t - ar) / aa, 0.0), 1.0) if aa > 1e-12 else 0.0
    return s, t


@njit(cache=True)
@no_type_check
def allowed_speed(room: float, human: float, reaction: float, braking: float) -> float:
    """Greatest v_r [m/s] whose S_r + S_s and v_h T_s fit into the room left [m]: the quadratic's root."""
    half = braking * reaction + human
    square = half * half + 2.0 * braking * room
    return math.sqrt(square) - half if room > 0.0 else 0.0


@njit(cache=True)
@no_type_check
def _separation(
    a0, a1, ar, va0, va1, b0, b1, br, vb0, vb1, wb0, wb1, age, reaction, braking, least, constant, across,
):  # fmt: skip
    nearest, worst, required, scale = np.inf, np.inf, 0.0, 1.0
    for i in range(len(ar)):
        for j in range(len(br)):
            s, t = closest_points(a0[i], a1[i], b0[j], b1[j])
            gap, way = np.zeros(3), 0.0
            for k in range(3):
                gap[k] = (b0[j, k] + t * (b1[j, k] - b0[j, k])) - (a0[i, k] + s * (a1[i, k] - a0[i, k]))
                way += gap[k] * gap[k]
            way = math.sqrt(way)
            if not way >= 0.0:  # NaN
                continue
            distance = way - ar[i] - br[j]
            robot = human = gaining = speed = 0.0
            for k in range(3):
                direction = gap[k] / max(way, 1e-9)
                robot += direction * ((1 - s) * va0[i, k] + s * va1[i, k])
                speed += ((1 - s) * va0[i, k] + s * va1[i, k]) ** 2
                human -= direction * ((1 - t) * vb0[j, k] + t * vb1[j, k])
                gaining -= direction * ((1 - t) * wb0[j, k] + t * wb1[j, k])
            if not abs(human) < np.inf or age[j] > OLDEST:
                human = UNKNOWN
            elif gaining > human:
                human = gaining
            robot += across * math.sqrt(max(speed - robot * robot, 0.0))
            human, robot = max(human, least), max(robot, 0.0)
            fixed = constant + human * (age[j] + reaction)
            needed = fixed + human * robot / braking + robot * reaction + robot * robot / (2 * braking)
            nearest = min(nearest, distance)
            if distance - needed < worst:
                worst, required = distance - needed, needed
            if robot > 1e-6 and distance < needed:
                scale = min(scale, allowed_speed(distance - fixed, human, reaction, braking) / robot)
    return nearest, required, worst, scale
