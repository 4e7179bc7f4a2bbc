"""Scores of one prediction against what happened: pure functions on arrays, one value per step and joint.

Nothing is averaged here, so that the caller can average over windows, recordings or moving frames.

Missing values, for every score: a joint whose truth has a NaN is not scored and its value is NaN
(`regions` returns booleans: read them through `scored`). A sample with a NaN at a step and joint, for
instance one that left the set of allowed motions there, is absent from that step and joint; with no sample
left the score is NaN.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import no_type_check

import numpy as np
from jaxtyping import Bool, Float, Int
from numba import njit

from kinecast.errors import OptionError

__all__ = [
    "LEVELS",
    "crps",
    "effective_sample_size",
    "energy_score",
    "is_moving",
    "joint_errors",
    "kde_nll",
    "regions",
    "scored",
]

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


def scored(truth: Float[np.ndarray, "*batch 3"]) -> Bool[np.ndarray, "*batch"]:
    """True where a joint's truth is known, so that scores exist."""
    known: np.ndarray = np.isfinite(truth).all(axis=-1)
    return known


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
    errors: np.ndarray = np.linalg.norm(mean - truth, axis=-1)
    return errors


def crps(samples: Float[np.ndarray, "S T J 3"], truth: Float[np.ndarray, "T J 3"]) -> Float[np.ndarray, "T J 3"]:
    """Continuous ranked probability score of every coordinate, E|X − y| − ½ E|X − X'|.

    The fair (unbiased) estimator: the second mean is over pairs of different samples, summed from the sorted
    samples. One sample alone has no spread to take off, so its score is its absolute error.

    Args:
        samples: (S, T, J, 3) predicted positions [m].
        truth: (T, J, 3) positions that came [m].

    Returns:
        (T, J, 3) scores [m], smaller is better.
    """
    cells = _cells(samples)
    ordered = cells.reshape(-1, cells.shape[-1])
    ordered.sort(axis=-1)  # NaN, the absent, goes to the end
    score: np.ndarray = _crps_sorted(ordered, truth.ravel()).reshape(truth.shape)
    score[~scored(truth)] = np.nan
    return score


def energy_score(samples: Float[np.ndarray, "S T J 3"], truth: Float[np.ndarray, "T J 3"]) -> Float[np.ndarray, "T J"]:
    """Energy score of every joint's position, E‖X − y‖ − ½ E‖X − X'‖.

    Unbiased: the second mean is over nearly 16 S pairs of different samples (all pairs where S ≤ 17) instead
    of all ½ S (S − 1). The pairs come from shifts of a fixed shuffle, so an ordered or antithetic sample set
    does no harm and the same samples always score the same. One sample alone scores its distance.

    Args:
        samples: (S, T, J, 3) predicted positions [m].
        truth: (T, J, 3) positions that came [m].

    Returns:
        (T, J) scores [m], smaller is better.
    """
    count = len(samples)
    cells = _cells(samples[np.random.default_rng(0).permutation(count)])
    score: np.ndarray = _energy(cells, truth.reshape(-1, 3), min(PAIR_SHIFTS, count - 1))
    return score.reshape(truth.shape[:-1])


def kde_nll(samples: Float[np.ndarray, "S T J 3"], truth: Float[np.ndarray, "T J 3"]) -> Float[np.ndarray, "T J"]:
    """Negative log of a Gaussian kernel density estimate at the truth, per joint and step, at most 20.

    The estimate is scipy.stats.gaussian_kde with Scott's bandwidth: kernel covariance = n^(−2/7) Σ. Standard
    deviations of Σ under 0.1 mm count as 0.1 mm, so that samples without spread have a density too.

    Args:
        samples: (S, T, J, 3) predicted positions [m].
        truth: (T, J, 3) positions that came [m].

    Returns:
        (T, J) negative log densities, log of 1/m^3, smaller is better.
    """
    cells = _cells(samples)
    _, whitening, log_det, count = _ellipsoids(cells)
    bandwidth = np.maximum(count, 1) ** (-1.0 / 7.0)  # Scott: n^(-1 / (d + 4))
    squared = _squared_distances(cells, truth.reshape(-1, 3), whitening)
    kernels = np.exp(-0.5 * squared / bandwidth[:, None] ** 2)
    log_volume = 1.5 * np.log(2.0 * np.pi) + 3.0 * np.log(bandwidth) + 0.5 * log_det
    with np.errstate(divide="ignore"):  # a truth so far off that all kernels vanish meets the ceiling
        score = log_volume - np.log(np.nansum(kernels, axis=-1) / np.maximum(count, 1))
    score = np.minimum(score, NLL_CEILING).reshape(truth.shape[:-1])
    return np.where(scored(truth) & (count > 0).reshape(score.shape), score, np.nan)


