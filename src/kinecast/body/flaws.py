"""What is wrong with tracked points: values a tracker repeated, lost or threw aside."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntEnum
from typing import no_type_check

import numpy as np
from jaxtyping import Bool, Float, Int8
from numba import njit

from kinecast.errors import OptionError

__all__ = ["LIMITS", "Flaw", "TrackingLimits", "find_flaws", "repeated_frames"]


class Flaw(IntEnum):
    """What is wrong with one tracked value."""

    NONE = 0
    REPEATED = 1
    """The whole frame is an exact copy of the one before it."""
    MISSING = 2
    JUMP = 3
    """Away in one step and back in another, both sharper than a body can move."""


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


def repeated_frames(positions: Float[np.ndarray, "N J 3"]) -> Bool[np.ndarray, " N"]:
    """(N,) True where a frame is an exact copy of the one before it, all joints, at least one seen."""
    repeated = np.zeros(len(positions), dtype=np.bool_)
    _repeated(positions, repeated)
    return repeated


def find_flaws(
    positions: Float[np.ndarray, "*w N J 3"],
    stamps: Float[np.ndarray, "*w N"],
    limits: TrackingLimits = LIMITS,
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
    flaws = np.zeros(positions.shape[:-1], dtype=np.int8)
    frames, joints = positions.shape[-3:-1]
    windows = math.prod(positions.shape[:-3])
    _find_flaws(
        np.ascontiguousarray(positions).reshape(windows, frames, joints, 3),
        np.ascontiguousarray(stamps).reshape(windows, frames),
        limits.max_speed, limits.max_acceleration, limits.min_jump, limits.longest_jump,
        flaws.reshape(windows, frames, joints),
    )  # fmt: skip
    return flaws


NONE, REPEATED, MISSING, JUMP = int(Flaw.NONE), int(Flaw.REPEATED), int(Flaw.MISSING), int(Flaw.JUMP)


@njit(cache=True)
@no_type_check
def _repeated(positions: np.ndarray, repeated: np.ndarray) -> None:
    frames, joints = positions.shape[:2]
    for i in range(1, frames):
        same, seen = True, False
        for j in range(joints):
            for d in range(3):
                now, before = positions[i, j, d], positions[i - 1, j, d]
                if now == before:
                    seen = True
                elif not (np.isnan(now) and np.isnan(before)):
                    same = False
                    break
            if not same:
                break
        repeated[i] = same and seen


@njit(cache=True)
@no_type_check
def _departure(positions: np.ndarray, stamps: np.ndarray, j: int, a: int, b: int, p: int, q: int) -> float:
    """How far the step a → b is from going on at the velocity of the step p → q [m]."""
    scale = (stamps[b] - stamps[a]) / (stamps[q] - stamps[p])
    total = 0.0
    for d in range(3):
        e = positions[b, j, d] - positions[a, j, d] - scale * (positions[q, j, d] - positions[p, j, d])
        total += e * e
    return float(np.sqrt(total))


@njit(cache=True)
@no_type_check
def _length(positions: np.ndarray, j: int, a: int, b: int) -> float:
    total = 0.0
    for d in range(3):
        e = positions[b, j, d] - positions[a, j, d]
        total += e * e
    return float(np.sqrt(total))


@njit(cache=True)
@no_type_check
def _is_jolt(
    positions: np.ndarray,
    stamps: np.ndarray,
    j: int,
    sound: np.ndarray,
    m: int,
    max_speed: float,
    max_acceleration: float,
    min_jump: float,
) -> bool:
    """Whether the step to the m-th sound frame is too fast, or unlike the steps before and after it."""
    a, b = sound[m - 1], sound[m]
    dt = stamps[b] - stamps[a]
    if _length(positions, j, a, b) > min_jump + max_speed * dt:
        return True
    least = min_jump + max_acceleration * dt * dt
    if m >= 2 and _departure(positions, stamps, j, a, b, sound[m - 2], a) <= least:
        return False
    if m + 1 < len(sound) and _departure(positions, stamps, j, a, b, b, sound[m + 1]) <= least:
        return False
    return len(sound) > 2


@njit(cache=True)
@no_type_check
def _returns(positions: np.ndarray, j: int, a: int, b: int, c: int, e: int) -> bool:
    """Whether the step c → e takes back the step a → b, or ends near a, to half of the larger step."""
    uncancelled = 0.0
    for d in range(3):
        r = positions[b, j, d] - positions[a, j, d] + positions[e, j, d] - positions[c, j, d]
        uncancelled += r * r
    rest = min(np.sqrt(uncancelled), _length(positions, j, a, e))
    return bool(2.0 * rest <= max(_length(positions, j, a, b), _length(positions, j, c, e)))


@njit(cache=True)
@no_type_check
def _find_jumps(
    positions: np.ndarray,
    stamps: np.ndarray,
    j: int,
    max_speed: float,
    max_acceleration: float,
    min_jump: float,
    longest_jump: float,
    flaws: np.ndarray,
) -> None:
    sound = np.flatnonzero(flaws[:, j] == NONE)
    n = len(sound)
    jolt = np.zeros(n, dtype=np.bool_)
    for m in range(1, n):
        jolt[m] = _is_jolt(positions, stamps, j, sound, m, max_speed, max_acceleration, min_jump)
    m = 1
    while m < n:
        if jolt[m]:
            for k in range(m + 1, n):
                if stamps[sound[k]] - stamps[sound[m]] > longest_jump:
                    break
                if jolt[k] and _returns(positions, j, sound[m - 1], sound[m], sound[k - 1], sound[k]):
                    for i in range(sound[m], sound[k]):
                        if flaws[i, j] != MISSING:
                            flaws[i, j] = JUMP
                    m = k
                    break
        m += 1


@njit(cache=True)
@no_type_check
def _find_flaws(
    positions: np.ndarray,
    stamps: np.ndarray,
    max_speed: float,
    max_acceleration: float,
    min_jump: float,
    longest_jump: float,
    flaws: np.ndarray,
) -> None:
    windows, frames, joints = positions.shape[:3]
    repeated = np.zeros(frames, dtype=np.bool_)
    for w in range(windows):
        _repeated(positions[w], repeated)
        for i in range(frames):
            for j in range(joints):
                if not np.isfinite(positions[w, i, j].sum()):
                    flaws[w, i, j] = MISSING
                elif repeated[i]:
                    flaws[w, i, j] = REPEATED
        for j in range(joints):
            _find_jumps(positions[w], stamps[w], j, max_speed, max_acceleration, min_jump, longest_jump, flaws[w])
