"""Recordings at another frame rate, by linear interpolation: no value where none was seen, none from further ahead."""

from __future__ import annotations

from dataclasses import replace
from typing import TypeAlias

import numpy as np
from jaxtyping import Float, Int

from kinecast.datasets.recording import Recording
from kinecast.errors import DatasetError, OptionError

RATE_RANGE = (1.0, 1000.0)  # frame rates a recording can be resampled to [Hz]
MOST_FRAMES = 10_000_000  # longest result; a stamp in the wrong unit must not fill the memory
SAME = 1e-9  # stamps this close are one [s]

Stamps: TypeAlias = Float[np.ndarray, " N"]
Wanted: TypeAlias = Float[np.ndarray, " K"]


def check_rate(rate: float) -> None:
    """OptionError for a rate outside `RATE_RANGE`."""
    lowest, highest = RATE_RANGE
    if not lowest <= rate <= highest:
        raise OptionError(f"rate is {rate} Hz, allowed is {lowest:g} to {highest:g} Hz")


def measured_rate(stamps: Stamps) -> float:
    """Frames per second as the stamps have it: one over their median step; NaN for fewer than two."""
    return float(1.0 / np.median(np.diff(stamps))) if len(stamps) > 1 else float("nan")


def resample(recording: Recording, rate: float) -> Recording:
    """The recording on uniform stamps, `rate` frames per second, starting at its first frame.

    A joint is NaN wherever its two neighbouring frames are not both seen, or are more than one and a half frames
    apart. Labels are those of the nearest frame. Nothing is smoothed: that would let a window see ahead. Positions
    are the same, bit by bit, where the stamps are uniform at this rate.

    Raises:
        OptionError: rate outside `RATE_RANGE`.
        DatasetError: fewer than two frames, or a duration that makes more than `MOST_FRAMES` of them.
    """
    check_rate(rate)
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
    left, right, share = _neighbours(recording.stamps, stamps)
    positions = recording.positions[left] * (1.0 - share[:, None, None])
    positions += share[:, None, None] * recording.positions[right]
    apart = recording.stamps[right] - recording.stamps[left] > 1.5 / source_rate
    positions[apart[:, None] | ~np.isfinite(positions).all(axis=-1)] = np.nan
    return replace(
        recording,
        stamps=stamps,
        positions=positions,
        rate=rate,
        labels=recording.labels and tuple(recording.labels[i] for i in np.where(share > 0.5, right, left)),
        notes=(*recording.notes, f"resampled from {source_rate:.4g} to {rate:g} Hz"),
    )


def _neighbours(
    stamps: Stamps, wanted: Wanted
) -> tuple[Int[np.ndarray, " K"], Int[np.ndarray, " K"], Float[np.ndarray, " K"]]:
    """Frames before and after each wanted stamp, or twice the one at it, and how far it is from the first, 0..1."""
    right = np.minimum(np.searchsorted(stamps, wanted - SAME), len(stamps) - 1)
    left = np.where(np.abs(stamps[right] - wanted) <= SAME, right, np.maximum(right - 1, 0))
    step = stamps[right] - stamps[left]
    return left, right, (wanted - stamps[left]) / np.where(step > 0, step, 1.0) * (step > 0)