def regions(
    samples: Float[np.ndarray, "S T J 3"],
    truth: Float[np.ndarray, "T J 3"],
    levels: Sequence[float] = LEVELS,
) -> tuple[Bool[np.ndarray, "L T J"], Float[np.ndarray, "L T J"], Float[np.ndarray, "L T J"]]:
    """Ellipsoids that hold a share of the samples: is the truth inside, and how large are they?

    The ellipsoid of a joint and step has the samples' mean and covariance, and is scaled through the
    ⌈level (S + 1)⌉-th nearest sample (the farthest at most): the rank that one more draw falls below with
    that probability.

    Args:
        samples: (S, T, J, 3) predicted positions [m].
        truth: (T, J, 3) positions that came [m].
        levels: shares of probability, each in (0, 1).

    Returns:
        (L, T, J) whether the truth is inside, False where it is missing (mask with `scored`);
        (L, T, J) volumes [m^3], zero for samples without spread, NaN where no sample is left; and
        (L, T, J) by what its radius must be multiplied for the region to just reach the truth, NaN where it is missing.

    Raises:
        OptionError: a level outside (0, 1).
    """
    if not all(0.0 < level < 1.0 for level in levels):
        raise OptionError(f"levels {list(levels)} are outside (0, 1)")
    cells = _cells(samples)
    mean, whitening, log_det, count = _ellipsoids(cells)
    nearness = np.sort(_squared_distances(cells, mean, whitening), axis=-1)  # NaN goes to the end
    reached = _squared_distances(truth.reshape(-1, 3, 1), mean, whitening)[:, 0]

    ranks = np.ceil(np.asarray(levels)[:, None] * (count + 1) - 1e-9).astype(np.int64) - 1
    ranks = np.clip(ranks, 0, np.maximum(count - 1, 0))
    squared_radius = np.take_along_axis(nearness, ranks.T, axis=-1).T
    inside = reached <= squared_radius  # False for NaN
    volume = 4.0 / 3.0 * np.pi * squared_radius**1.5 * np.exp(0.5 * log_det)
    shape = (len(levels), *truth.shape[:-1])
    with np.errstate(divide="ignore", invalid="ignore"):
        stretch = np.sqrt(reached / squared_radius)
    return inside.reshape(shape), volume.reshape(shape), stretch.reshape(shape)


def effective_sample_size(weights: Float[np.ndarray, "*batch S"]) -> Float[np.ndarray, "*batch"]:
    """How many equal samples the weighted ones are worth, (Σ w)² / Σ w²; zero where all weights are zero.

    Args:
        weights: (…, S) weights, not negative; they need not sum to one.
    """
    largest = np.max(weights, axis=-1, keepdims=True, initial=0.0)
    scaled = weights / np.where(largest > 0, largest, 1.0)  # keeps tiny weights from underflow when squared
    squares = np.sum(scaled**2, axis=-1)
    return np.asarray(np.sum(scaled, axis=-1) ** 2 / np.where(squares > 0, squares, 1.0))


def is_moving(observed: Float[np.ndarray, "N 6 3"], dt: float, truth: Float[np.ndarray, "T 6 3"] | None = None) -> bool:
    """Whether a wrist's median speed over the window, from frame to frame, is above 0.3 m/s.

    The median, because noise, repeated frames and single jumps of the tracker would make the largest
    speed pass 0.3 m/s in most windows of a person at rest.

    Args:
        observed: (N, 6, 3) the window seen [m]; NaN where missing.
        dt: time between frames [s].
        truth: (T, 6, 3) the frames that followed, to be looked at as well [m].
    """
    motion = observed if truth is None else np.concatenate([observed, truth])
    for wrist in WRISTS:
        speeds = np.linalg.norm(np.diff(motion[:, wrist], axis=0), axis=-1) / dt
        seen = speeds[np.isfinite(speeds)]
        if len(seen) and np.median(seen) > MOVING_SPEED:
            return True
    return False


Ellipsoids = tuple[Float[np.ndarray, "K 3"], Float[np.ndarray, "K 3 3"], Float[np.ndarray, " K"], Int[np.ndarray, " K"]]
"""Of each cell (step and joint): mean, whitening matrix, log det of covariance, number of samples."""


def _cells(samples: Float[np.ndarray, "S T J 3"]) -> Float[np.ndarray, "K 3 R"]:
    """A copy with the samples of each cell (a step and joint) together, one contiguous row per coordinate.

    No samples at all become one that is absent.
    """
    present = samples if len(samples) else np.full((1, *samples.shape[1:]), np.nan)
    return np.array(present.transpose(1, 2, 3, 0), order="C").reshape(-1, 3, len(present))


