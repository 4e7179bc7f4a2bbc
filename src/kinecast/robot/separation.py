"""Speed and separation monitoring, ISO/TS 15066:2016, 5.5.4, on measured positions.

    S_p = S_h + S_r + S_s + C + Z_d + Z_r

S_h = v_h (T_a + T_r + T_s) the person's way until the arm stands, S_r = v_r T_r the arm's way before it brakes,
S_s = v_r² / 2a while it brakes, T_s = v_r / a. v_h and v_r are the speeds of the nearest points towards one another;
part of the arm's speed across counts as v_r, since its way bends (docs/decisions/0021). For a distance d this is a
quadratic in v_r: its root is the speed the arm may have.
"""

from __future__ import annotations

import math
from typing import NamedTuple, no_type_check

import numpy as np
from jaxtyping import Float
from numba import njit

UNKNOWN = 1.6  # v_h of a person whose speed is not measured [m/s] (ISO 13855:2010, clause 5)
STANDS = 1e-6  # an arm slower than this stands [m/s]
OLDEST = 0.1  # a measurement older than this does not say how fast the person is [s]


class SeparationOptions(NamedTuple):
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

    @property
    def constant(self) -> float:
        """C + Z_d + Z_r [m]."""
        return self.intrusion + self.person_error + self.robot_error


class Separation(NamedTuple):
    """What the distance between arm and persons allows."""

    distance: float = math.inf  # least between them [m]; inf without a person
    required: float = 0.0  # S_p at the present speed of the pair of capsules with the least margin [m]
    margin: float = math.inf  # least d − S_p over all pairs [m]
    scale: float = 1.0  # share of the present speed at which every d ≥ S_p; 1 where it may go on or draws back


class Moving(NamedTuple):
    """Capsules that move."""

    capsules: Float[np.ndarray, "K 7"]  # start, end and radius [m]; NaN, and left out, where nobody knows
    velocity: Float[np.ndarray, "K 6"]  # of both ends [m/s]; NaN where not known
    age: Float[np.ndarray, " K"]  # of the measurements behind them [s]


def moving(capsules: Float[np.ndarray, "2 K 7"], seconds: float) -> Moving:
    """The first of two sets of capsules, as fast as it becomes the second in so long [s]."""
    return Moving(capsules[0], (capsules[1] - capsules[0])[:, :6] / seconds, np.zeros(capsules.shape[1]))


def separation(arm: Moving, people: Moving, options: SeparationOptions) -> Separation:
    """Compares every capsule of the arm with every capsule of the persons."""
    return Separation(*map(float, compare(arm, people, options, 0.0, False)))


@njit(cache=True)
@no_type_check
def closest_points(a: np.ndarray, b: np.ndarray) -> tuple[float, float]:
    """Where along two segments (start and end of each) their nearest points lie, 0..1 each.

    C. Ericson, Real-Time Collision Detection, 5.1.9.
    """
    aa = bb = ab = ar = br = 0.0
    for k in range(3):
        u, v, r = a[3 + k] - a[k], b[3 + k] - b[k], a[k] - b[k]
        aa, bb, ab = aa + u * u, bb + v * v, ab + u * v
        ar, br = ar + u * r, br + v * r
    cross = aa * bb - ab * ab
    s = min(max((ab * br - ar * bb) / cross, 0.0), 1.0) if cross > 1e-12 else 0.0
    t = min(max((ab * s + br) / bb, 0.0), 1.0) if bb > 1e-12 else 0.0
    s = min(max((ab * t - ar) / aa, 0.0), 1.0) if aa > 1e-12 else 0.0
    return s, t


@njit(cache=True)
@no_type_check
def compare(arm, people, o, noise, scale_only):
    """The fields of a `Separation`, where a noise [m/s] adds to the speed that people seem to come with.

    Pairs that surely change nothing are passed over: of the scale, where that alone is wanted.
    """
    distance = margin = 0.0 if scale_only else np.inf
    needed, scale = 0.0, 1.0
    links, limbs = _bounds(arm), _bounds(people)
    for i in range(len(links)):
        fastest = links[i, 4] * math.sqrt(1.0 + o.across * o.across)
        if scale_only and fastest <= STANDS:
            continue
        for j in range(len(limbs)):
            age = people.age[j]
            known = age <= OLDEST and not math.isnan(limbs[j, 4])
            coming = max(limbs[j, 4] + noise, o.least_speed) if known else UNKNOWN
            squared = 0.0
            for k in range(3):
                squared += (links[i, k] - limbs[j, k]) ** 2
            least = math.sqrt(squared) - links[i, 3] - limbs[j, 3]
            if least >= distance and least - _required(fastest, coming, age, o) >= max(margin, 0.0):
                continue
            apart, robot, human = _approach(arm, i, people, j, o.across)
            if math.isnan(apart):
                continue
            human = max(human + noise if known else UNKNOWN, o.least_speed)
            asked = _required(robot, human, age, o)
            distance = min(distance, apart)
            if apart - asked < margin:
                margin, needed = apart - asked, asked
            if robot > STANDS and apart < asked:
                # The greatest v_r whose S_r + S_s and v_h T_s fit into the room left: the quadratic's root.
                half, room = o.braking * o.reaction + human, apart - _required(0.0, human, age, o)
                root = math.sqrt(half * half + 2.0 * o.braking * max(room, 0.0)) - half
                scale = min(scale, root / robot)
    return distance, needed, margin, scale


@njit(cache=True)
@no_type_check
def _required(robot, human, age, o):
    """S_p [m]."""
    return (
        o.intrusion + o.person_error + o.robot_error
        + human * (age + o.reaction + robot / o.braking)
        + robot * (o.reaction + robot / (2.0 * o.braking))
    )  # fmt: skip


@njit(cache=True)
@no_type_check
def _bounds(these):
    """(K, 5) middle (3) and radius [m] of a ball around each capsule, and the speed of its faster end [m/s]."""
    out = np.empty((len(these.capsules), 5))
    for i in range(len(out)):
        length = start = end = 0.0
        for k in range(3):
            a, b = these.capsules[i, k], these.capsules[i, 3 + k]
            out[i, k] = 0.5 * (a + b)
            length += (b - a) ** 2
            start += these.velocity[i, k] ** 2
            end += these.velocity[i, 3 + k] ** 2
        out[i, 3] = 0.5 * math.sqrt(length) + these.capsules[i, 6]
        out[i, 4] = math.sqrt(max(start, end)) if start + end >= 0.0 else math.nan
    return out


@njit(cache=True)
@no_type_check
def _approach(arm, i, people, j, across):
    """Distance of two capsules [m], and the speeds of their nearest points towards one another [m/s]."""
    a, b, va, vb = arm.capsules[i], people.capsules[j], arm.velocity[i], people.velocity[j]
    s, t = closest_points(a, b)
    squared = robot = human = speed = 0.0
    for k in range(3):
        gap = b[k] + t * (b[3 + k] - b[k]) - (a[k] + s * (a[3 + k] - a[k]))
        velocity = (1.0 - s) * va[k] + s * va[3 + k]
        squared += gap * gap
        speed += velocity * velocity
        robot += gap * velocity
        human -= gap * ((1.0 - t) * vb[k] + t * vb[3 + k])
    way = math.sqrt(squared)
    robot /= max(way, 1e-9)
    robot += across * math.sqrt(max(speed - robot * robot, 0.0))
    return way - a[6] - b[6], max(robot, 0.0), human / max(way, 1e-9)
