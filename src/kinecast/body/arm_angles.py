"""The four angles of one arm in closed form: scalar kernels shared by the posture and the inverse kinematics.

Vectors are tuples of floats in the torso frame (x forward, y to the left, z up); side is +1 left, −1 right.

| angle | positive is | zero is |
|---|---|---|
| theta1 flexion | forward and up | upper arm in the plane of the shoulders |
| theta2 abduction | sideways, away from the body | upper arm in the plane of forward and up |
| theta3 axial rotation | external: a bent forearm turns outward | a bent forearm points along flexion |
| theta4 elbow flexion | bent | straight |

Two sets of angles describe the same arm: (θ1, θ2, θ3, θ4) and (θ1 + π, π − θ2, θ3 + π, θ4), its two branches.
"""

from __future__ import annotations

import math
from typing import TypeAlias, no_type_check

from numba import njit

from kinecast.body.elementary import sine_cosine

__all__ = [
    "COINCIDENT",
    "LEFT",
    "OUTSIDE_WEIGHT",
    "RIGHT",
    "USUAL_RANGE",
    "Angles",
    "Vector",
    "arm_angles",
    "arm_vectors",
    "nearest_turn",
]

Vector: TypeAlias = tuple[float, float, float]
Angles: TypeAlias = tuple[float, float, float, float]

LEFT = 1.0
RIGHT = -1.0

TURN = 2.0 * math.pi
PER_TURN = 1.0 / TURN

# Normal motion after the American Academy of Orthopaedic Surgeons, "Joint Motion: Method of Measuring and
# Recording" (1965): flexion 180, extension 60; abduction 180; external rotation 90, internal 70; elbow 150.
# Wider are adduction, which goes across the body, and internal rotation, which real work takes to 88.
USUAL_RANGE = (
    (math.radians(-60.0), math.radians(180.0)),
    (math.radians(-50.0), math.radians(180.0)),
    (math.radians(-100.0), math.radians(90.0)),
    (math.radians(0.0), math.radians(150.0)),
)
"""Lower and upper end of each angle [rad]: branches are judged by it, and the default limits are these."""

REST = (0.0, 0.0, 0.0, 0.5 * math.pi)
"""Stands for the previous angles where there are none: arm hanging, elbow bent at a right angle."""

OUTSIDE_WEIGHT = 16.0
"""A branch 45° (π/4) outside loses against one inside that lies half a turn (π) away: 16 (π/4)² = π²."""

FAR = math.radians(195.0)
"""Whole turns are given up this far from the middle of the range: half a turn, and 15° against chatter."""

UNDEFINED = 1e-13
"""Sine below which a direction is round-off: the angle about it is undefined and keeps its previous value."""

COINCIDENT = 1e-140
"""Points nearer than this [m] are one: squares of what is UNDEFINED times smaller still have all their digits."""


@njit(cache=True)
@no_type_check
def nearest_turn(angle: float, target: float) -> float:
    """The angle [rad], moved by whole turns to within π of target."""
    return angle + TURN * math.floor((target - angle) * PER_TURN + 0.5)


@njit(cache=True, forceinline=True)
@no_type_check
def arm_vectors(theta: Angles, upper: float, fore: float, side: float) -> tuple[Vector, Vector]:
    """Forward kinematics: upper arm L1·u and forearm L2·(cos θ4 u + sin θ4 (cos θ3 e1 + sin θ3 e2)).

    Args:
        theta: the four angles [rad].
        upper: length of the upper arm, shoulder to elbow [m].
        fore: length of the forearm, elbow to wrist [m].
        side: +1 left, −1 right.

    Returns:
        Shoulder to elbow and elbow to wrist [m].
    """
    s1, c1 = sine_cosine(theta[0])
    s2, c2 = sine_cosine(theta[1])
    s3, c3 = sine_cosine(theta[2])
    s4, c4 = sine_cosine(theta[3])
    along, across = fore * c4, fore * s4
    ahead, outward = across * c3, across * s3
    ux, uy, uz = c2 * s1, side * s2, -c2 * c1
    fx = along * ux + ahead * c1 - outward * s2 * s1
    fy = along * uy + outward * side * c2
    fz = along * uz + ahead * s1 + outward * s2 * c1
    return (upper * ux, upper * uy, upper * uz), (fx, fy, fz)


@njit(cache=True)
@no_type_check
def _beyond(angle: float, usual: tuple[float, float]) -> float:
    """Squared distance [rad²] of an angle from its usual range."""
    distance = max(usual[0] - angle, angle - usual[1], 0.0)
    return distance * distance


