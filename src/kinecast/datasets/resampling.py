"""Recordings at another frame rate: smoothed on the way down, with no value where none was seen."""

from __future__ import annotations

from dataclasses import replace
from typing import no_type_check

import numpy as np
from jaxtyping import Float
from numba import njit

from kinecast.datasets.recording import Recording
from kinecast.errors import DatasetError, OptionError

__all__ = ["MOST_FRAMES", "measured_rate", "resample"]

RATE_RANGE = (1.0, 1000.0)
"""Frame rates a recording can be resampled to [Hz]."""

MOST_FRAMES = 10_000_000
"""Longest result; a stamp in the wrong unit must not fill the memory."""

# Above this share of the source's rate nothing is smoothed: cameras seldom run at exactly what they state.
SMOOTH_BELOW = 0.95
# A local quadratic under Gaussian weights of width s passes (1 + u)·exp(-u) of a frequency f, where
# u = 2 (pi s f)^2. This width, in new frames, passes half at the new Nyquist frequency; from 100 to 30 Hz
# that is 97 % at 6 Hz, where hands still move, and 5 % at 25 Hz, which would fold back to 5 Hz.
WIDTH = 0.583
REACH = 3.0


def measured_rate(stamps: Float[np.ndarray, " N"]) -> float:
    """Frames per second as the stamps have it: one over their median step; NaN for fewer than two."""
    return float(1.0 / np.median(np.diff(stamps))) if len(stamps) > 1 else float("nan")


def resample(recording: Recording, rate: float, *, smooth: bool = True) -> Recording:
    """The recording on uniform stamps, `rate` frames per second, starting at its first frame.

    Downwards, each new position is a local quadratic fit to the frames around it, under Gaussian weights:
    zero phase, straight motion and parabolas unchanged, gaps and uneven stamps no matter. Upwards it is
    linear interpolation. A joint is NaN wherever its two neighbouring frames are not both seen, or are more
    than one and a half frames apart. Labels are those of the nearest frame.

    Args:
        recording: at any rate, stamps as uneven as they are.
        rate: frames per second [Hz].
        smooth: downwards, against aliasing. It looks up to two new frames ahead, so what a predictor is scored on
            is sampled without it, by linear interpolation.

    Returns:
        The resampled recording; the same positions, bit by bit, where the stamps are uniform at this rate.

    Raises:
        OptionError: rate outside `RATE_RANGE`.
        DatasetError: fewer than two frames, or a duration that makes more than `MOST_FRAMES` of them.
    """
    lowest, highest = RATE_RANGE
    if not lowest <= rate <= highest:
        raise OptionError(f"rate is {rate} Hz, allowed is {lowest:g} to {highest:g} Hz")
    where = recording.source or recording.name
    if len(recording.stamps) < 2:
        raise DatasetError(where, f"{len(recording.stamps)} frame; resampling needs at least 2")
    source_rate = measured_rate(recording.stamps)
    count = int(np.floor(recording.duration * rate + 1e-6)) + 1
    if count > MOST_FRAMES:
        raise DatasetError(where, f"{recording.duration:.6g} s at {rate:g} Hz make more than {MOST_FRAMES} frames")
    stamps = recording.stamps[0] + np.arange(count) / rate
    if count == len(recording.stamps) and np.abs(stamps - recording.stamps).max() < 1e-6:
        return replace(recording, rate=rate)
    width = WIDTH / rate if smooth and rate < SMOOTH_BELOW * source_rate else 0.0
    positions = np.full((count, len(recording.joints), 3), np.nan)
    _resample(
        np.ascontiguousarray(recording.positions),
        recording.stamps,
        stamps,
        width,
        1.5 / source_rate,
        positions,
    )
    labels = recording.labels
    if labels is not None:
        labels = tuple(labels[i] for i in _nearest(recording.stamps, stamps))
    note = f"resampled from {source_rate:.4g} to {rate:g} Hz"
    return replace(
        recording,
        stamps=stamps,
        positions=positions,
        rate=rate,
        labels=labels,
        notes=(*recording.notes, note),
    )


def _nearest(stamps: Float[np.ndarray, " N"], wanted: Float[np.ndarray, " K"]) -> list[int]:
    """Index of the stamp nearest to each wanted one."""
    right = np.clip(np.searchsorted(stamps, wanted), 1, len(stamps) - 1)
    left_is_nearer = wanted - stamps[right - 1] <= stamps[right] - wanted
    return [int(i) for i in np.where(left_is_nearer, right - 1, right)]


@njit(cache=True)
@no_type_check
def _resample(
    positions: np.ndarray,
    stamps: np.ndarray,
    wanted: np.ndarray,
    width: float,
    longest_step: float,
    out: np.ndarray,
) -> None:
    frames, joints = positions.shape[:2]
    right = 0
    for n in range(len(wanted)):
        t = wanted[n]
        while right < frames - 1 and stamps[right] < t - 1e-9:
            right += 1
        on_frame = abs(stamps[right] - t) <= 1e-9
        left = right if on_frame else max(right - 1, 0)
        if stamps[right] - stamps[left] > longest_step:
            continue
        for j in range(joints):
            if not np.isfinite(positions[left, j].sum() + positions[right, j].sum()):
                continue
            if width > 0.0:
                _local_quadratic(positions, stamps, j, left, t, width, out[n, j])
            elif on_frame:
                out[n, j] = positions[right, j]
            else:
                share = (t - stamps[left]) / (stamps[right] - stamps[left])
                out[n, j] = (1.0 - share) * positions[left, j] + share * positions[right, j]


@njit(cache=True)
@no_type_check
def _local_quadratic(
    positions: np.ndarray, stamps: np.ndarray, j: int, near: int, t: float, width: float, place: np.ndarray
) -> None:
    """Value at t of the parabola through the seen frames around it, fitted under Gaussian weights."""
    first, last = near, near
    while first > 0 and t - stamps[first - 1] <= REACH * width:
        first -= 1
    while last < len(stamps) - 1 and stamps[last + 1] - t <= REACH * width:
        last += 1
    moments = np.zeros(5)
    seen = 0
    for i in range(first, last + 1):
        if np.isfinite(positions[i, j].sum()):
            s = (stamps[i] - t) / width
            weight = np.exp(-0.5 * s * s)
            seen += 1
            for power in range(5):
                moments[power] += weight
                weight *= s
    # The fit's value at t is a weighted sum: weights (c0 + c1 s + c2 s^2)·w with M c = (1, 0, 0).
    m0, m1, m2, m3, m4 = moments
    c = np.array([m2 * m4 - m3 * m3, m2 * m3 - m1 * m4, m1 * m3 - m2 * m2])
    determinant = m0 * c[0] + m1 * c[1] + m2 * c[2]
    if seen > 3 and determinant > 1e-6 * m0**3:
        c /= determinant
    else:  # too few frames for a parabola
        c[:] = 1.0 / m0, 0.0, 0.0
    place[:] = 0.0
    for i in range(first, last + 1):
        if np.isfinite(positions[i, j].sum()):
            s = (stamps[i] - t) / width
            weight = np.exp(-0.5 * s * s) * (c[0] + c[1] * s + c[2] * s * s)
            place += weight * positions[i, j]
