"""How sure a mean over windows is: block bootstrap, because neighbouring windows are alike."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from kinecast.errors import OptionError

__all__ = ["Estimate", "block_bootstrap"]

FEWEST_BLOCKS = 4
"""A single recording is cut into at least so many blocks, if it has that many windows."""


@dataclass(frozen=True)
class Estimate:
    """A mean over windows and its standard error, both in the unit of the scores; NaN where unknown."""

    mean: float
    stderr: float

    def __str__(self) -> str:
        return f"{self.mean:.3g} ± {self.stderr:.2g}"


def block_bootstrap(
    scores: Float[np.ndarray, " W"],
    owner: Int[np.ndarray, " W"],
    *,
    block: int = 30,
    repeats: int = 1000,
    seed: int = 0,
) -> Estimate:
    """Mean over all windows, with its standard error over recordings.

    Several recordings are drawn anew, whole, with replacement. A single one is drawn in blocks of consecutive
    windows, which start anywhere and go on from its end to its start. Every draw gives a mean; the standard
    deviation of these is the standard error. With G recordings it is widened by √(G / (G − 1)), because
    drawing G things again shows only (G − 1) / G of their variance.

    Equal seeds draw alike. To compare two methods pass the differences of their scores, window by window.

    Args:
        scores: of each window, in time order within a recording; NaN = not scored.
        owner: number of the recording each window is from.
        block: windows per block: 30 are five seconds, at 30 Hz and every fifth frame.
        repeats: how many draws.
        seed: of the draws.

    Returns:
        The mean over scored windows, NaN if there is none. The standard error, NaN if only one recording
        is scored and of that only one window.

    Raises:
        OptionError: block below 1 or repeats below 2.
    """
    if block < 1:
        raise OptionError(f"block {block} is outside [1, ∞)")
    if repeats < 2:
        raise OptionError(f"repeats {repeats} is outside [2, ∞)")
    known = ~np.isnan(scores)
    if not known.any():
        return Estimate(np.nan, np.nan)
    recordings, group = np.unique(owner[known], return_inverse=True)
    sums = np.bincount(group, scores[known])
    counts = np.bincount(group)
    mean = float(sums.sum() / counts.sum())

    rng = np.random.default_rng(seed)
    groups = len(recordings)
    if groups == 1:
        return Estimate(mean, _error_within(rng, scores[owner == recordings[0]], block, repeats))
    drawn = rng.integers(groups, size=(repeats, groups))
    means = sums[drawn].sum(axis=1) / counts[drawn].sum(axis=1)
    return Estimate(mean, float(means.std(ddof=1) * np.sqrt(groups / (groups - 1))))


def _error_within(rng: np.random.Generator, scores: Float[np.ndarray, " W"], block: int, repeats: int) -> float:
    """Standard deviation of the mean over circular blocks drawn from one recording."""
    known = ~np.isnan(scores)
    if np.count_nonzero(known) < 2:
        return float("nan")
    windows = len(scores)
    length = max(1, min(block, windows // FEWEST_BLOCKS))
    starts = rng.integers(windows, size=(repeats, -(-windows // length)))
    # The sum over a block from any start, as a difference of running totals over the recording laid twice.
    totals = np.cumsum(np.append(0.0, np.tile(np.where(known, scores, 0.0), 2)))
    tallies = np.cumsum(np.append(0, np.tile(known, 2)))
    total = (totals[starts + length] - totals[starts]).sum(axis=1)
    count = (tallies[starts + length] - tallies[starts]).sum(axis=1)
    means = total[count > 0] / count[count > 0]
    return float(means.std(ddof=1))
