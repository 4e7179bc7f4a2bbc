"""The standard normal far from its mean, as scalar kernels: no cancellation, no underflow, in either tail.

Everything rests on two functions of a distance c ≥ 0 from the mean, in standard deviations. With φ and Φ the
density and distribution function of N(0, 1):

    Mills ratio      M(c) = Φ(−c) / φ(c)
    tail survival    log S(c, t) = log Φ(−c − t) − log Φ(−c)      the share of the tail that lies beyond c + t
"""

from __future__ import annotations

import math
from typing import no_type_check

from numba import njit

__all__ = ["log_ndtr", "log_survival", "mills_ratio", "ndtri_exp", "tail_offset"]

LOG_SQRT_2PI = 0.5 * math.log(2.0 * math.pi)
SQRT_HALF = math.sqrt(0.5)
SQRT_HALF_PI = math.sqrt(0.5 * math.pi)
LOG_2 = math.log(2.0)

SERIES_START = 10.0
"""Distance [sd] from which 20 terms of the asymptotic series of M are exact to double precision."""
SHORT_STEP = 1e-4
"""Step t [sd] below which log S is taken from three terms of its Taylor series: exact to 1e-12."""
MAX_ITERATIONS = 20
"""The solver needs two to four steps; this only guards against NaN."""


@njit(cache=True, error_model="numpy")
@no_type_check
def mills_ratio(c: float) -> float:
    """M(c) = Φ(−c) / φ(c) for c ≥ 0, relative error below 2e-14.

    Beyond SERIES_START the asymptotic series 1/c · (1 − 1/c² + 1·3/c⁴ − 1·3·5/c⁶ + …), nested.
    """
    if c < SERIES_START:
        return SQRT_HALF_PI * math.erfc(c * SQRT_HALF) * math.exp(0.5 * c * c)
    inverse = 1.0 / c
    y = inverse * inverse
    series = 1.0
    for k in range(39, 0, -2):
        series = 1.0 - k * y * series
    return inverse * series


@njit(cache=True, error_model="numpy")
@no_type_check
def log_ndtr(x: float) -> float:
    """log Φ(x), finite down to x = −1e154 and accurate up to x = 37, where it becomes −0."""
    if x > 0.0:
        return math.log1p(-0.5 * math.erfc(x * SQRT_HALF))
    if x == -math.inf:
        return -math.inf
    return math.log(mills_ratio(-x)) - 0.5 * x * x - LOG_SQRT_2PI


@njit(cache=True, error_model="numpy")
@no_type_check
def log_survival(c: float, t: float) -> float:
    """log S(c, t) = log Φ(−c − t) − log Φ(−c) for c, t ≥ 0, relative error below 1e-11 for any t."""
    if t == math.inf:
        return -math.inf
    return _log_survival(c, t, mills_ratio(c), mills_ratio(c + t))


@njit(cache=True, error_model="numpy")
@no_type_check
def _log_survival(c: float, t: float, mills: float, mills_beyond: float) -> float:
    """log S(c, t) given M(c) and M(c + t).

    For a short step its Taylor series −h t − h′ t²/2 − h″ t³/6, with the hazard h = 1 / M(c), h′ = h (h − c).
    """
    if t >= SHORT_STEP:
        return math.log(mills_beyond / mills) - t * (c + 0.5 * t)
    hazard = 1.0 / mills
    slope = min(max(hazard * (hazard - c), 0.5), 1.0)  # of the hazard; its range, where c drowns hazard − c
    bend = (hazard - c) * slope + hazard * (slope - 1.0) if c < 1e3 else 0.0
    return -t * (hazard + t * (slope / 2.0 + t * bend / 6.0))


@njit(cache=True, error_model="numpy")
@no_type_check
def tail_offset(c: float, loss: float) -> float:
    """The step t ≥ 0 into the tail beyond c with log S(c, t) = −loss.

    Halley's method from the root of h t + h′ t²/2 ≈ loss; log S is concave in t, so it converges from anywhere.

    Args:
        c: where the tail begins, c ≥ 0 [sd].
        loss: −log of the share of the tail that lies beyond c + t, in [0, ∞].
    """
    if loss <= 0.0 or c == math.inf:
        return 0.0
    if loss == math.inf:
        return math.inf
    mills = mills_ratio(c)
    hazard = 1.0 / mills
    slope = min(max(hazard * (hazard - c), 0.5), 1.0)
    t = 2.0 * loss / (hazard + math.sqrt(hazard * hazard + 2.0 * slope * loss))
    for _ in range(MAX_ITERATIONS):
        mills_beyond = mills_ratio(c + t)
        newton = (_log_survival(c, t, mills, mills_beyond) + loss) * mills_beyond
        step = newton / (1.0 + 0.5 * newton * (1.0 / mills_beyond - c - t))
        t += step
        if not abs(step) > 1e-4 * t:  # the next step is less than the cube of this one
            break
    return t


@njit(cache=True, error_model="numpy")
@no_type_check
def ndtri_exp(logp: float) -> float:
    """Quantile of log p: the x with log Φ(x) = log p, relative error below 1e-12 for log p as given.

    Returns:
        x; −∞ at log p = −∞, ∞ at log p = 0, NaN above.
    """
    if logp > 0.0:
        return math.nan
    if logp < -LOG_2:
        return -tail_offset(0.0, -logp - LOG_2)
    if logp == 0.0:
        return math.inf
    return tail_offset(0.0, -math.log(-math.expm1(logp)) - LOG_2)
