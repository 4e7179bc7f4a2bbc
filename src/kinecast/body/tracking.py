"""Tracked points: what a tracker repeated, lost or threw aside, and how it is made whole.

With hindsight (`fill`) both sides of a flaw are known. In the window an online predictor sees
(`repair_window`) the newest values may only be carried on. No value without a flaw is ever changed.
"""

from __future__ import annotations

import math
from dataclasses import astuple, dataclass
from enum import IntEnum, IntFlag
from typing import NamedTuple, no_type_check

import numpy as np
from jaxtyping import Bool, Float, Int8, UInt8
from numba import njit

from kinecast.errors import OptionError

# Measured by hiding known values of HA4M V001, LEGO Human2 and Vicon PickPlaceCloseHuman:
# gaps follow a cubic whose end velocities are half chord, half slope over 0.1 s. As good as a straight
# line at 30 Hz (13.1 against 13.5 mm over 0.2 s), twice as good at 100 Hz (3.8 against 8.1 mm).
SLOPE_TIME = 0.1
SLOPE_SHARE = 0.5
# The last velocity is carried on for this long [s]: 23.4 mm off after 0.1 s on HA4M, 6.1 on LEGO, 27.7 on
# Vicon; holding still is 25.7, 5.2 and 43.3 mm off.
CARRY_ON = 0.05
# A joint that has been elsewhere for longer than this really is there [s]. Two frames at 30 Hz leave less
# error than one or three.
TRUST_AFTER = 0.05
ROUNDING = 1e-6
"""Stamps differ by this [s] when they are meant to be as far apart as a limit."""


class Flaw(IntEnum):
    """What is wrong with one tracked value."""

    NONE = 0
    REPEATED = 1
    """The whole frame is an exact copy of the one before it."""
    MISSING = 2
    JUMP = 3
    """Away in one step and back in another, both sharper than a body can move."""


NONE, REPEATED, MISSING, JUMP = map(int, Flaw)


class Trouble(IntFlag):
    """What one joint of a window suffers from; flags add up."""

    REPEATED = 1
    """The newest frame is a copy of the one before it."""
    GAP = 2
    """A value before the newest was missing and has been filled."""
    OCCLUDED = 4
    """The newest frame does not show the joint: it has been carried on."""
    JUMP = 8
    """A value was thrown aside and has been replaced."""
    LOST = 16
    """Missing in the two newest frames or flawed in more than half of them: better not predicted from."""


@dataclass(frozen=True)
class TrackingLimits:
    """What separates a person's motion from a tracker's slip.

    Attributes:
        max_speed: no joint moves faster [m/s]. 8 finds the newest jump best on the HA4M and LEGO recordings.
        max_acceleration: no joint changes its velocity faster over a whole frame [m/s^2]. Twice that of a
            hand shaken 5 times a second by 5 cm.
        min_jump: smaller departures are noise, never a jump [m].
        longest_jump: a joint that stays away longer has moved, or its tracker has found it again [s]. The
            longest slip of the HA4M clips takes 0.37 s.

    Raises:
        OptionError: a value that is not positive.
    """

    max_speed: float = 8.0
    max_acceleration: float = 100.0
    min_jump: float = 0.03
    longest_jump: float = 0.4

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not value > 0:
                raise OptionError(f"tracking limit {name} = {value} must be above 0")


LIMITS = TrackingLimits()


class WindowRepair(NamedTuple):
    """Windows made whole, and how."""

    positions: Float[np.ndarray, "*w N J 3"]
    """[m]; NaN only in joints a whole window never saw."""
    touched: Bool[np.ndarray, "*w N J"]
    """True where a value is not the measured one."""
    trouble: UInt8[np.ndarray, "*w J"]
    """`Trouble` flags."""


