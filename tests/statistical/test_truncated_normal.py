"""Draws from truncated normals against their law, by Kolmogorov–Smirnov at a chance of 1e-6 to fail by luck."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from scipy import integrate, stats

from kinecast.prediction.truncated_normal import TruncatedNormal, draw, keep_or_redraw, noisy_log_pdf

DRAWS = 40_000
LIMIT = stats.kstwobign.isf(1e-6) / math.sqrt(DRAWS)


def discrepancy(draws: np.ndarray, cdf: Callable[[np.ndarray], np.ndarray]) -> float:
    """Kolmogorov–Smirnov distance of draws from a distribution function."""
    below = cdf(np.sort(draws))
    steps = np.arange(len(draws) + 1) / len(draws)
    return float(max(np.max(steps[1:] - below), np.max(below - steps[:-1])))


def truncated(mean: float, sd: float, lower: float, upper: float) -> TruncatedNormal:
    return TruncatedNormal(np.array(mean), np.array(sd), np.array(lower), np.array(upper))


@pytest.mark.parametrize(
    ("mean", "sd", "lower", "upper"),
    [(0.0, 1.0, -1.0, 2.0), (2.0, 0.5, 0.0, 1.5), (0.0, 1.0, 4.0, 5.0), (1.0, 3.0, -math.inf, 0.0)],
)
def test_draws_follow_scipys_truncated_normal(mean: float, sd: float, lower: float, upper: float) -> None:
    rng = np.random.default_rng(1)
    draws = truncated(mean, sd, lower, upper).sample(rng.random(DRAWS))
    peer = stats.truncnorm((lower - mean) / sd, (upper - mean) / sd, loc=mean, scale=sd)
    assert discrepancy(draws, peer.cdf) < LIMIT


@pytest.mark.parametrize("sigmas", [100.0, 1e5])
@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_draws_far_out_are_exponential(sigmas: float, side: float) -> None:
    rng = np.random.default_rng(2)
    sd = 0.01
    lower, upper = (0.0, math.inf) if side > 0 else (-math.inf, 0.0)
    draws = truncated(-side * sigmas * sd, sd, lower, upper).sample(rng.random(DRAWS))
    # The law differs from the exponential by less than 2 / sigmas² anywhere.
    assert discrepancy(side * draws * sigmas / sd, stats.expon.cdf) < LIMIT + 2 / sigmas**2


@pytest.mark.parametrize(("lower", "upper"), [(-0.4, 1.0), (0.5, 0.9), (1.5, 4.0), (-9.0, 9.0)])
def test_keep_or_redraw_has_the_law_of_the_truncated_normal(lower: float, upper: float) -> None:
    rng = np.random.default_rng(3)
    mean, sd = 0.2, 0.8
    normal, uniform = mean + sd * rng.standard_normal(DRAWS), rng.random(DRAWS)
    draws = np.array([keep_or_redraw(z, u, mean, sd, lower, upper) for z, u in zip(normal, uniform, strict=True)])
    peer = stats.truncnorm((lower - mean) / sd, (upper - mean) / sd, loc=mean, scale=sd)
    assert discrepancy(draws, peer.cdf) < LIMIT


@pytest.mark.parametrize(
    ("mean", "sd", "lower", "upper"),
    [
        (0.0, 1.0, -0.4, 0.4),  # flat between its bounds: accepted at once
        (1.0, 0.5, 0.2, 0.8),
        (-1.0, 0.5, 0.2, 0.5),
        (0.0, 1.0, -1.7, 1.7),  # as steep as is accepted
        (0.3, 1.0, -2.0, 4.0),  # the quantile
        (0.0, 1.0, 4.0, 5.0),
        (0.0, 1.0, -math.inf, -1.0),
        (0.0, 1.0, -math.inf, math.inf),
    ],
)
def test_seeded_draws_follow_scipys_truncated_normal(mean: float, sd: float, lower: float, upper: float) -> None:
    seeds = np.random.default_rng(5).integers(0, 2**64, size=DRAWS, dtype=np.uint64)
    draws = np.array([draw(seed, mean, sd, lower, upper) for seed in seeds])
    assert draws.min() >= lower
    assert draws.max() <= upper
    peer = stats.truncnorm((lower - mean) / sd, (upper - mean) / sd, loc=mean, scale=sd)
    assert discrepancy(draws, peer.cdf) < LIMIT


@pytest.mark.parametrize(
    ("mean", "sd", "lower", "upper"), [(0.5, 0.0, 0.0, 1.0), (2.0, 0.0, 0.0, 1.0), (0.3, 1.0, 0.7, 0.7)]
)
def test_a_point_mass_is_drawn_as_it_is(mean: float, sd: float, lower: float, upper: float) -> None:
    assert draw(np.uint64(1), mean, sd, lower, upper) == min(max(mean, lower), upper)


@pytest.mark.parametrize(("mean", "noise"), [(0.0, 0.3), (-5.0, 0.05), (30.0, 0.2)])
def test_noisy_draws_follow_the_noisy_density(mean: float, noise: float) -> None:
    rng = np.random.default_rng(4)
    sd, lower, upper = 0.7, -0.5, 1.0
    draws = truncated(mean, sd, lower, upper).sample(rng.random(DRAWS)) + noise * rng.standard_normal(DRAWS)
    grid = np.linspace(lower - 9 * noise, upper + 9 * noise, 4001)
    density = np.exp([noisy_log_pdf(y, mean, sd, lower, upper, noise) for y in grid])
    cumulative = integrate.cumulative_simpson(density, x=grid, initial=0.0)
    assert cumulative[-1] == pytest.approx(1.0, abs=1e-7)
    assert discrepancy(draws, lambda y: np.interp(y, grid, cumulative)) < LIMIT + 1e-4
