"""The truncated normal against scipy where scipy holds, against exact arithmetic and asymptotics where it does not."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from scipy import integrate, stats

from kinecast.errors import OptionError
from kinecast.prediction.truncated_normal import (
    TruncatedNormal,
    keep_or_redraw,
    log_cdf,
    log_mass,
    log_pdf,
    moments,
    noisy_log_pdf,
    sample,
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
ROOT_2PI = math.sqrt(2 * math.pi)
NARROW = ((0.0, 1.0, -1e-3, 2e-3), (0.0, 1.0, 2.0, 2.0 + 1e-9), (0.0, 1e6, -1e-3, 2e-3))


def scipy_truncated(mean: float, sd: float, lower: float, upper: float) -> object:
    """scipy's truncated normal in our parameters."""
    return stats.truncnorm((lower - mean) / sd, (upper - mean) / sd, loc=mean, scale=sd)


def support(mean: float, sd: float, lower: float, upper: float) -> tuple[float, float]:
    """Where all but 1e-16 of the mass lies."""
    return sample(1e-16, mean, sd, lower, upper), sample(1 - 1e-16, mean, sd, lower, upper)


@pytest.mark.parametrize("parameters", MODERATE)
def test_everything_equals_scipy_in_moderate_ranges(parameters: tuple[float, ...]) -> None:
    peer = scipy_truncated(*parameters)
    for u in (1e-6, 0.1, 0.5, 0.77, 1 - 1e-6):
        x = sample(u, *parameters)
        assert x == pytest.approx(peer.ppf(u), rel=1e-9, abs=1e-9)
        assert log_pdf(x, *parameters) == pytest.approx(peer.logpdf(x), abs=1e-11)
        assert log_cdf(x, *parameters) == pytest.approx(peer.logcdf(x), abs=1e-9)
    assert moments(*parameters) == pytest.approx((peer.mean(), peer.var()), abs=1e-12)


@pytest.mark.parametrize(
    ("parameters", "expected"),  # computed with mpmath at 30 digits
    [
        ((0.0, 1.0, 6.0, 6.5), (6.137740433344353, 0.013551654390719715)),
        ((0.0, 1.0, 40.0, 41.0), (40.02496884720726, 0.0006226683785913863)),
        ((0.0, 1e-3, 1.0, 1.0001), (1.000000999998, 9.99994000049999e-13)),
        ((0.0, 1.0, -1e-3, 2e-3), (0.0004999996250001125, 7.499997749999398e-07)),
        ((0.0, 1.0, -3.0, 30.0), (0.004437839042125664, 0.9866667884582592)),
        ((2.0, 0.5, 2.0, 2.001), (2.0004999998333335, 8.333332222218773e-08)),
    ],
)
def test_moments_equal_exact_arithmetic(parameters: tuple[float, ...], expected: tuple[float, float]) -> None:
    mean, variance = moments(*parameters)
    mirrored = moments(-parameters[0], parameters[1], -parameters[3], -parameters[2])
    assert mean == pytest.approx(expected[0], rel=1e-14)
    assert variance == pytest.approx(expected[1], rel=1e-10)
    assert mirrored == pytest.approx((-mean, variance), rel=1e-12)


@pytest.mark.parametrize("parameters", MODERATE + FAR + NARROW)
def test_density_integrates_to_one_and_to_the_cdf(parameters: tuple[float, ...]) -> None:
    start, end = support(*parameters)
    middle = sample(0.5, *parameters)
    mass = [
        integrate.quad(lambda x: math.exp(log_pdf(x, *parameters)), a, b, epsabs=0, epsrel=1e-10, limit=200)[0]
        for a, b in ((start, middle), (middle, end))
    ]
    # 1 + 1e-12 has 1e-4 of its digits: the median itself is rounded there.
    rounding = math.exp(log_pdf(middle, *parameters)) * np.spacing(abs(middle))
    assert sum(mass) == pytest.approx(1.0, abs=1e-8 + 4 * rounding)
    assert mass[0] == pytest.approx(0.5, abs=1e-8 + 4 * rounding)
    assert math.exp(log_cdf(middle, *parameters)) == pytest.approx(0.5, abs=1e-9 + 4 * rounding)


@pytest.mark.parametrize("sigmas", [40.0, 1e3, 1e6])
def test_far_tail_is_an_exponential(sigmas: float) -> None:
    """Beyond c σ the overshoot times c is Exp(1), with corrections of order 1/c²."""
    u = np.array([1e-9, 0.1, 0.5, 0.9, 1 - 1e-6])
    overshoot = TruncatedNormal(
        np.array(-sigmas), np.array(1.0), np.array(0.0), np.array(math.inf)
    ).sample(u) * sigmas  # fmt: skip
    exponential = -np.log1p(-u)
    series = exponential - (exponential + exponential**2 / 2) / sigmas**2
    np.testing.assert_allclose(overshoot, series, rtol=200 / sigmas**4 + 1e-11)
    mean, variance = moments(-sigmas, 1.0, 0.0, math.inf)
    assert mean * sigmas == pytest.approx(1 - 2 / sigmas**2, rel=20 / sigmas**4 + 1e-12)
    assert variance * sigmas**2 == pytest.approx(1 - 6 / sigmas**2, rel=80 / sigmas**4 + 1e-12)