def find_flaws(
    positions: Float[np.ndarray, "*w N J 3"], stamps: Float[np.ndarray, "*w N"], limits: TrackingLimits = LIMITS
) -> Int8[np.ndarray, "*w N J"]:
    """The `Flaw` of each value of a recording, or of each of many windows seen on its own.

    A jump leaves with a jolt and returns with an opposite one within `limits.longest_jump`. A jolt is a step
    faster than max_speed, or one that differs from the step before and from the step after by more than
    min_jump + max_acceleration · dt². A joint that does not return has moved, and has no flaw.

    Args:
        positions: (…, N, J, 3) [m], NaN where missing.
        stamps: (…, N) [s], increasing.
        limits: what counts as a jump.

    Returns:
        (…, N, J) values of `Flaw`.
    """
    missing = np.isnan(positions)
    equal = positions[..., 1:, :, :] == positions[..., :-1, :, :]
    same = (equal | (missing[..., 1:, :, :] & missing[..., :-1, :, :])).all(axis=(-2, -1))
    flaws = np.zeros(positions.shape[:-1], dtype=np.int8)
    flaws[..., 1:, :][same & equal.any(axis=(-2, -1))] = REPEATED
    flaws[~np.isfinite(positions).all(axis=-1)] = MISSING
    windows, shape = math.prod(positions.shape[:-3]), positions.shape[-3:]
    _find_jumps(
        np.ascontiguousarray(positions).reshape(windows, *shape),
        np.ascontiguousarray(stamps).reshape(windows, shape[0]),
        astuple(limits),
        flaws.reshape(windows, *shape[:2]),
    )
    return flaws


def fill(
    positions: Float[np.ndarray, "N J 3"],
    stamps: Float[np.ndarray, " N"],
    flaws: Int8[np.ndarray, "N J"],
    max_gap: float,
) -> tuple[Float[np.ndarray, "N J 3"], Bool[np.ndarray, "N J"]]:
    """Flawed values interpolated between the sound ones on both sides, where these are close enough.

    Args:
        positions: (N, J, 3) [m].
        stamps: (N,) [s], increasing.
        flaws: (N, J) from `find_flaws`.
        max_gap: longest time from the first flawed value to the next sound one [s].

    Returns:
        (N, J, 3) positions, where gaps too long or at an end hold NaN for missing values and jumps and what
        was recorded for repeats; and (N, J) True where a value was interpolated.
    """
    filled = np.array(positions, order="C")
    touched = np.zeros(flaws.shape, dtype=np.bool_)
    for j in range(flaws.shape[1]):
        _fill(filled[:, j], stamps, flaws[:, j], max_gap, touched[:, j])
    return filled, touched


def repair_window(
    positions: Float[np.ndarray, "N J 3"], stamps: Float[np.ndarray, " N"], limits: TrackingLimits = LIMITS
) -> WindowRepair:
    """One window repaired from nothing but itself, as it must be online.

    Flaws inside are filled from both sides. At the end, a missing or repeated value is carried on at the last
    velocity, which fades out; the newest values are taken for a jump, and carried on likewise, where they
    leave that way faster than `limits.max_speed`. Values before the first sound one are held.

    Args:
        positions: (N, J, 3) the window [m], oldest first, NaN where missing.
        stamps: (N,) [s], increasing.
        limits: what counts as a jump.
    """
    repair = repair_windows(positions[None], stamps[None], limits)
    return WindowRepair(repair.positions[0], repair.touched[0], repair.trouble[0])


def repair_windows(
    positions: Float[np.ndarray, "W N J 3"], stamps: Float[np.ndarray, "W N"], limits: TrackingLimits = LIMITS
) -> WindowRepair:
    """`repair_window` for many windows, each from nothing but itself."""
    repaired = np.array(positions, order="C")
    flaws = find_flaws(repaired, stamps, limits)
    touched = np.zeros(flaws.shape, dtype=np.bool_)
    _repair(repaired, np.ascontiguousarray(stamps), limits.max_speed, flaws, touched)
    return WindowRepair(repaired, touched, _trouble(flaws))


def _trouble(flaws: Int8[np.ndarray, "W N J"]) -> UInt8[np.ndarray, "W J"]:
    missing, jumped = flaws == MISSING, flaws == JUMP
    found = {
        Trouble.REPEATED: flaws[:, -1] == REPEATED,
        Trouble.GAP: missing[:, :-1].any(axis=1),
        Trouble.OCCLUDED: missing[:, -1],
        Trouble.JUMP: jumped.any(axis=1),
        Trouble.LOST: missing[:, -2:].all(axis=1) | (2 * (missing | jumped).sum(axis=1) > flaws.shape[1]),
    }
    trouble = np.zeros(flaws[:, 0].shape, dtype=np.uint8)
    for flag, joints in found.items():
        trouble[joints] |= int(flag)
    return trouble


