"""Scores of one prediction against what happened: pure functions on arrays, one value per step and joint.

Nothing is averaged here, so that the caller can average over windows, recordings or moving frames. Throughout,
`samples` (S, T, J, 3) are predicted positions and `truth` (T, J, 3) what came [m].

Missing values, for every score: a joint whose truth has a NaN is not scored and its value is NaN (`regions` returns
booleans: read them through `scored`). Samples are finite; one that is not makes the score of its step and joint NaN,
and no samples at all make every score NaN.

CRPS and energy score are not scoringrules', which tests compare them with: importing it compiles for 4 s, every time,
and its unbiased energy score takes all pairs of samples, a second and more a window instead of 9 ms.
"""

from __future__ import annotations

from math import sqrt
from typing import no_type_check

import numpy as np
from jaxtyping import Bool, Float, Int
from numba import njit

LEVELS = (0.5, 0.8, 0.9, 0.95, 0.99)
"""The shares of probability at which coverage is reported."""

MINIMUM_SPREAD = 1e-4
"""Smallest standard deviation [m] of samples along any direction: 0.1 mm, well under any sensor's noise."""

NLL_CEILING = 20.0
"""Largest KDE-NLL of one joint and step: Motron and Trajectron++ clip the log density at -20."""

PAIR_SHIFTS = 16
"""The energy score compares each sample with so many others."""

MOVING_SPEED = 0.3
"""A wrist faster than this [m/s] makes a window a moving one (docs/method, scores)."""

WRISTS = (2, 5)

DRAWS = 1000
"""Draws of the bootstrap."""

FEWEST_BLOCKS = 4
"""A single recording is cut into at least so many blocks, if it has that many windows."""


def scored(truth: Float[np.ndarray, "*batch 3"]) -> Bool[np.ndarray, "*batch"]:
    """True where a joint's truth is known, so that scores exist."""
    return np.isfinite(truth).all(axis=-1)


def joint_errors(
    mean: Float[np.ndarray, "*batch 3"], truth: Float[np.ndarray, "*batch 3"]
) -> Float[np.ndarray, "*batch"]:
    """Distance |j − ĵ| of predicted from true joints (Eq. 8 before its average).

    Args:
        mean: (…, T, J, 3) predicted positions [m].
        truth: (…, T, J, 3) positions that came [m].

    Returns:
        (…, T, J) errors [m]; NaN where either is missing.
    """
    return np.asarray(np.linalg.norm(mean - truth, axis=-1))


def crps(samples: Float[np.ndarray, "S T J 3"], truth: Float[np.ndarray, "T J 3"]) -> Float[np.ndarray, "T J 3"]:
    """Continuous ranked probability score of every coordinate, E|X − y| − ½ E|X − X'|.

    The fair (unbiased) estimator: the second mean is over pairs of different samples, from the sorted samples
    Σ_{i<j} |x_i − x_j| = Σ_i (2 i − n + 1) x_(i). One sample alone scores its absolute error.
    Returns (T, J, 3) scores [m], smaller is better.
    """
    away = np.sort(_cells(samples), axis=-1) - truth.reshape(-1, 3, 1)
    count = away.shape[-1]
    weights = (2.0 * np.arange(count) - count + 1) / max(count * (count - 1), 1)
    score = (np.abs(away).mean(axis=-1) - away @ weights).reshape(truth.shape)
    return np.where(scored(truth)[..., None], score, np.nan)


def energy_score(samples: Float[np.ndarray, "S T J 3"], truth: Float[np.ndarray, "T J 3"]) -> Float[np.ndarray, "T J"]:
    """Energy score of every joint's position, E‖X − y‖ − ½ E‖X − X'‖.

    Unbiased: the second mean is over nearly 16 S pairs of different samples (all pairs where S ≤ 17) instead
    of all ½ S (S − 1). The pairs come from shifts of a fixed shuffle, so an ordered or antithetic sample set
    does no harm and the same samples always score the same. One sample alone scores its distance.
    Returns (T, J) scores [m], smaller is better.
    """
    cells = _cells(samples[np.random.default_rng(0).permutation(len(samples))])
    away = np.linalg.norm(cells - truth.reshape(-1, 3, 1), axis=1).mean(axis=-1)
    shifts = min(PAIR_SHIFTS, cells.shape[-1] - 1)
    return (away - 0.5 * _mean_gaps(cells, shifts)).reshape(truth.shape[:-1])