def _ellipsoids(cells: Float[np.ndarray, "K 3 S"]) -> Ellipsoids:
    """Mean and covariance of each cell, the covariance's eigenvalues not under MINIMUM_SPREAD²."""
    mean, covariance, count = _moments(cells)
    eigenvalues, axes = np.linalg.eigh(covariance)
    eigenvalues = np.maximum(eigenvalues, MINIMUM_SPREAD**2)
    whitening = axes.transpose(0, 2, 1) / np.sqrt(eigenvalues)[:, :, None]
    return mean, whitening, np.log(eigenvalues).sum(axis=-1), count


# The kernels may add up in any order ("reassoc"), which lets them use vector instructions; NaN stay NaN.
# no_type_check: a test run that checks shapes must not wrap what numba compiles.


@njit(cache=True, fastmath={"reassoc"})
@no_type_check
def _crps_sorted(ordered, truth):
    """(R,) CRPS of R rows of sorted samples; a row's NaN stand at its end."""
    score = np.empty(len(ordered))
    for row in range(len(ordered)):
        count = ordered.shape[1]
        while count > 0 and np.isnan(ordered[row, count - 1]):
            count -= 1
        distance = 0.0
        spread = 0.0  # Σ_{i<j} |x_i − x_j| = Σ_i (2 i − n + 1) x_(i)
        for i in range(count):
            offset = ordered[row, i] - truth[row]
            distance += abs(offset)
            spread += (2 * i - count + 1) * offset
        score[row] = distance / count if count > 0 else np.nan
        if count > 1:
            score[row] -= spread / (count * (count - 1.0))
    return score


@njit(cache=True, fastmath={"reassoc"})
@no_type_check
def _energy(cells, truth, shifts):
    """(K,) energy scores; sample i is paired with i + 1 … i + shifts."""
    score = np.empty(len(cells))
    samples = cells.shape[2]
    for cell in range(len(cells)):
        x, y, z = cells[cell, 0], cells[cell, 1], cells[cell, 2]
        distance = 0.0
        count = 0
        for i in range(samples):
            away = np.sqrt((x[i] - truth[cell, 0]) ** 2 + (y[i] - truth[cell, 1]) ** 2 + (z[i] - truth[cell, 2]) ** 2)
            distance += away if away == away else 0.0
            count += 1 if away == away else 0
        spread = 0.0
        pairs = 0.0  # a float: vector instructions again
        for shift in range(1, shifts + 1):
            for i in range(samples - shift):
                j = i + shift
                gap = np.sqrt((x[i] - x[j]) ** 2 + (y[i] - y[j]) ** 2 + (z[i] - z[j]) ** 2)
                spread += gap if gap == gap else 0.0
                pairs += 1.0 if gap == gap else 0.0
        score[cell] = distance / count if count > 0 else np.nan
        if pairs > 0:
            score[cell] -= 0.5 * spread / pairs
    return score


@njit(cache=True, fastmath={"reassoc"})
@no_type_check
def _moments(cells):
    """(K, 3) means, (K, 3, 3) covariances and (K,) numbers of the samples that are there."""
    mean = np.zeros((len(cells), 3))
    covariance = np.zeros((len(cells), 3, 3))
    count = np.zeros(len(cells), np.int64)
    absent = np.empty(cells.shape[2], np.bool_)
    centred = np.empty(cells.shape[1:])
    for cell in range(len(cells)):
        for i in range(cells.shape[2]):
            absent[i] = not np.isfinite(cells[cell, 0, i] + cells[cell, 1, i] + cells[cell, 2, i])
        count[cell] = cells.shape[2] - absent.sum()
        for row in range(3):
            total = 0.0
            for i in range(cells.shape[2]):
                total += 0.0 if absent[i] else cells[cell, row, i]
            mean[cell, row] = total / count[cell] if count[cell] > 0 else np.nan
            for i in range(cells.shape[2]):
                centred[row, i] = 0.0 if absent[i] else cells[cell, row, i] - mean[cell, row]
            for column in range(row + 1):
                total = 0.0
                for i in range(cells.shape[2]):
                    total += centred[row, i] * centred[column, i]
                covariance[cell, row, column] = total / max(count[cell] - 1, 1)
                covariance[cell, column, row] = covariance[cell, row, column]
    return mean, covariance, count


@njit(cache=True, fastmath={"reassoc"})
@no_type_check
def _squared_distances(cells, point, whitening):
    """(K, S) squared Mahalanobis distances of each cell's samples from a point."""
    squared = np.zeros((len(cells), cells.shape[2]))
    for cell in range(len(cells)):
        for row in range(3):
            a, b, c = whitening[cell, row]
            shift = a * point[cell, 0] + b * point[cell, 1] + c * point[cell, 2]
            for i in range(cells.shape[2]):
                along = a * cells[cell, 0, i] + b * cells[cell, 1, i] + c * cells[cell, 2, i] - shift
                squared[cell, i] += along * along
    return squared
