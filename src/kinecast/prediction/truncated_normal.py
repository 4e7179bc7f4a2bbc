"""The truncated normal of Eq. 2, θ ~ TN(μ, σ², lb, ub), exact however far its bounds are from its mean.

Density on [lb, ub], with r the point of [lb, ub] nearest to μ:

    p(x) = exp(−[(x − μ)² − (r − μ)²] / 2σ²) / W,     W = ∫ of that numerator over [lb, ub]

Everything is computed relative to r and in log space, an upper tail as the mirror of a lower one, so nothing cancels or
underflows: limits on speed with a small σ put r hundreds of σ away from μ. A σ of zero, or equal bounds, is a point
mass at r. Bounds may be infinite. Far from the mean everything rests on two functions of a distance c ≥ 0 [sd]:

    Mills ratio      M(c) = Φ(−c) / φ(c)
    tail survival    log S(c, t) = log Φ(−c − t) − log Φ(−c)      the share of the tail that lies beyond c + t

The functions are compiled and scalar, for loops over samples; they never raise, and NaN in gives NaN out.
"""

from __future__ import annotations

import math
from typing import no_type_check

from numba import njit

LOG_SQRT_2PI = 0.5 * math.log(2.0 * math.pi)
SQRT_HALF = math.sqrt(0.5)
SQRT_HALF_PI = math.sqrt(0.5 * math.pi)

SMALLEST = 5e-324
"""The smallest number above zero: stands for a probability that has underflowed."""
SERIES_START = 10.0
"""Distance [sd] from which 20 terms of the asymptotic series of M are exact to double precision."""
SHORT_STEP = 1e-4
"""Step t [sd] below which log S is taken from three terms of its Taylor series: exact to 1e-12."""
NARROW = 1e-5
"""Width [sd] below which a normal around its mean is flat, to 1e-11."""
MAX_ITERATIONS = 20
"""The solver needs two to four steps; this only guards against NaN."""


@njit(cache=True, error_model="numpy")
@no_type_check
def _nearest(x: float, lower: float, upper: float) -> float:
    """The point of [lower, upper] nearest to x; NaN where x is."""
    if x < lower:
        return lower
    return upper if x > upper else x


@njit(cache=True, error_model="numpy")
@no_type_check
def mills_ratio(c: float) -> float:
    """M(c) = Φ(−c) / φ(c) for c ≥ 0, relative error below 2e-14.

    Beyond SERIES_START the asymptotic series 1/c · (1 − 1/c² + 1·3/c⁴ − 1·3·5/c⁶ + …), nested.
    """
    if c < SERIES_START:
        return SQRT_HALF_PI * math.erfc(c * SQRT_HALF) * math.exp(0.5 * c * c)
    inverse = 1.0 / c
    series = 1.0
    for k in range(39, 0, -2):
        series = 1.0 - k * inverse * inverse * series
    return inverse * series


@njit(cache=True, error_model="numpy")
@no_type_check
def log_survival(c: float, t: float) -> float:
    """log S(c, t) = log Φ(−c − t) − log Φ(−c) for c, t ≥ 0, relative error below 1e-11 for any t.

    For a short step its Taylor series −h t − h′ t²/2 − h″ t³/6, with the hazard h = 1 / M(c), h′ = h (h − c).
    """
    if t == math.inf:
        return -math.inf
    mills = mills_ratio(c)
    if t >= SHORT_STEP:
        return math.log(mills_ratio(c + t) / mills) - t * (c + 0.5 * t)
    hazard = 1.0 / mills
    slope = _nearest(hazard * (hazard - c), 0.5, 1.0)  # of the hazard; its range, where c drowns hazard − c
    bend = (hazard - c) * slope + hazard * (slope - 1.0) if c < 1e3 else 0.0
    return -t * (hazard + t * (slope / 2.0 + t * bend / 6.0))


@njit(cache=True, error_model="numpy")
@no_type_check
def tail_offset(c: float, loss: float) -> float:
    """The step t ≥ 0 into the tail beyond c ≥ 0 [sd] with log S(c, t) = −loss, loss in [0, ∞].

    Halley's method from the root of h t + h′ t²/2 ≈ loss; log S is concave in t, so it converges from anywhere.
    """
    if loss <= 0.0 or c == math.inf:
        return 0.0
    if loss == math.inf:
        return math.inf
    hazard = 1.0 / mills_ratio(c)
    slope = _nearest(hazard * (hazard - c), 0.5, 1.0)
    t = 2.0 * loss / (hazard + math.sqrt(hazard * hazard + 2.0 * slope * loss))
    for _ in range(MAX_ITERATIONS):
        mills = mills_ratio(c + t)
        newton = (log_survival(c, t) + loss) * mills
        step = newton / (1.0 + 0.5 * newton * (1.0 / mills - c - t))
        t += step
        if not abs(step) > 1e-4 * t:  # the next step is less than the cube of this one
            break
    return t


@njit(cache=True, error_model="numpy")
@no_type_check
def _tilt(x: float, near: float, mean: float, sd: float) -> float:
    """log p(x) − log p(near) = −[(x − μ)² − (near − μ)²] / 2σ², without cancellation."""
    t = (x - near) / sd
    return -t * ((near - mean) / sd + 0.5 * t)