def kde_nll(samples: Float[np.ndarray, "S T J 3"], truth: Float[np.ndarray, "T J 3"]) -> Float[np.ndarray, "T J"]:
    """Negative log of a Gaussian kernel density estimate at the truth, per joint and step, at most 20.

    The estimate is scipy.stats.gaussian_kde with Scott's bandwidth: kernel covariance = n^(−2/7) Σ. Standard
    deviations of Σ under 0.1 mm count as 0.1 mm, so that samples without spread have a density too.
    Returns (T, J) negative log densities, log of 1/m^3, smaller is better.
    """
    cells = _cells(samples)
    _, whitening, log_det = _ellipsoids(cells)
    bandwidth = cells.shape[-1] ** (-1.0 / 7.0)  # Scott: n^(-1 / (d + 4))
    kernels = np.exp(-0.5 * _squared_distances(cells, truth.reshape(-1, 3), whitening) / bandwidth**2)
    log_volume = 1.5 * np.log(2.0 * np.pi) + 3.0 * np.log(bandwidth) + 0.5 * log_det
    with np.errstate(divide="ignore"):  # a truth so far off that all kernels vanish meets the ceiling
        score = log_volume - np.log(kernels.mean(axis=-1))
    return np.minimum(score, NLL_CEILING).reshape(truth.shape[:-1])


def regions(
    samples: Float[np.ndarray, "S T J 3"], truth: Float[np.ndarray, "T J 3"]
) -> tuple[Bool[np.ndarray, "L T J"], Float[np.ndarray, "L T J"], Float[np.ndarray, "L T J"]]:
    """Ellipsoids that hold each of `LEVELS` of the samples: is the truth inside, and how large are they?

    The ellipsoid of a joint and step has the samples' mean and covariance, and is scaled through the
    ⌈level (S + 1)⌉-th nearest sample (the farthest at most): the rank that one more draw falls below with
    that probability.

    Returns:
        (L, T, J) whether the truth is inside, False where it is missing (mask with `scored`);
        (L, T, J) volumes [m^3], zero for samples without spread; and
        (L, T, J) by what its radius must be multiplied for the region to just reach the truth, NaN where it is missing.
    """
    cells = _cells(samples)
    mean, whitening, log_det = _ellipsoids(cells)
    nearness = np.sort(_squared_distances(cells, mean, whitening), axis=-1)
    reached = _squared_distances(truth.reshape(-1, 3, 1), mean, whitening)[:, 0]
    count = nearness.shape[-1]
    ranks = np.ceil(np.array(LEVELS) * (count + 1) - 1e-9).astype(int) - 1
    squared_radius = nearness[:, np.minimum(ranks, count - 1)].T
    volume = 4.0 / 3.0 * np.pi * squared_radius**1.5 * np.exp(0.5 * log_det)
    with np.errstate(divide="ignore", invalid="ignore"):
        stretch = np.sqrt(reached / squared_radius)
    shape = (len(LEVELS), *truth.shape[:-1])
    return (reached <= squared_radius).reshape(shape), volume.reshape(shape), stretch.reshape(shape)


def is_moving(observed: Float[np.ndarray, "N 6 3"], dt: float) -> bool:
    """Whether a wrist's median speed over the window, from frame to frame, is above 0.3 m/s.

    The median, because noise, repeated frames and single jumps of the tracker would make the largest
    speed pass 0.3 m/s in most windows of a person at rest.

    Args:
        observed: (N, 6, 3) the window seen [m]; NaN where missing.
        dt: time between frames [s].
    """
    speeds = np.linalg.norm(np.diff(observed[:, WRISTS], axis=0), axis=-1).T / dt
    known = [speed[np.isfinite(speed)] for speed in speeds]
    return any(len(speed) and np.median(speed) > MOVING_SPEED for speed in known)


