"""Limits of the arm: the range of each angle, its speed, and the bounds of one step (Eq. 4).

The range is static; the bounds are what a step can reach inside it. Signs are those of
kinecast.body.posture, so both sides share one set of numbers.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from typing import TypeAlias, no_type_check

import numpy as np
from jaxtyping import Bool, Float
from numba import njit

from kinecast.body.posture import ANGLES, LEFT_ARM, RIGHT_ARM, USUAL_RANGE, Angles
from kinecast.errors import OptionError

Posture: TypeAlias = Float[np.ndarray, "18"]

TOLERANCE = 1e-9
"""An angle this far [rad] outside its limit still counts as inside: round-off of FK and IK."""

STRAIGHT = math.radians(2.0)
"""θ4 below which, or as near to π, axial rotation says nothing and is not checked [rad]."""

HELD = 0.998
"""Share of each side's training angles that widened ranges hold (docs/decisions/0004)."""


@dataclass(frozen=True)
class AngleLimit:
    """Range [rad] and greatest speed either way [rad/s], which may be infinite, of one angle."""

    lower: float
    upper: float
    speed: float


@dataclass(frozen=True)
class JointLimits:
    """Limits of one arm, the same for both sides; hard, and all of them options.

    Attributes:
        flexion, abduction, axial_rotation, elbow: θ1 to θ4, with the signs of kinecast.body.posture.
        pronation: θ5, positive turns the palm down, negative (supination) up; zero is the thumb up.
        wrist_flexion: θ6, positive towards the palm.
        wrist_deviation: θ7, positive ulnar (away from the thumb), negative radial.
        wrist_speed: greatest speed of the wrist relative to the torso [m/s], carried to the angles through
            the Jacobian; None for no such limit.

    Raises:
        OptionError: a range that is empty or beyond ±2π, or a speed that is not positive.
    """

    # Speeds of shoulder and elbow: a ceiling above real work, where the elbow's 99th percentile is 5.6 rad/s,
    # its 99.9th 11.0 rad/s (recordings of assembly). Forearm and wrist carry only the hand. Ranges of these are of
    # AAOS (1965), as the shoulder's: pronation and supination 80; wrist flexion 80, extension 70; deviation 30, 20.
    flexion: AngleLimit = AngleLimit(*USUAL_RANGE[0], speed=12.0)
    abduction: AngleLimit = AngleLimit(*USUAL_RANGE[1], speed=12.0)
    axial_rotation: AngleLimit = AngleLimit(*USUAL_RANGE[2], speed=12.0)
    elbow: AngleLimit = AngleLimit(*USUAL_RANGE[3], speed=12.0)
    pronation: AngleLimit = AngleLimit(math.radians(-80.0), math.radians(80.0), speed=20.0)
    wrist_flexion: AngleLimit = AngleLimit(math.radians(-70.0), math.radians(80.0), speed=20.0)
    wrist_deviation: AngleLimit = AngleLimit(math.radians(-20.0), math.radians(30.0), speed=20.0)
    wrist_speed: float | None = None

    def __post_init__(self) -> None:
        for name, limit in self._named_angles():
            if not -2.0 * math.pi <= limit.lower < limit.upper <= 2.0 * math.pi:
                raise OptionError(
                    f"limits.{name}: range [{limit.lower}, {limit.upper}] rad; lower must be below upper, "
                    "both within [-2π, 2π]"
                )
            if not limit.speed > 0.0:
                raise OptionError(f"limits.{name}: speed {limit.speed} rad/s is outside (0, ∞]")
        if self.wrist_speed is not None and not self.wrist_speed > 0.0:
            raise OptionError(f"limits.wrist_speed: {self.wrist_speed} m/s is outside (0, ∞]")

    def widened(self, postures: Float[np.ndarray, "N 18"]) -> JointLimits:
        """Limits whose ranges also hold nearly all postures (N, 18) seen, never narrower than before; speeds stay.

        For markers that are not at the joints: their angles are offset, and an honest range is offset too. NaN is left
        out.
        """
        wider: dict[str, AngleLimit] = {}
        for i, (name, limit) in enumerate(self._named_angles()[:4]):
            lower, upper = limit.lower, limit.upper
            for arm in (LEFT_ARM, RIGHT_ARM):
                angles = postures[:, arm]
                told = np.isfinite(angles).all(axis=-1)
                if i == 2:
                    told &= (angles[:, 3] > STRAIGHT) & (angles[:, 3] < math.pi - STRAIGHT)
                if told.any():
                    ends = np.quantile(angles[told, i], [0.5 * (1.0 - HELD), 0.5 * (1.0 + HELD)])
                    lower, upper = min(lower, float(ends[0])), max(upper, float(ends[1]))
            wider[name] = AngleLimit(max(lower, -2.0 * math.pi), min(upper, 2.0 * math.pi), limit.speed)
        return replace(self, **wider)  # type: ignore[arg-type]

    def union(self, other: JointLimits) -> JointLimits:
        """The least limits that both keep."""
        pairs = zip(self._named_angles(), other._named_angles(), strict=True)
        wider = {
            name: AngleLimit(min(a.lower, b.lower), max(a.upper, b.upper), max(a.speed, b.speed))
            for (name, a), (_, b) in pairs
        }
        told = [limits.wrist_speed for limits in (self, other) if limits.wrist_speed is not None]
        return replace(self, wrist_speed=max(told) if len(told) == 2 else None, **wider)

    def _named_angles(self) -> list[tuple[str, AngleLimit]]:
        return [(f.name, getattr(self, f.name)) for f in fields(self) if f.name != "wrist_speed"]

    def of_posture(self) -> tuple[Posture, Posture, Posture]:
        """(18,) lower [rad], upper [rad], speed [rad/s] of a posture; infinite for all but the arm angles."""
        lower, upper, speed = np.repeat([[-np.inf], [np.inf], [np.inf]], 18, axis=1)
        for k, limit in enumerate((self.flexion, self.abduction, self.axial_rotation, self.elbow)):
            for ends, value in ((lower, limit.lower), (upper, limit.upper), (speed, limit.speed)):
                ends[[6 + k, 12 + k]] = value
        return lower, upper, speed


