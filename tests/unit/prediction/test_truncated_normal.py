"""The truncated normal against scipy where scipy holds, against exact arithmetic and asymptotics where it does not."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from scipy import integrate, stats

from kinecast.prediction.truncated_normal import (
    keep_or_redraw,
    log_pdf,
    log_survival,
    mills_ratio,
    noisy_log_pdf,
    sample,
    tail_offset,
)

# Mean, sd, lower, upper, within reach of scipy's own truncnorm.
MODERATE = (
    (0.0, 1.0, -1.0, 2.0),
    (0.3, 2.0, -1.0, 2.0),
    (-1.0, 0.5, -0.5, 3.0),
    (5.0, 1.5, 1.0, 3.0),
    (0.0, 1.0, -math.inf, 1.0),
    (0.0, 1.0, -3.0, math.inf),
    (0.2, 0.7, -math.inf, math.inf),
)
FAR = ((0.0, 1.0, 40.0, 41.0), (0.0, 1e-3, 1.0, 1.0001), (0.0, 1.0, -90.0, -40.0), (-1.0, 1e-6, 0.0, math.inf))
NARROW = ((0.0, 1.0, -1e-3, 2e-3), (0.0, 1.0, 2.0, 2.0 + 1e-9), (0.0, 1e6, -1e-3, 2e-3))
ROOT_2PI = math.sqrt(2 * math.pi)
# log Φ(−c − t) − log Φ(−c), computed with mpmath at 60 digits.
SURVIVALS = (
    (0.0, 1e-06, -7.978848791127878e-07),
    (0.0, 3.0, -5.914579040950405),
    (0.5, 9e-05, -0.00010269996200723292),
    (5.0, 0.00011, -0.0005705212885728147),
    (9.99, 0.0002, -0.0020176573661658216),
    (10.01, 0.1, -1.015753044102003),
    (40.0, 0.001, -0.040025468535878246),
    (300.0, 0.01, -3.0000833320371276),
    (1e4, 1e-05, -0.10000000104999998),
    (1e6, 2e-06, -2.000000000004),
)


def support(parameters: tuple[float, ...]) -> tuple[float, float]:
    """Where all but 1e-16 of the mass lies."""
    return sample(1e-16, *parameters), sample(1 - 1e-16, *parameters)


@pytest.mark.parametrize(("c", "t", "log_share"), SURVIVALS)
def test_survival_in_a_tail_and_its_inverse_equal_exact_arithmetic(c: float, t: float, log_share: float) -> None:
    assert log_survival(c, t) == pytest.approx(log_share, rel=1e-11, abs=0.0)
    assert tail_offset(c, -log_share) == pytest.approx(t, rel=1e-11, abs=0.0)


def test_tails_at_their_limits() -> None:
    assert mills_ratio(math.nextafter(10.0, 0.0)) == pytest.approx(mills_ratio(10.0), rel=2e-14)
    assert log_survival(3.0, math.inf) == -math.inf
    assert tail_offset(3.0, 0.0) == 0.0
    assert tail_offset(3.0, math.inf) == math.inf
    assert tail_offset(math.inf, 1.0) == 0.0
    assert math.isnan(tail_offset(3.0, math.nan))


@pytest.mark.parametrize("parameters", MODERATE)
def test_quantile_and_density_equal_scipy_in_moderate_ranges(parameters: tuple[float, ...]) -> None:
    mean, sd, lower, upper = parameters
    peer = stats.truncnorm((lower - mean) / sd, (upper - mean) / sd, loc=mean, scale=sd)
    for u in (1e-6, 0.1, 0.5, 0.77, 1 - 1e-6):
        x = sample(u, *parameters)
        assert x == pytest.approx(peer.ppf(u), rel=1e-9, abs=1e-9)
        assert log_pdf(x, *parameters) == pytest.approx(peer.logpdf(x), abs=1e-11)


@pytest.mark.parametrize("parameters", MODERATE + FAR + NARROW)
def test_density_integrates_to_one_and_to_the_quantile(parameters: tuple[float, ...]) -> None:
    start, end = support(parameters)
    middle = sample(0.5, *parameters)
    mass = [
        integrate.quad(lambda x: math.exp(log_pdf(x, *parameters)), a, b, epsabs=0, epsrel=1e-10, limit=200)[0]
        for a, b in ((start, middle), (middle, end))
    ]
    # 1 + 1e-12 has 1e-4 of its digits: the median itself is rounded there.
    rounding = math.exp(log_pdf(middle, *parameters)) * np.spacing(abs(middle))
    assert sum(mass) == pytest.approx(1.0, abs=1e-8 + 4 * rounding)
    assert mass[0] == pytest.approx(0.5, abs=1e-8 + 4 * rounding)


@pytest.mark.parametrize("sigmas", [40.0, 1e3, 1e6])
@pytest.mark.parametrize("u", [1e-9, 0.1, 0.5, 0.9, 1 - 1e-6])
def test_far_tail_is_an_exponential(sigmas: float, u: float) -> None:
    """Beyond c σ the overshoot times c is Exp(1), with corrections of order 1/c²."""
    exponential = -math.log1p(-u)
    series = exponential - (exponential + exponential**2 / 2) / sigmas**2
    found = sample(u, -sigmas, 1.0, 0.0, math.inf)
    assert found * sigmas == pytest.approx(series, rel=200 / sigmas**4 + 1e-11)
    assert sample(1 - u, sigmas, 1.0, -math.inf, 0.0) == pytest.approx(-found, rel=1e-6)


def test_a_point_mass_where_sd_is_zero_or_bounds_meet() -> None:
    for u in (0.0, 0.3, 1.0):
        assert sample(u, 0.5, 0.0, 0.0, 1.0) == 0.5
        assert sample(u, 7.0, 0.0, 0.0, 1.0) == 1.0
        assert sample(u, 7.0, 2.0, 0.25, 0.25) == 0.25
    assert log_pdf(0.25, 7.0, 2.0, 0.25, 0.25) == math.inf
    assert log_pdf(0.3, 0.25, 0.0, 0.0, 1.0) == -math.inf
    assert noisy_log_pdf(0.3, 7.0, 0.0, 0.0, 0.25, 0.1) == pytest.approx(stats.norm.logpdf(0.3, 0.25, 0.1))


def test_outside_the_bounds_nothing_is_possible_ends_are_reached_and_nan_goes_through() -> None:
    assert log_pdf(1.0001, 0.0, 1.0, -1.0, 1.0) == -math.inf
    assert log_pdf(-1.0001, 0.0, 1.0, -1.0, 1.0) == -math.inf
    for mean in (-50.0, 0.0, 50.0):
        assert sample(0.0, mean, 1.0, -1.0, 1.0) == pytest.approx(-1.0, abs=1e-14)
        assert sample(1.0, mean, 1.0, -1.0, 1.0) == pytest.approx(1.0, abs=1e-14)
    assert math.isnan(sample(0.5, math.nan, 1.0, 0.0, 1.0))
    assert math.isnan(sample(math.nan, 0.0, 1.0, 0.0, 1.0))
    assert math.isnan(keep_or_redraw(math.nan, 0.5, math.nan, 1.0, 0.0, 1.0))


def test_a_draw_inside_is_kept_and_one_outside_is_redrawn() -> None:
    assert keep_or_redraw(0.7, 0.2, 0.0, 1.0, -1.0, 1.0) == 0.7
    assert keep_or_redraw(1.0, 0.2, 0.0, 1.0, -1.0, 1.0) == 1.0
    assert keep_or_redraw(1.1, 0.2, 0.0, 1.0, -1.0, 1.0) == sample(0.2, 0.0, 1.0, -1.0, 1.0)


@pytest.mark.parametrize("parameters", MODERATE + FAR[:3])
@pytest.mark.parametrize("noise", [1e-3, 0.1, 3.0])
def test_noisy_density_equals_the_integral_over_the_true_value(parameters: tuple[float, ...], noise: float) -> None:
    start, end = support(parameters)
    for y in (sample(0.01, *parameters) - noise, sample(0.3, *parameters), sample(0.99, *parameters) + noise):

        def integrand(x: float, y: float = y) -> float:
            return math.exp(log_pdf(x, *parameters) - 0.5 * ((y - x) / noise) ** 2) / (noise * ROOT_2PI)

        breaks = np.clip(y + noise * np.array([-8, -2, 0, 2, 8]), start, end)
        edges = np.unique(np.concatenate([np.linspace(start, end, 9), breaks]))
        pieces = [integrate.quad(integrand, a, b, epsabs=0)[0] for a, b in pairwise(edges)]
        assert noisy_log_pdf(y, *parameters, noise) == pytest.approx(math.log(sum(pieces)), abs=1e-6)


@pytest.mark.parametrize("parameters", FAR + NARROW)
@pytest.mark.parametrize("noise", [1e-7, 0.02, 30.0])
def test_noisy_density_integrates_to_one(parameters: tuple[float, ...], noise: float) -> None:
    start, end = support(parameters)
    edges = [start - 12 * noise, start + 0.1 * (end - start), start + 0.5 * (end - start), end + 12 * noise]
    edges += [edge + offset for edge in (start, end) for offset in (-2 * noise, 0.0, 2 * noise)]
    nodes, weights = np.polynomial.legendre.leggauss(200)
    total = 0.0
    for a, b in pairwise(np.unique(edges)):
        density = [math.exp(noisy_log_pdf(y, *parameters, noise)) for y in 0.5 * (a + b) + 0.5 * (b - a) * nodes]
        total += 0.5 * (b - a) * float(np.dot(weights, density))
    assert total == pytest.approx(1.0, abs=1e-6)


def test_noisy_density_at_its_limits() -> None:
    for parameters in MODERATE + FAR[:1]:
        x = sample(0.4, *parameters)
        exact = log_pdf(x, *parameters)
        assert noisy_log_pdf(x, *parameters, 0.0) == exact
        assert noisy_log_pdf(x, *parameters, 1e-9) == pytest.approx(exact, abs=1e-6)
    assert noisy_log_pdf(3.0, *MODERATE[0], 0.0) == -math.inf
    # Without bounds it is the sum of two normals; with the mean far outside, the bound plus noise.
    expected = stats.norm.logpdf(1.7, 0.2, math.hypot(0.7, 0.4))
    assert noisy_log_pdf(1.7, 0.2, 0.7, -math.inf, math.inf, 0.4) == pytest.approx(expected, rel=1e-14)
    assert noisy_log_pdf(1.7, 0.2, 1e-12, -9.0, 9.0, 0.4) == pytest.approx(stats.norm.logpdf(1.7, 0.2, 0.4))
    a_million_out = noisy_log_pdf(1.003, 0.0, 1e-6, 1.0, 2.0, 0.01)
    assert a_million_out == pytest.approx(stats.norm.logpdf(1.003, 1.0, 0.01), abs=1e-6)