def block_bootstrap(scores: Float[np.ndarray, " W"], owner: Int[np.ndarray, " W"], block: int, seed: int = 0) -> float:
    """Standard error of the mean over all windows, by block bootstrap, because neighbouring windows are alike.

    Several recordings are drawn anew, whole, with replacement. A single one is drawn in blocks of consecutive
    windows, which start anywhere and go on from its end to its start. Every draw gives a mean; the standard
    deviation of these is the standard error. With G recordings it is widened by √(G / (G − 1)), because
    drawing G things again shows only (G − 1) / G of their variance.

    Equal seeds draw alike. To compare two methods pass the differences of their scores, window by window.

    Args:
        scores: of each window, in time order within a recording; NaN = not scored.
        owner: number of the recording each window is from.
        block: windows per block, at least one.
        seed: of the draws.

    Returns:
        In the unit of the scores; NaN if only one recording is scored and of that less than two windows.
    """
    known = ~np.isnan(scores)
    if np.count_nonzero(known) < 2:
        return float("nan")
    rng = np.random.default_rng(seed)
    recordings, group = np.unique(owner[known], return_inverse=True)
    if len(recordings) > 1:
        sums, counts = np.bincount(group, scores[known]), np.bincount(group)
        drawn = rng.integers(len(sums), size=(DRAWS, len(sums)))
        means = sums[drawn].sum(axis=1) / counts[drawn].sum(axis=1)
        return float(means.std(ddof=1) * np.sqrt(len(sums) / (len(sums) - 1)))
    here = owner == recordings[0]
    scores, known = scores[here], known[here]
    length = max(1, min(block, len(scores) // FEWEST_BLOCKS))
    starts = rng.integers(len(scores), size=(DRAWS, -(-len(scores) // length)))
    # The sum over a block from any start, as a difference of running totals over the recording laid twice.
    totals = np.cumsum(np.append(0.0, np.tile(np.where(known, scores, 0.0), 2)))
    tallies = np.cumsum(np.append(0, np.tile(known, 2)))
    total = (totals[starts + length] - totals[starts]).sum(axis=1)
    count = (tallies[starts + length] - tallies[starts]).sum(axis=1)
    return float((total[count > 0] / count[count > 0]).std(ddof=1))


def _cells(samples: Float[np.ndarray, "S T J 3"]) -> Float[np.ndarray, "K 3 R"]:
    """The samples of each cell (a step and joint) together, contiguous per coordinate; none at all become a NaN."""
    present = samples if len(samples) else np.full((1, *samples.shape[1:]), np.nan)
    return np.ascontiguousarray(present.transpose(1, 2, 3, 0)).reshape(-1, 3, len(present))


def _ellipsoids(
    cells: Float[np.ndarray, "K 3 S"],
) -> tuple[Float[np.ndarray, "K 3"], Float[np.ndarray, "K 3 3"], Float[np.ndarray, " K"]]:
    """Mean, whitening matrix and log det of the covariance, whose eigenvalues are not under MINIMUM_SPREAD²."""
    mean = cells.mean(axis=-1)
    centred = cells - mean[..., None]
    covariance = centred @ centred.transpose(0, 2, 1) / max(cells.shape[-1] - 1, 1)
    eigenvalues, axes = np.linalg.eigh(np.nan_to_num(covariance))  # where it is NaN the mean is, and so all distances
    eigenvalues = np.maximum(eigenvalues, MINIMUM_SPREAD**2)
    whitening = axes.transpose(0, 2, 1) / np.sqrt(eigenvalues)[:, :, None]
    return mean, whitening, np.log(eigenvalues).sum(axis=-1)


def _squared_distances(
    cells: Float[np.ndarray, "K 3 S"], point: Float[np.ndarray, "K 3"], whitening: Float[np.ndarray, "K 3 3"]
) -> Float[np.ndarray, "K S"]:
    """Squared Mahalanobis distances of each cell's samples from a point."""
    away = whitening @ (cells - point[..., None])
    return np.asarray((away * away).sum(axis=1))


# The sum may be in any order ("reassoc"), which lets it use vector instructions.
# no_type_check: a test run that checks shapes must not wrap what numba compiles.
@njit(cache=True, fastmath={"reassoc"})
@no_type_check
def _mean_gaps(cells, shifts):
    """(K,) mean distance of sample i from samples i + 1 … i + shifts; zero without shifts."""
    means = np.zeros(len(cells))
    samples = cells.shape[2]
    pairs = max(shifts * samples - shifts * (shifts + 1) // 2, 1)
    for cell in range(len(cells)):
        x, y, z = cells[cell, 0], cells[cell, 1], cells[cell, 2]
        total = 0.0
        for shift in range(1, shifts + 1):
            for i in range(samples - shift):
                j = i + shift
                total += sqrt((x[i] - x[j]) ** 2 + (y[i] - y[j]) ** 2 + (z[i] - z[j]) ** 2)
        means[cell] = total / pairs
    return means
