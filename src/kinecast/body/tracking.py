"""Tracked points: what a tracker repeated, lost or threw aside, and how it is made whole.

With hindsight (`fill`) both sides of a flaw are known. In the window an online predictor sees
(`repair_window`) the newest values may only be carried on. No value without a flaw is ever changed.
"""

from __future__ import annotations

import math
from enum import IntEnum, IntFlag
from itertools import pairwise
from typing import NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Bool, Float, Int, Int8, UInt8

from kinecast.geometry.transforms import lengths

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

MAX_SPEED = 8.0
"""No joint moves faster [m/s]: finds the newest jump best on the HA4M and LEGO recordings."""
MAX_ACCELERATION = 100.0
"""No joint changes its velocity faster over a whole frame [m/s^2]: twice a hand shaken 5 times a second by 5 cm."""
MIN_JUMP = 0.03
"""Smaller departures are noise, never a jump [m]."""
LONGEST_JUMP = 0.4
"""A joint that stays away longer has moved, or was found again [s]; the longest slip of the HA4M clips is 0.37 s."""
ROUNDING = 1e-6
"""Stamps differ by this [s] when they are meant to be as far apart as a limit."""


Stamps: TypeAlias = Float[np.ndarray, " N"]
Sound: TypeAlias = Bool[np.ndarray, " N"]
Coordinates: TypeAlias = Float[np.ndarray, "N K"]
Window: TypeAlias = Float[np.ndarray, "N J 3"]
Windows: TypeAlias = Float[np.ndarray, "W N J 3"]
Times: TypeAlias = Float[np.ndarray, "W N"]


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
    OCCLUDED = 2
    """The newest frame does not show the joint: it has been carried on."""
    JUMP = 4
    """A value was thrown aside and has been replaced."""
    LOST = 8
    """Missing in the two newest frames or flawed in more than half of them: better not predicted from."""


class WindowRepair(NamedTuple):
    """Windows made whole, and how."""

    positions: Float[np.ndarray, "*w N J 3"]
    """[m]; NaN only in joints a whole window never saw."""
    touched: Bool[np.ndarray, "*w N J"]
    """True where a value is not the measured one."""
    trouble: UInt8[np.ndarray, "*w J"]
    """`Trouble` flags."""


def find_flaws(
    positions: Float[np.ndarray, "*w N J 3"], stamps: Float[np.ndarray, "*w N"]
) -> Int8[np.ndarray, "*w N J"]:
    """The `Flaw` of each value of a recording, or of each of many windows seen on its own.

    A jump leaves with a jolt and returns with an opposite one within `LONGEST_JUMP`. A jolt is a step
    faster than MAX_SPEED, or one that differs from the step before and from the step after by more than
    MIN_JUMP + MAX_ACCELERATION · dt². A joint that does not return has moved, and has no flaw.

    Takes (…, N, J, 3) [m], NaN where missing, at increasing stamps (…, N) [s]; gives (…, N, J) values of `Flaw`.
    """
    missing = np.isnan(positions)
    equal = positions[..., 1:, :, :] == positions[..., :-1, :, :]
    same = (equal | (missing[..., 1:, :, :] & missing[..., :-1, :, :])).all(axis=(-2, -1))
    flaws = np.zeros(positions.shape[:-1], dtype=np.int8)
    flaws[..., 1:, :][same & equal.any(axis=(-2, -1))] = REPEATED
    flaws[~np.isfinite(positions).all(axis=-1)] = MISSING
    windows = flaws.reshape(math.prod(flaws.shape[:-2]), *flaws.shape[-2:])
    tracks, times = positions.reshape(*windows.shape, 3), stamps.reshape(windows.shape[:2])
    flawed = np.asarray(windows.any(axis=1))
    jolts = _jolts(tracks, times)
    for w, j in np.argwhere(flawed | (jolts.sum(axis=1) > 1)):
        sound = np.flatnonzero(windows[w, :, j] == NONE)
        track, when = tracks[w, sound, j], times[w, sound]
        found = _jolts(track[None, :, None], when[None])[0, :, 0] if flawed[w, j] else jolts[w, :, j]
        for first, back in _excursions(track, when, np.flatnonzero(found)):
            away = windows[w, sound[first] : sound[back], j]
            away[away != MISSING] = JUMP
    return flaws


def _jolts(positions: Windows, stamps: Times) -> Bool[np.ndarray, "W N J"]:
    """Whether the step to each frame is too fast, or unlike the steps before and after it; all frames are sound."""
    jolts = np.zeros(positions.shape[:-1], dtype=np.bool_)
    if positions.shape[1] < 2:
        return jolts
    step, dt = np.diff(positions, axis=1), np.diff(stamps, axis=1)[..., None]
    least = MIN_JUMP + MAX_ACCELERATION * dt**2
    unlike = np.full(step.shape[:-1], positions.shape[1] > 2)
    with np.errstate(invalid="ignore"):  # NaN is missing, and unlike nothing
        velocity = step / dt[..., None]
        change = lengths(np.diff(velocity, axis=1))
        unlike[:, 1:] &= change * dt[:, 1:] > least[:, 1:]
        unlike[:, :-1] &= change * dt[:, :-1] > least[:, :-1]
        jolts[:, 1:] = unlike | (lengths(step) > MIN_JUMP + MAX_SPEED * dt)
    return jolts


