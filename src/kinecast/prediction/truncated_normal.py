"""The truncated normal of Eq. 2, θ ~ TN(μ, σ², lb, ub), exact however far its bounds are from its mean.

Density on [lb, ub], with r the point of [lb, ub] nearest to μ:

    p(x) = exp(−[(x − μ)² − (r − μ)²] / 2σ²) / W,     W = ∫ of that numerator over [lb, ub]

Everything is computed relative to r, so nothing cancels or underflows: limits on speed with a small σ put r
hundreds of σ away from μ. A σ of zero, or equal bounds, is a point mass at r. Bounds may be infinite.

The functions are scalar kernels for compiled loops; they never raise, and NaN in gives NaN out.
`TruncatedNormal` is the same for arrays.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias, no_type_check

import numpy as np
from jaxtyping import Float
from numba import njit, vectorize

from kinecast.errors import OptionError
from kinecast.prediction.draws import hashed_uniform
from kinecast.prediction.normal_tails import (
    LOG_SQRT_2PI,
    SQRT_HALF,
    SQRT_HALF_PI,
    log_survival,
    mills_ratio,
    tail_offset,
)

__all__ = [
    "TruncatedNormal",
    "draw",
    "keep_or_redraw",
    "log_cdf",
    "log_mass",
    "log_pdf",
    "moments",
    "noisy_log_pdf",
    "sample",
]

Array: TypeAlias = Float[np.ndarray, "..."]
Numbers: TypeAlias = Array | float

NARROW = 1e-5
"""Width [sd] below which a normal around its mean is flat, to 1e-11."""
GENTLE = 1.5
"""Drop of log density across the bounds up to which draws between them are accepted often: e^-1.5 of the time at least.
"""
MOST_TRIES = 32
FAINT = 80.0
"""Twice the drop of log density, from its peak, beyond which moments are not integrated: e⁻⁴⁰ is nothing."""
NODES, WEIGHTS = np.polynomial.legendre.leggauss(64)
"""Gauss–Legendre rule on [−1, 1] for the moments."""


@njit(cache=True, error_model="numpy")
@no_type_check
def _nearest(x: float, lower: float, upper: float) -> float:
    """The point of [lower, upper] nearest to x; NaN where x is."""
    if x < lower:
        return lower
    if x > upper:
        return upper
    return x


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
    c = max(lower - mean, mean - upper) / sd
    inside = -math.expm1(log_survival(c, (upper - lower) / sd))
    return math.log(sd) + math.log(mills_ratio(c)) + math.log(inside)


@njit(cache=True, error_model="numpy")
@no_type_check
def log_mass(mean: float, sd: float, lower: float, upper: float) -> float:
    """log P(lower < X < upper) = log [Φ((ub − μ)/σ) − Φ((lb − μ)/σ)] for X ~ N(μ, σ²), σ > 0."""
    if lower >= upper:
        return -math.inf
    c = (_nearest(mean, lower, upper) - mean) / sd
    return _log_weight(mean, sd, lower, upper) - 0.5 * c * c - math.log(sd) - LOG_SQRT_2PI


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
    width = (upper - lower) / sd
    rest = 1.0 - uniform
    if mean <= lower:
        c = (lower - mean) / sd
        x = lower + sd * tail_offset(c, _loss(uniform, rest, log_survival(c, width)))
    elif mean >= upper:
        c = (mean - upper) / sd
        x = upper - sd * tail_offset(c, _loss(rest, uniform, log_survival(c, width)))
    elif width < NARROW:
        x = lower + uniform * (upper - lower)
    else:
        a = (lower - mean) / sd * SQRT_HALF
        b = (upper - mean) / sd * SQRT_HALF
        below = rest * math.erfc(-a) + uniform * math.erfc(-b)  # 2 Φ and 2 (1 − Φ) at the draw
        above = rest * math.erfc(a) + uniform * math.erfc(b)
        if below < above:
            x = mean - sd * tail_offset(0.0, -math.log(below))
        else:
            x = mean + sd * tail_offset(0.0, -math.log(above))
    return _nearest(x, lower, upper)


@njit(cache=True, error_model="numpy")
@no_type_check
def draw(seed: np.uint64, mean: float, sd: float, lower: float, upper: float) -> float:
    """A draw from the truncated normal, always inside [lower, upper], for a seed of its own.

    Where the density hardly falls between the bounds, as with limits on speed, a uniform draw between them is accepted
    with probability p(x)/p(r) (von Neumann's rejection), which takes a tenth of the time of the quantile.
    """
    near = _nearest(mean, lower, upper)
    far = lower if upper - near < near - lower else upper
    if sd > 0.0 and -_tilt(far, near, mean, sd) <= GENTLE:
        for attempt in range(1, 2 * MOST_TRIES, 2):
            x = lower + hashed_uniform(seed, np.uint64(attempt)) * (upper - lower)
            tilt = _tilt(x, near, mean, sd)
            chance = hashed_uniform(seed, np.uint64(attempt + 1))
            if chance <= 1.0 + tilt or chance <= math.exp(tilt):
                return _nearest(x, lower, upper)
    return sample(hashed_uniform(seed, np.uint64(0)), mean, sd, lower, upper)


@njit(cache=True, error_model="numpy")
@no_type_check
def keep_or_redraw(draw: float, uniform: float, mean: float, sd: float, lower: float, upper: float) -> float:
    """The draw where it keeps its bounds, else a fresh one from the truncated normal: Eq. 2's law, cheaply.

    Args:
        draw: drawn from N(mean, sd²), independent of `uniform`.
        uniform: drawn from (0, 1); used only for a draw outside its bounds.
    """
    if lower <= draw <= upper:
        return draw
    return sample(uniform, mean, sd, lower, upper)


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
def log_cdf(x: float, mean: float, sd: float, lower: float, upper: float) -> float:
    """log P(X ≤ x), accurate relative to P."""
    near = _nearest(mean, lower, upper)
    if sd <= 0.0 or lower >= upper:
        return 0.0 if x >= near else -math.inf
    if x <= lower:
        return -math.inf
    if x >= upper:
        return 0.0
    part = _tilt(min(x, near), near, mean, sd) + _log_weight(mean, sd, lower, x)
    return min(part - _log_weight(mean, sd, lower, upper), 0.0)


@njit(cache=True, error_model="numpy")
@no_type_check
def moments(mean: float, sd: float, lower: float, upper: float) -> tuple[float, float]:
    """Mean and variance, by a Gauss–Legendre rule over the part of [lower, upper] that carries the mass."""
    near = _nearest(mean, lower, upper)
    if sd <= 0.0 or lower >= upper:
        return near, 0.0
    c = abs(near - mean) / sd
    reach = FAINT / (c + math.sqrt(c * c + FAINT))  # c t + t²/2 = FAINT/2 there
    start = max((lower - near) / sd, -reach)
    half = 0.5 * (min((upper - near) / sd, reach) - start)
    total = first = second = 0.0
    for k in range(len(NODES)):
        t = half * (1.0 + NODES[k])
        mass = WEIGHTS[k] * math.exp(_tilt(near + sd * (start + t), near, mean, sd))
        total += mass
        first += mass * t
    centre = first / total
    for k in range(len(NODES)):
        t = half * (1.0 + NODES[k])
        mass = WEIGHTS[k] * math.exp(_tilt(near + sd * (start + t), near, mean, sd))
        second += mass * (t - centre) ** 2
    return _nearest(near + sd * (start + centre), lower, upper), sd * sd * second / total


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


_each: Callable[[Callable[..., float]], Callable[..., Numbers]] = vectorize(cache=True)  # type: ignore[no-untyped-call]


@_each
@no_type_check
def _samples(uniform: float, mean: float, sd: float, lower: float, upper: float) -> float:
    return sample(uniform, mean, sd, lower, upper)


@_each
@no_type_check
def _log_pdfs(x: float, mean: float, sd: float, lower: float, upper: float) -> float:
    return log_pdf(x, mean, sd, lower, upper)


@_each
@no_type_check
def _log_cdfs(x: float, mean: float, sd: float, lower: float, upper: float) -> float:
    return log_cdf(x, mean, sd, lower, upper)


@_each
@no_type_check
def _noisy_log_pdfs(y: float, mean: float, sd: float, lower: float, upper: float, noise_sd: float) -> float:
    return noisy_log_pdf(y, mean, sd, lower, upper, noise_sd)


@_each
@no_type_check
def _means(mean: float, sd: float, lower: float, upper: float) -> float:
    return moments(mean, sd, lower, upper)[0]


@_each
@no_type_check
def _variances(mean: float, sd: float, lower: float, upper: float) -> float:
    return moments(mean, sd, lower, upper)[1]


@dataclass(frozen=True)
class TruncatedNormal:
    """Independent truncated normals, one for each element of the four parameters broadcast together.

    Attributes:
        location: (...) mean μ of the normal before truncation.
        scale: (...) its standard deviation σ ≥ 0.
        lower: (...) lower bounds; may be −∞.
        upper: (...) upper bounds, at least `lower`; may be ∞.

    Raises:
        OptionError: if a parameter is NaN, μ or σ infinite, σ negative, or a lower bound above its upper.
    """

    location: Array
    scale: Array
    lower: Array
    upper: Array

    def __post_init__(self) -> None:
        if not np.all(np.isfinite(self.location)):
            raise OptionError("location must be finite")
        if not np.all((self.scale >= 0.0) & np.isfinite(self.scale)):
            raise OptionError(f"scale must be in [0, ∞), found {np.min(self.scale)}")
        if not np.all(self.lower <= self.upper):
            raise OptionError("lower bounds must not exceed upper bounds")

    @property
    def _parameters(self) -> tuple[Array, Array, Array, Array]:
        return self.location, self.scale, self.lower, self.upper

    def sample(self, uniform: Numbers) -> Numbers:
        """The quantiles at `uniform` in (0, 1), broadcast with the parameters; always inside the bounds."""
        return _samples(uniform, *self._parameters)

    def log_pdf(self, x: Numbers) -> Numbers:
        """log p(x); −∞ outside the bounds, ∞ on a point mass."""
        return _log_pdfs(x, *self._parameters)

    def log_cdf(self, x: Numbers) -> Numbers:
        """log P(X ≤ x), accurate relative to P."""
        return _log_cdfs(x, *self._parameters)

    def cdf(self, x: Numbers) -> Numbers:
        """P(X ≤ x)."""
        return np.exp(self.log_cdf(x))

    def noisy_log_pdf(self, y: Numbers, noise_sd: Numbers) -> Numbers:
        """log density at y of the truncated normal plus independent N(0, noise_sd²)."""
        return _noisy_log_pdfs(y, *self._parameters, noise_sd)

    @property
    def mean(self) -> Numbers:
        """E[X], always inside the bounds."""
        return _means(*self._parameters)

    @property
    def variance(self) -> Numbers:
        """Var[X] ≥ 0."""
        return _variances(*self._parameters)
