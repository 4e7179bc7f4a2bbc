"""Elementary functions without branches (kernels): compiled loops over them become vector instructions.

Those of the C library are calls that the compiler cannot look into, some 25 ns a number; these take 3.
"""

from __future__ import annotations

import math
from typing import no_type_check

import numpy as np
from numba import njit

__all__ = ["arctangent", "logarithm", "power_of_two", "sine_cosine"]

MAGIC = 1.5 * 2.0**52
"""Added to a number below 2^51 in magnitude, it leaves the nearest integer in the lowest bits."""

# π/2 as a sum whose first two numbers have 33 bits: their products with integers below 2^20 are exact.
HALF_PI_1, HALF_PI_2, HALF_PI_3 = 1.5707963267341256, 6.077100506303966e-11, 2.0222662487959506e-21
QUARTERS = 2.0 / math.pi
# Taylor's coefficients; what follows is below 1e-16 up to π/4.
S3, S5, S7, S9, S11, S13, S15 = ((-1.0) ** (k // 2) / math.factorial(k) for k in range(3, 16, 2))
C4, C6, C8, C10, C12, C14, C16 = ((-1.0) ** (k // 2) / math.factorial(k) for k in range(4, 17, 2))

_POWER = np.polynomial.Chebyshev.interpolate(np.exp2, 8, domain=[-0.5, 0.5])
P0, P1, P2, P3, P4, P5, P6, P7, P8 = (float(c) for c in _POWER.convert(kind=np.polynomial.Polynomial).coef)

HALF_PI, TAN_1_8, TAN_3_8 = 0.5 * math.pi, math.sqrt(2.0) - 1.0, math.sqrt(2.0) + 1.0
_ARCTANGENT = np.polynomial.Chebyshev.interpolate(
    lambda z: np.arctan(np.sqrt(z)) / np.sqrt(z), 10, domain=[0.0, TAN_1_8**2]
)
A0, A1, A2, A3, A4, A5, A6, A7, A8, A9, A10 = (
    float(c) for c in _ARCTANGENT.convert(kind=np.polynomial.Polynomial).coef
)

LOG_2 = math.log(2.0)
SQRT_HALF_BITS = 0x3FE6A09E667F3BCD
EXPONENT_OF_2_52 = 0x433 << 52


@njit(cache=True, forceinline=True)
@no_type_check
def sine_cosine(x: float) -> tuple[float, float]:
    """sin x and cos x, within 3e-16 for |x| < 1e6 (Cody and Waite's reduction)."""
    shifted = x * QUARTERS + MAGIC
    quarters = shifted - MAGIC
    r = ((x - quarters * HALF_PI_1) - quarters * HALF_PI_2) - quarters * HALF_PI_3
    z = r * r
    sine = r + r * z * (S3 + z * (S5 + z * (S7 + z * (S9 + z * (S11 + z * (S13 + z * S15))))))
    cosine = 1.0 - 0.5 * z + z * z * (C4 + z * (C6 + z * (C8 + z * (C10 + z * (C12 + z * (C14 + z * C16))))))
    quadrant = np.float64(shifted).view(np.int64)
    a, b = (cosine, sine) if quadrant & 1 else (sine, cosine)
    return -a if quadrant & 2 else a, -b if (quadrant + 1) & 2 else b


@njit(cache=True, forceinline=True)
@no_type_check
def power_of_two(y: float) -> float:
    """2^y, relative error below 1e-12, for |y| ≤ 1000: the integer part goes straight into the exponent's bits."""
    shifted = y + MAGIC
    f = y - (shifted - MAGIC)
    p = P0 + f * (P1 + f * (P2 + f * (P3 + f * (P4 + f * (P5 + f * (P6 + f * (P7 + f * P8)))))))
    return np.int64(np.float64(p).view(np.int64) + (np.float64(shifted).view(np.int64) << 52)).view(np.float64)


@njit(cache=True, forceinline=True, error_model="numpy")
@no_type_check
def logarithm(x: float) -> float:
    """log x, error below 1e-11, for normal x > 0: of x = 2^e m with m in [√½, √2), by 2 artanh((m − 1)/(m + 1))."""
    bits = np.float64(x).view(np.int64)
    exponent = (bits - SQRT_HALF_BITS) >> 52
    m = np.int64(bits - (exponent << 52)).view(np.float64)
    s = (m - 1.0) / (m + 1.0)
    z = s * s
    series = 1.0 + z * (1 / 3 + z * (1 / 5 + z * (1 / 7 + z * (1 / 9 + z * (1 / 11 + z * (1 / 13))))))
    # The exponent as a double, by its bits: a conversion would not be a vector instruction everywhere.
    whole = np.int64(EXPONENT_OF_2_52 + 0x8000000000000 + exponent).view(np.float64) - MAGIC
    return LOG_2 * whole + 2.0 * s * series


@njit(cache=True, forceinline=True, error_model="numpy")
@no_type_check
def arctangent(y: float, x: float) -> float:
    """The angle of (x, y) in [−π, π], within 1e-15; 0 at the origin.

    With t = b/a, (b − a)/(b + a) or −a/b of a = |x|, b = |y|, so that |t| ≤ tan π/8, it is 0, π/4 or π/2 more than
    arctan t.
    """
    a, b = abs(x), abs(y)
    steep, level = b > TAN_3_8 * a, b <= TAN_1_8 * a
    over = b if level else (-a if steep else b - a)
    under = a if level else (b if steep else b + a)
    t = over / (under if under > 0.0 else 1.0)
    z = t * t
    series = A5 + z * (A6 + z * (A7 + z * (A8 + z * (A9 + z * A10))))
    series = A0 + z * (A1 + z * (A2 + z * (A3 + z * (A4 + z * series))))
    angle = (0.0 if level else (HALF_PI if steep else 0.5 * HALF_PI)) + t * series
    angle = math.pi - angle if x < 0.0 else angle
    return -angle if y < 0.0 else angle