def _excursions(
    track: Float[np.ndarray, "K 3"], stamps: Float[np.ndarray, " K"], jolts: Int[np.ndarray, " M"]
) -> list[tuple[int, int]]:
    """Frames (first, back) between which a joint was away: a jolt, and within a time [s] one that takes it back."""
    found, after = [], 0
    for m in jolts.tolist():
        if m <= after:
            continue
        for k in jolts[(jolts > m) & (stamps[jolts] - stamps[m] <= LONGEST_JUMP)].tolist():
            there, back = track[m] - track[m - 1], track[k] - track[k - 1]
            rest = min(np.linalg.norm(there + back), np.linalg.norm(track[k] - track[m - 1]))
            # It takes back the step, or ends near where it began, to half of the larger step.
            if 2.0 * rest <= max(np.linalg.norm(there), np.linalg.norm(back)):
                found.append((m, k))
                after = k
                break
    return found


def fill(
    positions: Window,
    stamps: Stamps,
    flaws: Int8[np.ndarray, "N J"],
    max_gap: float,
) -> tuple[Window, Bool[np.ndarray, "N J"]]:
    """Flawed values interpolated between the sound ones on both sides, where these are close enough.

    `max_gap` is the longest time from the first flawed value to the next sound one [s]. Gaps too long or at an end hold
    NaN for missing values and jumps and what was recorded for repeats.

    Returns:
        (N, J, 3) positions [m], and (N, J) True where a value was interpolated.
    """
    filled = positions.copy()
    touched = np.zeros(flaws.shape, dtype=np.bool_)
    for j in np.flatnonzero(flaws.any(axis=0)):
        sound = flaws[:, j] == NONE
        filled[~sound & (flaws[:, j] != REPEATED), j] = np.nan
        for gap in _bridge_gaps(filled[:, j], stamps, sound, max_gap):
            touched[gap, j] = True
    return filled, touched


def repair_window(positions: Window, stamps: Stamps) -> WindowRepair:
    """One window repaired from nothing but itself, as it must be online.

    Flaws inside are filled from both sides. At the end, a missing or repeated value is carried on at the last
    velocity, which fades out; the newest values are taken for a jump, and carried on likewise, where they
    leave that way faster than `MAX_SPEED`. Values before the first sound one are held.

    Takes the window (N, J, 3) [m], oldest first, NaN where missing, and its increasing stamps (N,) [s].
    """
    repair = repair_windows(positions[None], stamps[None])
    return WindowRepair(repair.positions[0], repair.touched[0], repair.trouble[0])


def repair_windows(positions: Windows, stamps: Times) -> WindowRepair:
    """`repair_window` for many windows, each from nothing but itself."""
    repaired = positions.copy()
    touched = np.zeros(positions.shape[:-1], dtype=np.bool_)
    trouble = np.zeros((len(positions), positions.shape[2]), dtype=np.uint8)
    suspects = np.flatnonzero(~_calm(positions, stamps))
    if len(suspects):
        some = _repaired(repaired[suspects], stamps[suspects])
        repaired[suspects], touched[suspects], trouble[suspects] = some
    return WindowRepair(repaired, touched, trouble)


def _calm(positions: Windows, stamps: Times) -> Bool[np.ndarray, " W"]:
    """Windows that cannot have a flaw, as most: nothing is missing or repeated, nothing moves fast enough.

    No step differs from another by more than twice the greatest speed, and nothing is carried on faster than it moved.
    """
    step, dt = positions[:, 1:] - positions[:, :-1], (stamps[:, 1:] - stamps[:, :-1])[..., None]
    fastest = np.minimum(MAX_SPEED * dt, MIN_JUMP + MAX_ACCELERATION * dt**2)
    with np.errstate(invalid="ignore"):
        slow = (lengths(step) <= 0.5 * fastest).all(axis=(1, 2))
    known = np.isfinite(positions[:, :1]).all(axis=(1, 2, 3))  # the others are, where steps are
    return np.asarray(slow & known & step.any(axis=(2, 3)).all(axis=1))


def _repaired(repaired: Windows, stamps: Times) -> WindowRepair:
    """Windows looked at one by one."""
    flaws = find_flaws(repaired, stamps)
    with np.errstate(invalid="ignore"):
        speed = lengths(np.diff(repaired, axis=1)) / np.diff(stamps, axis=1)[..., None]
    suspicious = np.asarray(flaws.any(axis=1) | (speed > 0.5 * MAX_SPEED).any(axis=1))
    for w in np.flatnonzero(suspicious.any(axis=1)):
        track, when, flaw = repaired[w], stamps[w], flaws[w]
        for j in np.flatnonzero(suspicious[w]):
            _find_newest_jump(track[:, j], when, flaw[:, j])
        # Joints that suffer alike, as all do from a repeated frame, are repaired together.
        patterns, which = np.unique(flaw == NONE, axis=1, return_inverse=True)
        for k in range(patterns.shape[1]):
            joints = np.flatnonzero(which == k)
            track[:, joints] = _whole(track[:, joints], when, patterns[:, k])
    return WindowRepair(repaired, (flaws != NONE) & (flaws == NONE).any(axis=1, keepdims=True), _trouble(flaws))


