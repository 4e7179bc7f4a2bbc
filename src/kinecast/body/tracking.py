"""Tracked points made whole: gaps, repeats and jumps filled, with hindsight or as an online predictor must.

With hindsight (`fill`) both sides of a flaw are known. In the window an online predictor sees
(`repair_window`) the newest values may only be carried on. No value without a flaw is ever changed.
"""

from __future__ import annotations

from enum import IntFlag
from typing import NamedTuple, no_type_check

import numpy as np
from jaxtyping import Bool, Float, Int8, UInt8
from numba import njit

from kinecast.body.flaws import JUMP, LIMITS, MISSING, NONE, REPEATED, TrackingLimits, find_flaws

__all__ = ["Trouble", "WindowRepair", "fill", "repair_window", "repair_windows"]

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


class WindowRepair(NamedTuple):
    """Windows made whole, and how.

    Attributes:
        positions: (…, N, J, 3) [m]; NaN only in joints a whole window never saw.
        touched: (…, N, J) True where a value is not the measured one.
        trouble: (…, J) `Trouble` flags.
    """

    positions: Float[np.ndarray, "*w N J 3"]
    touched: Bool[np.ndarray, "*w N J"]
    trouble: UInt8[np.ndarray, "*w J"]


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
    _fill(filled, stamps, flaws, max_gap, touched)
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
    trouble = np.zeros((flaws.shape[0], flaws.shape[2]), dtype=np.uint8)
    _repair(repaired, np.ascontiguousarray(stamps), limits.max_speed, flaws, touched, trouble)
    return WindowRepair(repaired, touched, trouble)


_REPEATED, _GAP, _OCCLUDED = int(Trouble.REPEATED), int(Trouble.GAP), int(Trouble.OCCLUDED)
_JUMP, _LOST = int(Trouble.JUMP), int(Trouble.LOST)


@njit(cache=True)
@no_type_check
def _slope(
    positions: np.ndarray, stamps: np.ndarray, flaws: np.ndarray, j: int, i: int, way: int, slope: np.ndarray
) -> bool:
    """Slope [m/s] of the sound values within SLOPE_TIME of frame i, going back (way -1) or on (way +1).

    False, and nothing written, where there is only one.
    """
    frames = positions.shape[0]
    n, mean_t = 0, 0.0
    mean = np.zeros(3)
    k = i
    while 0 <= k < frames and abs(stamps[k] - stamps[i]) <= SLOPE_TIME + 1e-6:
        if flaws[k, j] == NONE:
            n += 1
            mean_t += stamps[k]
            mean += positions[k, j]
        k += way
    if n < 2:
        return False
    mean_t /= n
    mean /= n
    spread = 0.0
    slope[:] = 0.0
    k = i
    while 0 <= k < frames and abs(stamps[k] - stamps[i]) <= SLOPE_TIME + 1e-6:
        if flaws[k, j] == NONE:
            t = stamps[k] - mean_t
            spread += t * t
            slope += t * (positions[k, j] - mean)
        k += way
    slope /= spread
    return True


@njit(cache=True)
@no_type_check
def _bridge(
    positions: np.ndarray, stamps: np.ndarray, flaws: np.ndarray, j: int, a: int, b: int, touched: np.ndarray
) -> None:
    """Values between the sound frames a and b: a cubic, end velocities half chord, half slope."""
    whole = stamps[b] - stamps[a]
    before, after = np.zeros(3), np.zeros(3)
    has_before = _slope(positions, stamps, flaws, j, a, -1, before)
    has_after = _slope(positions, stamps, flaws, j, b, 1, after)
    for i in range(a + 1, b):
        s = (stamps[i] - stamps[a]) / whole
        for d in range(3):
            chord = positions[b, j, d] - positions[a, j, d]
            value = positions[a, j, d] + chord * s
            if has_before:
                value += SLOPE_SHARE * (before[d] * whole - chord) * s * (1.0 - s) * (1.0 - s)
            if has_after:
                value -= SLOPE_SHARE * (after[d] * whole - chord) * s * s * (1.0 - s)
            positions[i, j, d] = value
        touched[i, j] = True