@njit(cache=True, error_model="numpy")
@no_type_check
def _log_weight(mean: float, sd: float, lower: float, upper: float) -> float:
    """log W = log ∫ exp(−[(x − μ)² − (r − μ)²] / 2σ²) dx over [lower, upper]; σ > 0."""
    if lower < mean < upper:
        span = math.erf((upper - mean) / sd * SQRT_HALF) - math.erf((lower - mean) / sd * SQRT_HALF)
        return math.log(sd) + math.log(SQRT_HALF_PI * span)
    c = (lower - mean if lower >= mean else mean - upper) / sd
    inside = -math.expm1(log_survival(c, (upper - lower) / sd))
    return math.log(sd) + math.log(mills_ratio(c)) + math.log(inside)


@njit(cache=True, error_model="numpy")
@no_type_check
def _loss(p: float, q: float, log_end: float) -> float:
    """−log of the survival q + p·S at the p-quantile of a tail cut off where its survival is S; q = 1 − p."""
    if p < 0.5:
        return -math.log1p(p * math.expm1(log_end))
    return -math.log(q + p * math.exp(log_end))


@njit(cache=True, error_model="numpy")
@no_type_check
def sample(uniform: float, mean: float, sd: float, lower: float, upper: float) -> float:
    """The quantile at `uniform` in (0, 1): a draw from the truncated normal, always inside [lower, upper].

    Never decreases as `uniform` grows, up to rounding.
    """
    if sd <= 0.0 or lower >= upper:
        return _nearest(mean, lower, upper)
    rest, width = 1.0 - uniform, (upper - lower) / sd
    a, b = (lower - mean) / sd, (upper - mean) / sd
    if a >= 0.0:
        x = lower + sd * tail_offset(a, _loss(uniform, rest, log_survival(a, width)))
    elif b <= 0.0:
        x = upper - sd * tail_offset(-b, _loss(rest, uniform, log_survival(-b, width)))
    elif width < NARROW:
        x = lower + uniform * (upper - lower)
    else:
        above = rest * math.erfc(a * SQRT_HALF) + uniform * math.erfc(b * SQRT_HALF)  # 2 (1 − Φ) at the draw
        below = rest * math.erfc(-a * SQRT_HALF) + uniform * math.erfc(-b * SQRT_HALF)
        away = sd * tail_offset(0.0, -math.log(max(min(above, below), SMALLEST)))
        x = mean - away if below < above else mean + away
    return _nearest(x, lower, upper)


@njit(cache=True, error_model="numpy")
@no_type_check
def keep_or_redraw(draw: float, uniform: float, mean: float, sd: float, lower: float, upper: float) -> float:
    """A draw from N(mean, sd²) where it keeps its bounds, else a fresh one made of `uniform`: Eq. 2's law, cheaply."""
    return draw if lower <= draw <= upper else sample(uniform, mean, sd, lower, upper)


@njit(cache=True, error_model="numpy")
@no_type_check
def log_pdf(x: float, mean: float, sd: float, lower: float, upper: float) -> float:
    """log p(x); −∞ outside the bounds, ∞ on a point mass."""
    if x < lower or x > upper:
        return -math.inf
    near = _nearest(mean, lower, upper)
    if sd <= 0.0 or lower >= upper:
        return math.inf if x == near else -math.inf
    return _tilt(x, near, mean, sd) - _log_weight(mean, sd, lower, upper)


@njit(cache=True, error_model="numpy")
@no_type_check
def noisy_log_pdf(y: float, mean: float, sd: float, lower: float, upper: float, noise_sd: float) -> float:
    """log density at y of X + ε, with X the truncated normal and ε ~ N(0, τ²) independent of it.

    Completing the square, with s² = σ² + τ², m = (μ τ² + y σ²) / s² and v = σ τ / s,

        p(y) = N(y; μ, s²) · [Φ((ub − m)/v) − Φ((lb − m)/v)] / [Φ((ub − μ)/σ) − Φ((lb − μ)/σ)]

    computed around r and around the point of [lb, ub] nearest to m, where neither bracket underflows.
    """
    if noise_sd <= 0.0:
        return log_pdf(y, mean, sd, lower, upper)
    near = _nearest(mean, lower, upper)
    shift = y - near
    if sd <= 0.0 or lower >= upper:
        return -0.5 * (shift / noise_sd) ** 2 - math.log(noise_sd) - LOG_SQRT_2PI
    s = math.hypot(sd, noise_sd)
    v = sd * (noise_sd / s)
    m = shift * (sd / s) ** 2 + (mean - near) * (noise_sd / s) ** 2  # from here on measured from r
    best = _nearest(m, lower - near, upper - near)
    misfit = (shift - best) / noise_sd
    peak = _tilt(best, 0.0, mean - near, sd) - 0.5 * misfit * misfit - math.log(noise_sd) - LOG_SQRT_2PI
    return peak + _log_weight(m, v, lower - near, upper - near) - _log_weight(mean, sd, lower, upper)
