"""Draws from truncated normals against their law, by Kolmogorov–Smirnov at a chance of 1e-6 to fail by luck."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from scipy import integrate, stats

from kinecast.prediction.truncated_normal import keep_or_redraw, noisy_log_pdf, sample

DRAWS = 40_000
LIMIT = stats.kstwobign.isf(1e-6) / math.sqrt(DRAWS)


def discrepancy(draws: np.ndarray, cdf: Callable[[np.ndarray], np.ndarray]) -> float:
    """Kolmogorov–Smirnov distance of draws from a distribution function."""
    below = cdf(np.sort(draws))
    steps = np.arange(len(draws) + 1) / len(draws)
    return float(max(np.max(steps[1:] - below), np.max(below - steps[:-1])))


def drawn(rng: np.random.Generator, mean: float, sd: float, lower: float, upper: float) -> np.ndarray:
    """As a rollout draws: a normal draw where it keeps its bounds, else the quantile."""
    normal, uniform = mean + sd * rng.standard_normal(DRAWS), rng.random(DRAWS)
    return np.array([keep_or_redraw(z, u, mean, sd, lower, upper) for z, u in zip(normal, uniform, strict=True)])


@pytest.mark.parametrize(
    ("mean", "sd", "lower", "upper"),
    [
        (0.0, 1.0, -1.0, 2.0),
        (2.0, 0.5, 0.0, 1.5),
        (0.0, 1.0, 4.0, 5.0),
        (1.0, 3.0, -math.inf, 0.0),
        (0.2, 0.8, 1.5, 4.0),
        (0.2, 0.8, -9.0, 9.0),
    ],
)
def test_draws_follow_scipys_truncated_normal(mean: float, sd: float, lower: float, upper: float) -> None:
    rng = np.random.default_rng(1)
    quantiles = np.array([sample(u, mean, sd, lower, upper) for u in rng.random(DRAWS)])
    peer = stats.truncnorm((lower - mean) / sd, (upper - mean) / sd, loc=mean, scale=sd)
    assert discrepancy(quantiles, peer.cdf) < LIMIT
    assert discrepancy(drawn(rng, mean, sd, lower, upper), peer.cdf) < LIMIT


@pytest.mark.parametrize("sigmas", [100.0, 1e5])
@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_draws_far_out_are_exponential(sigmas: float, side: float) -> None:
    sd = 0.01
    lower, upper = (0.0, math.inf) if side > 0 else (-math.inf, 0.0)
    draws = drawn(np.random.default_rng(2), -side * sigmas * sd, sd, lower, upper)
    # The law differs from the exponential by less than 2 / sigmas² anywhere.
    assert discrepancy(side * draws * sigmas / sd, stats.expon.cdf) < LIMIT + 2 / sigmas**2


@pytest.mark.parametrize(("mean", "noise"), [(0.0, 0.3), (-5.0, 0.05), (30.0, 0.2)])
def test_noisy_draws_follow_the_noisy_density(mean: float, noise: float) -> None:
    rng = np.random.default_rng(4)
    sd, lower, upper = 0.7, -0.5, 1.0
    draws = drawn(rng, mean, sd, lower, upper) + noise * rng.standard_normal(DRAWS)
    grid = np.linspace(lower - 9 * noise, upper + 9 * noise, 4001)
    density = np.exp([noisy_log_pdf(y, mean, sd, lower, upper, noise) for y in grid])
    cumulative = integrate.cumulative_simpson(density, x=grid, initial=0.0)
    assert cumulative[-1] == pytest.approx(1.0, abs=1e-7)
    assert discrepancy(draws, lambda y: np.interp(y, grid, cumulative)) < LIMIT + 1e-4
