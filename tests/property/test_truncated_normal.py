"""Truncated normals anywhere: bounds from inside the bulk to 10,000 σ away, widths from 1e-9 σ to infinite."""

from __future__ import annotations

import math

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import ndtr

from kinecast.prediction.truncated_normal import keep_or_redraw, log_pdf, log_survival, noisy_log_pdf, sample

means = st.floats(-100.0, 100.0)
spreads = st.floats(-6.0, 3.0).map(lambda power: 10.0**power)
sigmas_away = st.one_of(st.floats(-45.0, 45.0), st.floats(-1e4, 1e4))
widths = st.one_of(st.just(math.inf), st.just(0.0), st.floats(-9.0, 4.0).map(lambda power: 10.0**power))
uniforms = st.one_of(
    st.floats(0.0, 1.0, exclude_min=True, exclude_max=True), st.floats(-300.0, -1.0).map(lambda power: 10.0**power)
)
mirrored = st.booleans()


def bounds(mean: float, sd: float, away: float, width: float, mirror: bool) -> tuple[float, float]:
    """Bounds `width` σ apart, the near one `away` σ from the mean."""
    near = mean + sd * away
    far = near + sd * width
    return (2 * mean - far, 2 * mean - near) if mirror else (near, far)


def cdf(x: float, mean: float, sd: float, lower: float, upper: float) -> float:
    """P(X ≤ x), in a tail by the share of it that lies beyond."""
    if mean >= upper:
        return 1.0 - cdf(-x, -mean, sd, -upper, -lower)
    if mean <= lower:
        c = (lower - mean) / sd
        return float(np.expm1(log_survival(c, (x - lower) / sd)) / np.expm1(log_survival(c, (upper - lower) / sd)))
    below, here, above = ((edge - mean) / sd for edge in (lower, x, upper))
    return float((ndtr(here) - ndtr(below)) / (ndtr(above) - ndtr(below)))


@settings(max_examples=400)
@given(means, spreads, sigmas_away, widths, mirrored, uniforms, uniforms, st.floats(-5, 5))
def test_draws_keep_their_bounds_and_follow_the_quantile(
    mean: float, sd: float, away: float, width: float, mirror: bool, u: float, other: float, white: float
) -> None:
    lower, upper = bounds(mean, sd, away, width, mirror)
    x = sample(u, mean, sd, lower, upper)
    assert lower <= x <= upper
    assert math.isfinite(x)
    assert lower <= keep_or_redraw(mean + sd * white, u, mean, sd, lower, upper) <= upper

    low, high = sorted((u, other))
    first, second = sample(low, mean, sd, lower, upper), sample(high, mean, sd, lower, upper)
    scale = abs(x) + abs(mean) + sd
    assert first <= second + 1e-10 * abs(second - first) + 4 * np.spacing(scale) + 1e-11 * sd

    if lower < upper:
        # x itself is rounded, and so are the bounds relative to the mean: that much probability may move.
        density = math.exp(min(log_pdf(x, mean, sd, lower, upper), 700.0))
        tolerance = 1e-9 + 8 * density * np.spacing(scale)
        assert abs(cdf(x, mean, sd, lower, upper) - u) <= tolerance


@settings(max_examples=200)
@given(means, spreads, sigmas_away, widths, mirrored, st.floats(-5, 5), st.floats(-4, 3))
def test_noisy_density_is_never_nan_and_never_above_its_ceiling(
    mean: float, sd: float, away: float, width: float, mirror: bool, offset: float, noise_power: float
) -> None:
    lower, upper = bounds(mean, sd, away, width, mirror)
    noise = sd * 10.0**noise_power
    y = min(max(mean, lower), upper) + offset * noise
    value = noisy_log_pdf(y, mean, sd, lower, upper, noise)
    assert value <= -math.log(noise * math.sqrt(2 * math.pi)) + 1e-9
    assert math.isfinite(value)