def test_a_point_mass_where_sd_is_zero_or_bounds_meet() -> None:
    for u in (0.0, 0.3, 1.0):
        assert sample(u, 0.5, 0.0, 0.0, 1.0) == 0.5
        assert sample(u, 7.0, 0.0, 0.0, 1.0) == 1.0
        assert sample(u, 7.0, 2.0, 0.25, 0.25) == 0.25
    assert moments(7.0, 2.0, 0.25, 0.25) == (0.25, 0.0)
    assert moments(-7.0, 0.0, 0.25, 0.5) == (0.25, 0.0)
    assert log_pdf(0.25, 7.0, 2.0, 0.25, 0.25) == math.inf
    assert log_pdf(0.3, 0.25, 0.0, 0.0, 1.0) == -math.inf
    assert log_cdf(0.2, 0.25, 0.0, 0.0, 1.0) == -math.inf
    assert log_cdf(0.25, 0.25, 0.0, 0.0, 1.0) == 0.0
    assert noisy_log_pdf(0.3, 7.0, 0.0, 0.0, 0.25, 0.1) == pytest.approx(stats.norm.logpdf(0.3, 0.25, 0.1))


def test_outside_the_bounds_nothing_is_possible_and_ends_are_reached() -> None:
    assert log_pdf(1.0001, 0.0, 1.0, -1.0, 1.0) == -math.inf
    assert log_pdf(-1.0001, 0.0, 1.0, -1.0, 1.0) == -math.inf
    assert log_cdf(-1.0, 0.0, 1.0, -1.0, 1.0) == -math.inf
    assert log_cdf(1.0, 0.0, 1.0, -1.0, 1.0) == 0.0
    for mean in (-50.0, 0.0, 50.0):
        assert sample(0.0, mean, 1.0, -1.0, 1.0) == pytest.approx(-1.0, abs=1e-14)
        assert sample(1.0, mean, 1.0, -1.0, 1.0) == pytest.approx(1.0, abs=1e-14)


def test_nan_goes_through() -> None:
    assert math.isnan(sample(0.5, math.nan, 1.0, 0.0, 1.0))
    assert math.isnan(sample(math.nan, 0.0, 1.0, 0.0, 1.0))
    assert math.isnan(keep_or_redraw(math.nan, 0.5, math.nan, 1.0, 0.0, 1.0))


def test_log_mass_is_the_difference_of_two_distribution_functions() -> None:
    for a, b in ((-1.0, 2.0), (-math.inf, -3.0), (3.0, math.inf), (0.5, 0.7), (-8.0, -7.5)):
        exact = stats.norm.cdf(b) - stats.norm.cdf(a) if b < 3 else stats.norm.sf(a) - stats.norm.sf(b)
        assert log_mass(0.0, 1.0, a, b) == pytest.approx(math.log(exact), rel=1e-12)
    for a, b in ((-41.0, -40.0), (-40.0, -math.inf), (-300.0, -299.999)):
        low, high = sorted((a, b))
        logs = stats.norm.logcdf([low, high])
        expected = logs[1] + math.log(-math.expm1(logs[0] - logs[1]))
        assert log_mass(0.0, 1.0, low, high) == pytest.approx(expected, rel=1e-10)
        assert log_mass(0.0, 1.0, -high, -low) == pytest.approx(expected, rel=1e-10)
    assert log_mass(0.0, 1.0, 1.0, 1.0) == -math.inf


@pytest.mark.parametrize("parameters", MODERATE + FAR[:3])
@pytest.mark.parametrize("noise", [1e-3, 0.1, 3.0])
def test_noisy_density_equals_the_integral_over_the_true_value(parameters: tuple[float, ...], noise: float) -> None:
    start, end = support(*parameters)
    for y in (sample(0.01, *parameters) - noise, sample(0.3, *parameters), sample(0.99, *parameters) + noise):

        def integrand(x: float, y: float = y) -> float:
            return math.exp(log_pdf(x, *parameters) - 0.5 * ((y - x) / noise) ** 2) / (noise * ROOT_2PI)

        breaks = np.clip(y + noise * np.array([-8, -2, 0, 2, 8]), start, end)
        edges = np.unique(np.concatenate([np.linspace(start, end, 9), breaks]))
        pieces = [integrate.quad(integrand, a, b, epsabs=0)[0] for a, b in pairwise(edges)]
        assert noisy_log_pdf(y, *parameters, noise) == pytest.approx(math.log(sum(pieces)), abs=1e-6)