@njit(cache=True)
@no_type_check
def _fill(positions: np.ndarray, stamps: np.ndarray, flaws: np.ndarray, max_gap: float, touched: np.ndarray) -> None:
    frames, joints = positions.shape[:2]
    for j in range(joints):
        before = -1
        i = 0
        while i < frames:
            if flaws[i, j] == NONE:
                before = i
                i += 1
                continue
            after = i
            while after < frames and flaws[after, j] != NONE:
                after += 1
            if before >= 0 and after < frames and stamps[after] - stamps[i] <= max_gap + 1e-6:
                _bridge(positions, stamps, flaws, j, before, after, touched)
            else:
                for k in range(i, after):
                    if flaws[k, j] != REPEATED:
                        positions[k, j] = np.nan
            i = after


@njit(cache=True)
@no_type_check
def _carry_on(
    positions: np.ndarray,
    stamps: np.ndarray,
    flaws: np.ndarray,
    j: int,
    a: int,
    stamp: float,
    place: np.ndarray,
) -> None:
    """Where the joint is at a later stamp if it goes on from frame a at its slope, fading out."""
    slope = np.zeros(3)
    _slope(positions, stamps, flaws, j, a, -1, slope)
    place[:] = positions[a, j] + slope * CARRY_ON * (1.0 - np.exp((stamps[a] - stamp) / CARRY_ON))


@njit(cache=True)
@no_type_check
def _find_newest_jump(positions: np.ndarray, stamps: np.ndarray, flaws: np.ndarray, j: int, max_speed: float) -> None:
    """Flaw the newest values where all of them are off the way of those before, faster than max_speed."""
    newest = len(stamps) - 1
    place = np.zeros(3)
    a, earlier = -1, 0
    for m in range(newest + 1):
        if flaws[m, j] != NONE:
            continue
        if earlier >= 2 and stamps[newest] - stamps[m] <= TRUST_AFTER + 1e-6:
            away = True
            for k in range(m, newest + 1):
                if flaws[k, j] == NONE:
                    _carry_on(positions, stamps, flaws, j, a, stamps[k], place)
                    off = np.sqrt(((positions[k, j] - place) ** 2).sum())
                    away = away and off > max_speed * (stamps[m] - stamps[a])
            if away:
                for k in range(m, newest + 1):
                    if flaws[k, j] != MISSING:
                        flaws[k, j] = JUMP
                return
        a = m
        earlier += 1


@njit(cache=True)
@no_type_check
def _mend_ends(positions: np.ndarray, stamps: np.ndarray, flaws: np.ndarray, j: int, touched: np.ndarray) -> None:
    """Hold the first sound value back to the start, carry the last one on to the end."""
    sound = np.flatnonzero(flaws[:, j] == NONE)
    if len(sound) == 0:
        return
    first, last = sound[0], sound[-1]
    for i in range(first):
        positions[i, j] = positions[first, j]
        touched[i, j] = True
    for i in range(last + 1, len(stamps)):
        _carry_on(positions, stamps, flaws, j, last, stamps[i], positions[i, j])
        touched[i, j] = True


@njit(cache=True)
@no_type_check
def _trouble(flaws: np.ndarray, j: int) -> int:
    newest = len(flaws) - 1
    trouble, unseen = 0, 0
    for i in range(newest + 1):
        if flaws[i, j] == JUMP:
            trouble |= _JUMP
            unseen += 1
        elif flaws[i, j] == MISSING:
            trouble |= _OCCLUDED if i == newest else _GAP
            unseen += 1
    if flaws[newest, j] == REPEATED:
        trouble |= _REPEATED
    blind = flaws[newest, j] == MISSING and (newest == 0 or flaws[newest - 1, j] == MISSING)
    if blind or 2 * unseen > newest + 1:
        trouble |= _LOST
    return trouble


@njit(cache=True)
@no_type_check
def _repair(
    positions: np.ndarray,
    stamps: np.ndarray,
    max_speed: float,
    flaws: np.ndarray,
    touched: np.ndarray,
    trouble: np.ndarray,
) -> None:
    windows, _, joints = flaws.shape
    for w in range(windows):
        for j in range(joints):
            _find_newest_jump(positions[w], stamps[w], flaws[w], j, max_speed)
            trouble[w, j] = _trouble(flaws[w], j)
        _fill(positions[w], stamps[w], flaws[w], np.inf, touched[w])
        for j in range(joints):
            _mend_ends(positions[w], stamps[w], flaws[w], j, touched[w])
