"""Tails of the standard normal against scipy, and against 60-digit arithmetic where scipy has no counterpart."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import special

from kinecast.prediction.normal_tails import log_ndtr, log_survival, mills_ratio, ndtri_exp, tail_offset

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


def test_log_ndtr_equals_scipy_from_minus_a_million_to_thirty_sigma() -> None:
    points = np.concatenate([-np.logspace(6, -3, 200), [0.0], np.logspace(-3, 1.47, 100)])
    ours = np.array([log_ndtr(x) for x in points])
    np.testing.assert_allclose(ours, special.log_ndtr(points), rtol=1e-13)


def test_log_ndtr_at_its_limits() -> None:
    assert log_ndtr(-math.inf) == -math.inf
    assert log_ndtr(math.inf) == 0.0
    assert math.isnan(log_ndtr(math.nan))


def test_mills_ratio_is_smooth_where_its_two_forms_meet() -> None:
    below, above = mills_ratio(math.nextafter(10.0, 0.0)), mills_ratio(10.0)
    assert below == pytest.approx(above, rel=2e-14)


@pytest.mark.parametrize(("c", "t", "expected"), SURVIVALS)
def test_log_survival_equals_exact_arithmetic(c: float, t: float, expected: float) -> None:
    assert log_survival(c, t) == pytest.approx(expected, rel=1e-11, abs=0.0)


@pytest.mark.parametrize(("c", "t", "log_share"), SURVIVALS)
def test_tail_offset_inverts_log_survival(c: float, t: float, log_share: float) -> None:
    assert tail_offset(c, -log_share) == pytest.approx(t, rel=1e-11, abs=0.0)


def test_tail_offset_at_its_limits() -> None:
    assert tail_offset(3.0, 0.0) == 0.0
    assert tail_offset(3.0, math.inf) == math.inf
    assert tail_offset(math.inf, 1.0) == 0.0
    assert math.isnan(tail_offset(3.0, math.nan))


def test_ndtri_exp_equals_scipy_over_the_whole_range() -> None:
    logp = -np.concatenate([np.logspace(-300, -1, 300), np.logspace(-1, 4, 300), [1e8, 1e15]])
    ours = np.array([ndtri_exp(value) for value in logp])
    conditioning = np.finfo(float).eps * np.abs(logp)  # of x near the median, where x is 0 and log p is not
    np.testing.assert_array_less(
        np.abs(ours - special.ndtri_exp(logp)), 1e-12 * np.abs(ours) + 4 * conditioning * (logp > -2)
    )


def test_ndtri_exp_inverts_log_ndtr() -> None:
    points = np.concatenate([-np.logspace(5, -2, 200), np.linspace(0.01, 5, 50)])
    back = np.array([ndtri_exp(log_ndtr(x)) for x in points])
    # Above the median log Φ carries ever less of x: its rounding times dx/dlog Φ.
    loss = np.exp(special.log_ndtr(points) + points**2 / 2) * np.sqrt(2 * np.pi) * 2e-16
    np.testing.assert_array_less(np.abs(back - points), 2e-13 * np.abs(points) + 4 * loss)


def test_ndtri_exp_at_its_limits() -> None:
    assert ndtri_exp(-math.inf) == -math.inf
    assert ndtri_exp(0.0) == math.inf
    assert math.isnan(ndtri_exp(1e-3))
    assert math.isnan(ndtri_exp(math.nan))