@njit(cache=True)
@no_type_check
def _apart(p: np.ndarray, a: int, b: int, c: int, e: int, scale: float) -> float:
    """How far the step a → b is from `scale` times the step c → e [m]; from no step for c = e."""
    total = 0.0
    for d in range(3):
        total += (p[b, d] - p[a, d] - scale * (p[e, d] - p[c, d])) ** 2
    return math.sqrt(total)


@njit(cache=True)
@no_type_check
def _is_jolt(p: np.ndarray, stamps: np.ndarray, sound: np.ndarray, m: int, limits: tuple[float, ...]) -> bool:
    """Whether the step to the m-th sound frame is too fast, or unlike the steps before and after it."""
    max_speed, max_acceleration, min_jump, _ = limits
    a, b = sound[m - 1], sound[m]
    dt = stamps[b] - stamps[a]
    if _apart(p, a, b, a, a, 1.0) > min_jump + max_speed * dt:
        return True
    least = min_jump + max_acceleration * dt * dt
    for c in (m - 2, m):
        if 0 <= c < len(sound) - 1:
            before, after = sound[c], sound[c + 1]
            if _apart(p, a, b, before, after, dt / (stamps[after] - stamps[before])) <= least:
                return False
    return len(sound) > 2


@njit(cache=True)
@no_type_check
def _returns(p: np.ndarray, a: int, b: int, c: int, e: int) -> bool:
    """Whether the step c → e takes back the step a → b, or ends near a, to half of the larger step."""
    rest = min(_apart(p, a, b, c, e, -1.0), _apart(p, a, e, a, a, 1.0))
    return 2.0 * rest <= max(_apart(p, a, b, a, a, 1.0), _apart(p, c, e, c, c, 1.0))


@njit(cache=True)
@no_type_check
def _sound(flaws: np.ndarray) -> np.ndarray:
    """Frames (K,) without a flaw (N,), by a loop: it compiles faster than array expressions."""
    frames, count = np.empty(len(flaws), dtype=np.int64), 0
    for i in range(len(flaws)):
        if flaws[i] == NONE:
            frames[count] = i
            count += 1
    return frames[:count]


@njit(cache=True)
@no_type_check
def _find_jumps(positions: np.ndarray, stamps: np.ndarray, limits: tuple[float, ...], flaws: np.ndarray) -> None:
    windows, _, joints = flaws.shape
    for w in range(windows):
        for j in range(joints):
            p, flaw = positions[w, :, j], flaws[w, :, j]
            sound = _sound(flaw)
            jolt = np.zeros(len(sound), dtype=np.bool_)
            for m in range(1, len(sound)):
                jolt[m] = _is_jolt(p, stamps[w], sound, m, limits)
            m = 1
            while m < len(sound):
                k = m + 1 if jolt[m] else len(sound)
                while k < len(sound) and stamps[w, sound[k]] - stamps[w, sound[m]] <= limits[3]:
                    if jolt[k] and _returns(p, sound[m - 1], sound[m], sound[k - 1], sound[k]):
                        for i in range(sound[m], sound[k]):
                            if flaw[i] != MISSING:
                                flaw[i] = JUMP
                        m = k
                        break
                    k += 1
                m += 1


@njit(cache=True)
@no_type_check
def _slope(x: np.ndarray, stamps: np.ndarray, flaws: np.ndarray, i: int, way: int) -> float:
    """Slope [m/s] of the sound values within SLOPE_TIME of frame i, going back (way -1) or on; NaN of only one."""
    n, t1, t2, x1, tx = 0, 0.0, 0.0, 0.0, 0.0
    k = i
    while 0 <= k < len(x) and abs(stamps[k] - stamps[i]) <= SLOPE_TIME + ROUNDING:
        if flaws[k] == NONE:
            t, value = stamps[k] - stamps[i], x[k] - x[i]
            n += 1
            t1 += t
            t2 += t * t
            x1 += value
            tx += t * value
        k += way
    return (n * tx - t1 * x1) / (n * t2 - t1 * t1) if n > 1 else math.nan