@pytest.mark.parametrize("parameters", MODERATE + FAR + NARROW)
@pytest.mark.parametrize("noise", [1e-7, 0.02, 30.0])
def test_noisy_density_integrates_to_one(parameters: tuple[float, ...], noise: float) -> None:
    start, end = support(*parameters)
    spread = end - start
    edges = [start - 12 * noise, start, start + 0.1 * spread, start + 0.5 * spread, end, end + 12 * noise]
    edges += [edge + offset for edge in (start, end) for offset in (-2 * noise, 2 * noise)]
    edges = np.unique(edges)
    total = 0.0
    nodes, weights = np.polynomial.legendre.leggauss(200)
    for a, b in pairwise(edges):
        y = 0.5 * (a + b) + 0.5 * (b - a) * nodes
        density = [math.exp(noisy_log_pdf(value, *parameters, noise)) for value in y]
        total += 0.5 * (b - a) * float(np.dot(weights, density))
    assert total == pytest.approx(1.0, abs=1e-6)


def test_noisy_density_without_noise_or_with_vanishing_noise_is_the_density() -> None:
    for parameters in MODERATE + FAR[:1]:
        x = sample(0.4, *parameters)
        exact = log_pdf(x, *parameters)
        assert noisy_log_pdf(x, *parameters, 0.0) == exact
        assert noisy_log_pdf(x, *parameters, 1e-9) == pytest.approx(exact, abs=1e-6)
    assert noisy_log_pdf(3.0, *MODERATE[0], 0.0) == -math.inf


def test_noisy_density_without_bounds_is_the_sum_of_two_normals() -> None:
    expected = stats.norm.logpdf(1.7, 0.2, math.hypot(0.7, 0.4))
    assert noisy_log_pdf(1.7, 0.2, 0.7, -math.inf, math.inf, 0.4) == pytest.approx(expected, rel=1e-14)
    assert noisy_log_pdf(1.7, 0.2, 1e-12, -9.0, 9.0, 0.4) == pytest.approx(stats.norm.logpdf(1.7, 0.2, 0.4))


def test_noisy_density_stays_finite_a_million_sigma_out() -> None:
    """Mean far outside the bounds: X sits at the bound, so y is the bound plus noise."""
    value = noisy_log_pdf(1.003, 0.0, 1e-6, 1.0, 2.0, 0.01)
    assert value == pytest.approx(stats.norm.logpdf(1.003, 1.0, 0.01), abs=1e-6)


def test_a_draw_inside_is_kept_and_one_outside_is_redrawn() -> None:
    assert keep_or_redraw(0.7, 0.2, 0.0, 1.0, -1.0, 1.0) == 0.7
    assert keep_or_redraw(1.0, 0.2, 0.0, 1.0, -1.0, 1.0) == 1.0
    assert keep_or_redraw(1.1, 0.2, 0.0, 1.0, -1.0, 1.0) == sample(0.2, 0.0, 1.0, -1.0, 1.0)


def test_the_array_form_broadcasts_and_agrees_with_the_kernels() -> None:
    location = np.array([[0.0], [30.0], [-2.0]])
    upper = np.array([1.0, 2.0])
    many = TruncatedNormal(location, np.array(0.8), np.array(-1.0), upper)
    x = many.sample(0.35)
    assert x.shape == (3, 2)
    for i, mean in enumerate(location[:, 0]):
        for j, bound in enumerate(upper):
            one = (mean, 0.8, -1.0, bound)
            assert x[i, j] == sample(0.35, *one)
            assert many.log_pdf(x)[i, j] == log_pdf(x[i, j], *one)
            assert many.cdf(x)[i, j] == pytest.approx(0.35, abs=1e-12)
            assert many.noisy_log_pdf(x, 0.1)[i, j] == noisy_log_pdf(x[i, j], *one, 0.1)
            assert (many.mean[i, j], many.variance[i, j]) == moments(*one)
    empty = TruncatedNormal(np.empty(0), np.empty(0), np.empty(0), np.empty(0))
    assert empty.sample(np.empty(0)).shape == (0,)


@pytest.mark.parametrize(
    ("location", "scale", "lower", "upper", "message"),
    [
        (math.nan, 1.0, 0.0, 1.0, "location"),
        (0.0, -1.0, 0.0, 1.0, "scale"),
        (0.0, math.inf, 0.0, 1.0, "scale"),
        (0.0, 1.0, 1.0, 0.0, "bounds"),
        (0.0, 1.0, math.nan, 0.0, "bounds"),
    ],
)
def test_bad_parameters_are_named(location: float, scale: float, lower: float, upper: float, message: str) -> None:
    with pytest.raises(OptionError, match=message):
        TruncatedNormal(np.array(location), np.array(scale), np.array(lower), np.array(upper))