@njit(cache=True)
@no_type_check
def _turned(angle: float, previous: float, usual: tuple[float, float], weight: float) -> float:
    """The angle by whole turns nearest to previous, or, with a weight, to the usual range when that is far from it."""
    middle = 0.5 * (usual[0] + usual[1])
    turned = nearest_turn(angle, previous)
    return turned if weight == 0.0 or math.fabs(turned - middle) <= FAR else nearest_turn(angle, middle)


@njit(cache=True, error_model="numpy")
@no_type_check
def arm_angles(u: Vector, f: Vector, side: float, previous: Angles, weight: float) -> Angles:
    """Inverse kinematics: of the two branches, the one nearest to the previous angles and to the usual range.

    It has the least squared distance in (θ1, θ2, θ4 cos θ3, θ4 sin θ3), which is smooth at a straight elbow,
    plus `weight` times the squared distance from the usual range. So continuous motion keeps its branch, but with
    `OUTSIDE_WEIGHT` a tracker that jumps across the shoulder cannot leave an arm on a branch no arm can be on. Whole
    turns are the nearest to the previous angles, until that is more than 195° from the middle of the usual range.
    With weight 0 the angles go on from the previous ones wherever those are: the angles of a motion that kept
    limits are then found again from its points, even where limits are wider than the usual range.

    An angle that is undefined keeps its previous value, 0 when there is none: θ3 at a straight elbow, θ1 with
    the arm straight out sideways. A forearm that is NaN gives NaN for θ3 and θ4 alone.

    Args:
        u: shoulder to elbow, of any length [m].
        f: elbow to wrist, of any length [m].
        side: +1 left, −1 right.
        previous: the angles one step earlier [rad]; NaN for none, an arm at rest then.
        weight: of the usual range, `OUTSIDE_WEIGHT` or 0.

    Returns:
        The four angles [rad]; θ4 lies in [0, π].
    """
    upper = math.sqrt(u[0] * u[0] + u[1] * u[1] + u[2] * u[2])
    if math.isnan(upper):
        return math.nan, math.nan, math.nan, math.nan
    p1, p2, p3, p4 = previous
    if math.isnan(p1 + p2):
        p1, p2 = REST[0], REST[1]
    if math.isnan(p3 + p4):
        p3, p4 = REST[2], REST[3]

    swing = math.sqrt(u[0] * u[0] + u[2] * u[2])
    s2, c2 = (side * u[1] / upper, swing / upper) if upper > COINCIDENT else (0.0, 1.0)
    theta2 = math.atan2(s2, c2)
    if upper > COINCIDENT and swing > UNDEFINED * upper:
        theta1 = math.atan2(u[0], -u[2])
        s1, c1 = u[0] / swing, -u[2] / swing
    else:
        theta1 = p1
        s1, c1 = math.sin(theta1), math.cos(theta1)

    flexed = f[0] * s1 - f[2] * c1
    along = c2 * flexed + s2 * side * f[1]
    ahead = f[0] * c1 + f[2] * s1
    outward = c2 * side * f[1] - s2 * flexed
    across = math.sqrt(ahead * ahead + outward * outward)
    theta4 = math.atan2(across, along)
    bent = across > UNDEFINED * math.fabs(along)
    theta3 = math.atan2(outward, ahead) if bent else p3

    here1 = _turned(theta1, p1, USUAL_RANGE[0], weight)
    here2 = _turned(theta2, p2, USUAL_RANGE[1], weight)
    here3 = _turned(theta3, p3, USUAL_RANGE[2], weight)
    there1 = _turned(theta1 + math.pi, p1, USUAL_RANGE[0], weight)
    there2 = _turned(math.pi - theta2, p2, USUAL_RANGE[1], weight)
    there3 = _turned(theta3 + math.pi, p3, USUAL_RANGE[2], weight) if bent else here3

    gain = (here1 - p1) ** 2 + (here2 - p2) ** 2 - (there1 - p1) ** 2 - (there2 - p2) ** 2
    gain += weight * (_beyond(here1, USUAL_RANGE[0]) + _beyond(here2, USUAL_RANGE[1]))
    gain -= weight * (_beyond(there1, USUAL_RANGE[0]) + _beyond(there2, USUAL_RANGE[1]))
    if bent:
        gain -= 4.0 * theta4 * p4 * math.cos(here3 - p3)
        rotated = _beyond(here3, USUAL_RANGE[2]) - _beyond(there3, USUAL_RANGE[2])
        gain += weight * theta4 * theta4 * rotated
    if math.isnan(across):
        here3, there3 = math.nan, math.nan
    if gain > 0.0:
        return there1, there2, there3, theta4
    return here1, here2, here3, theta4