@njit(cache=True)
@no_type_check
def _carried_on(x: np.ndarray, stamps: np.ndarray, flaws: np.ndarray, a: int, stamp: float) -> float:
    """Where a coordinate is at a later stamp if it goes on from frame a at its slope, fading out."""
    slope = _slope(x, stamps, flaws, a, -1)
    return x[a] if math.isnan(slope) else x[a] + slope * CARRY_ON * (1.0 - math.exp((stamps[a] - stamp) / CARRY_ON))


@njit(cache=True)
@no_type_check
def _bridge(x: np.ndarray, stamps: np.ndarray, flaws: np.ndarray, a: int, b: int) -> None:
    """A coordinate between the sound frames a and b: a cubic, end velocities half chord, half slope."""
    whole, chord = stamps[b] - stamps[a], x[b] - x[a]
    before, after = _slope(x, stamps, flaws, a, -1), _slope(x, stamps, flaws, b, 1)
    bend_before = 0.0 if math.isnan(before) else SLOPE_SHARE * (before * whole - chord)
    bend_after = 0.0 if math.isnan(after) else SLOPE_SHARE * (after * whole - chord)
    for i in range(a + 1, b):
        s = (stamps[i] - stamps[a]) / whole
        x[i] = x[a] + chord * s + s * (1.0 - s) * (bend_before * (1.0 - s) - bend_after * s)


@njit(cache=True)
@no_type_check
def _fill(p: np.ndarray, stamps: np.ndarray, flaws: np.ndarray, max_gap: float, touched: np.ndarray) -> None:
    """One joint (N, 3): gaps between sound frames are bridged; longer ones and those at an end become NaN."""
    before = -1
    for after in range(len(flaws) + 1):
        if after < len(flaws) and flaws[after] != NONE:
            continue
        first = before + 1
        if before >= 0 and first < after < len(flaws) and stamps[after] - stamps[first] <= max_gap + ROUNDING:
            for d in range(3):
                _bridge(p[:, d], stamps, flaws, before, after)
            for k in range(first, after):
                touched[k] = True
        else:
            for k in range(first, after):
                if flaws[k] != REPEATED:
                    p[k, 0] = p[k, 1] = p[k, 2] = math.nan
        before = after


@njit(cache=True)
@no_type_check
def _find_newest_jump(p: np.ndarray, stamps: np.ndarray, flaws: np.ndarray, max_speed: float) -> None:
    """Flaw the newest values where all of them are off the way of those before, faster than max_speed."""
    newest = len(stamps) - 1
    a, earlier = -1, 0
    for m in range(newest + 1):
        if flaws[m] != NONE:
            continue
        if earlier >= 2 and stamps[newest] - stamps[m] <= TRUST_AFTER + ROUNDING:
            away = True
            for k in range(m, newest + 1):
                if flaws[k] == NONE:
                    off = 0.0
                    for d in range(3):
                        off += (p[k, d] - _carried_on(p[:, d], stamps, flaws, a, stamps[k])) ** 2
                    away = away and math.sqrt(off) > max_speed * (stamps[m] - stamps[a])
            if away:
                for k in range(m, newest + 1):
                    if flaws[k] != MISSING:
                        flaws[k] = JUMP
                return
        a = m
        earlier += 1


@njit(cache=True)
@no_type_check
def _repair(
    positions: np.ndarray, stamps: np.ndarray, max_speed: float, flaws: np.ndarray, touched: np.ndarray
) -> None:
    windows, frames, joints = flaws.shape
    for w in range(windows):
        for j in range(joints):
            p, times, flaw = positions[w, :, j], stamps[w], flaws[w, :, j]
            _find_newest_jump(p, times, flaw, max_speed)
            _fill(p, times, flaw, math.inf, touched[w, :, j])
            sound = _sound(flaw)
            if len(sound) == 0:
                continue
            first, last = sound[0], sound[-1]
            for i in range(frames):
                for d in range(3):
                    if i < first:  # held back to the start
                        p[i, d] = p[first, d]
                    elif i > last:
                        p[i, d] = _carried_on(p[:, d], times, flaw, last, times[i])
                touched[w, i, j] |= i < first or i > last