def posture_bounds(limits: JointLimits | None) -> tuple[Posture, Posture, Posture, float]:
    """Lower, upper [rad], speed [rad/s] of a posture and the wrist's speed [m/s]; infinite without limits."""
    if limits is None:
        return np.full(18, -np.inf), np.full(18, np.inf), np.full(18, np.inf), np.inf
    return *limits.of_posture(), np.inf if limits.wrist_speed is None else limits.wrist_speed


@njit(cache=True)
@no_type_check
def bounds(lower: float, upper: float, speed: float, previous: float, dt: float) -> tuple[float, float]:
    """Eq. 4: lb = max(lower, θ − speed·dt), ub = min(upper, θ + speed·dt) (kernel).

    From an angle too far outside its range to be back in one step, both bounds are the nearest reachable
    value: full speed towards the range. They are never empty; without a previous angle (NaN) they are the range.

    Takes the range [rad], the greatest speed [rad/s], the angle θ one step earlier [rad] and the step dt [s]; returns
    lb ≤ ub [rad], both within speed·dt of the previous angle.
    """
    if math.isnan(previous):
        return lower, upper
    least, most = previous - speed * dt, previous + speed * dt
    lower = least if lower < least else most if lower > most else lower
    upper = least if upper < least else most if upper > most else upper
    return lower, upper


@njit(cache=True)
@no_type_check
def wrist_levers(theta: Angles, upper: float, fore: float) -> Angles:
    """|∂wrist/∂θ_i| of four angles [rad] and two lengths [m], relative to the torso [m] (kernel)."""
    s2, c2 = math.sin(theta[1]), math.cos(theta[1])
    across, along = fore * math.sin(theta[3]), upper + fore * math.cos(theta[3])
    ahead, outward = across * math.cos(theta[2]), across * math.sin(theta[2])
    swing = c2 * along - s2 * outward
    return math.hypot(ahead, swing), math.hypot(along, outward), math.fabs(across), fore


@njit(cache=True)
@no_type_check
def speeds_within_wrist_speed(posture: np.ndarray, speed: np.ndarray, wrist_speed: float, out: np.ndarray) -> None:
    """Speeds that also hold the wrist's: min(speed_i, v / |∂wrist/∂θ_i|), each angle alone (kernel).

    Takes the posture (18,) the step starts from, the greatest speeds (18,) [rad/s] and that of a wrist relative to the
    torso, v [m/s]; infinite for none. `out` (18,) receives the speeds [rad/s].
    """
    out[:] = speed
    if math.isinf(wrist_speed):
        return
    for at in (6, 12):
        theta = (posture[at], posture[at + 1], posture[at + 2], posture[at + 3])
        lever = wrist_levers(theta, posture[at + 4], posture[at + 5])
        for i in range(4):
            if lever[i] * speed[at + i] > wrist_speed:
                out[at + i] = wrist_speed / lever[i]


def violations(
    postures: Float[np.ndarray, "*batch T 18"], initial: Float[np.ndarray, " 18"], dt: float, limits: JointLimits
) -> tuple[Bool[np.ndarray, "*batch T"], Bool[np.ndarray, "*batch T"]]:
    """Which steps (…, T) leave the range of an arm angle, and which move one faster than its speed.

    Takes postures (…, T, 18), dt [s] apart, and the posture (18,) dt before the first one; NaN for none. Both count
    only by more than 1e-9 rad, and NaN violates nothing. Axial rotation is not checked where the elbow is within 2° of
    straight. A series that starts outside the range (`initial`) is excused as far as Eq. 4's closed bounds excuse it:
    it must come back at full speed. Angles are taken as they are, on the branch and turn given.
    """
    lower, upper, speed, wrist_speed = posture_bounds(limits)
    before = np.concatenate([np.broadcast_to(initial, postures[..., :1, :].shape), postures[..., :-1, :]], axis=-2)
    speeds = np.broadcast_to(speed, before.shape)
    if wrist_speed < np.inf:
        speeds = speeds.copy()
        for i in np.ndindex(before.shape[:-1]):
            speeds_within_wrist_speed(before[i], speed, wrist_speed, speeds[i])
    arms = list(ANGLES)
    now, last, lower, upper, start = (x[..., arms] for x in (postures, before, lower, upper, initial))
    reach = speeds[..., arms] * dt
    # A start outside the range widens it, and the excuse closes at full speed.
    widened = np.cumsum(reach, axis=-2)
    low, high = np.minimum(lower, np.fmin(start, lower) + widened), np.maximum(upper, np.fmax(start, upper) - widened)
    outside = (now < low - TOLERANCE) | (now > high + TOLERANCE)
    fast = np.abs(now - last) > reach + TOLERANCE
    for axial, elbow in ((2, 3), (6, 7)):
        bent = (now[..., elbow] > STRAIGHT) & (now[..., elbow] < math.pi - STRAIGHT)
        was_bent = (last[..., elbow] > STRAIGHT) & (last[..., elbow] < math.pi - STRAIGHT)
        outside[..., axial] &= bent
        fast[..., axial] &= bent & was_bent
    return outside.any(axis=-1), fast.any(axis=-1)