def _whole(track: Float[np.ndarray, "N K 3"], stamps: Stamps, sound: Sound) -> Float[np.ndarray, "N K 3"]:
    """Some joints of a window, sound in the same frames: bridged inside, carried on at the end, held at the start."""
    known = np.flatnonzero(sound)
    if len(known) in (0, len(sound)):
        return track
    flat = track.reshape(len(track), -1).copy()
    _bridge_gaps(flat, stamps, sound)
    first, last = int(known[0]), int(known[-1])
    flat[:first] = flat[first]
    flat[last + 1 :] = _carried_on(flat, stamps, sound, last, stamps[last + 1 :])
    return flat.reshape(track.shape)


def _trouble(flaws: Int8[np.ndarray, "W N J"]) -> UInt8[np.ndarray, "W J"]:
    missing, jumped = flaws == MISSING, flaws == JUMP
    found = {
        Trouble.REPEATED: flaws[:, -1] == REPEATED,
        Trouble.OCCLUDED: missing[:, -1],
        Trouble.JUMP: jumped.any(axis=1),
        Trouble.LOST: missing[:, -2:].all(axis=1) | (2 * (missing | jumped).sum(axis=1) > flaws.shape[1]),
    }
    trouble = np.zeros(flaws[:, 0].shape, dtype=np.uint8)
    for flag, joints in found.items():
        trouble[joints] |= int(flag)
    return trouble


def _slope(x: Coordinates, stamps: Stamps, sound: Sound, i: int, way: int) -> Float[np.ndarray, " K"] | None:
    """Slope [m/s] of the sound values within SLOPE_TIME of frame i, going back (way -1) or on; None of only one."""
    end = np.searchsorted(stamps, stamps[i] + way * (SLOPE_TIME + ROUNDING))
    near = slice(end, i + 1) if way < 0 else slice(i, end)
    chosen = sound[near]
    if np.count_nonzero(chosen) < 2:
        return None
    t, value = stamps[near][chosen] - stamps[i], x[near][chosen] - x[i]
    n, t1 = len(t), t.sum()
    return (n * (t @ value) - t1 * value.sum(axis=0)) / (n * (t @ t) - t1 * t1)


def _carried_on(
    x: Coordinates,
    stamps: Stamps,
    sound: Sound,
    a: int,
    later: Float[np.ndarray, " L"],
) -> Float[np.ndarray, "L K"]:
    """Where coordinates are at later stamps if they go on from frame a at their slope, fading out."""
    slope = _slope(x, stamps, sound, a, -1)
    way = CARRY_ON * (1.0 - np.exp((stamps[a] - later) / CARRY_ON))
    return x[a] + np.outer(way, np.zeros(x.shape[1]) if slope is None else slope)


def _bridge_gaps(x: Coordinates, stamps: Stamps, sound: Sound, longest: float = np.inf) -> list[slice]:
    """Writes a cubic between sound frames, end velocities half chord, half slope; the frames of each gap so bridged."""
    bridged = []
    for a, b in pairwise(np.flatnonzero(sound).tolist()):
        if b - a == 1 or stamps[b] - stamps[a + 1] > longest + ROUNDING:
            continue
        whole, chord = stamps[b] - stamps[a], x[b] - x[a]
        before, after = _slope(x, stamps, sound, a, -1), _slope(x, stamps, sound, b, 1)
        bend_before = 0.0 if before is None else SLOPE_SHARE * (before * whole - chord)
        bend_after = 0.0 if after is None else SLOPE_SHARE * (after * whole - chord)
        bridged.append(slice(a + 1, b))
        s = ((stamps[bridged[-1]] - stamps[a]) / whole)[:, None]
        x[bridged[-1]] = x[a] + chord * s + s * (1.0 - s) * (bend_before * (1.0 - s) - bend_after * s)
    return bridged


def _find_newest_jump(x: Float[np.ndarray, "N 3"], stamps: Stamps, flaws: Int8[np.ndarray, " N"]) -> None:
    """Flaws the newest values where all of them are off the way of those before, faster than MAX_SPEED."""
    sound = flaws == NONE
    known = np.flatnonzero(sound)
    for place in range(2, len(known)):
        a, m = int(known[place - 1]), int(known[place])
        if stamps[-1] - stamps[m] > TRUST_AFTER + ROUNDING:
            continue
        newest = known[place:]
        off = lengths(x[newest] - _carried_on(x, stamps, sound, a, stamps[newest]))
        if (off > MAX_SPEED * (stamps[m] - stamps[a])).all():
            rest = flaws[m:]
            rest[rest != MISSING] = JUMP
            return
