"""Many scalar sparse GPs side by side, laid out for the inner loop of a rollout.

`predict_one` evaluates one of them at one input in a fraction of a microsecond: everything that does not depend on
the input is folded into the arrays, every loop runs over contiguous memory in multiples of LANES, and the
exponential is a polynomial without branches, so the compiler turns all of it into vector instructions.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numba import njit

from kinecast.errors import OptionError
from kinecast.prediction.sparse_gp import SparseGP

__all__ = ["PackedGPs", "pack", "predict_one", "scratch"]

LANES = 16
"""M is padded to a multiple of this, so that no vector loop leaves a remainder."""
OFFSET, PRIOR, NOISE, INPUTS = 0, 1, 2, 3
"""Columns of a header: output mean, signal and noise variance, then D input means and D rates."""
BIAS, WEIGHTS, CENTRES = 0, 1, 2
"""Rows of a table: exponent without the input, weights of the mean, D rows of centres, M rows of the factor."""

# exp(128 s − 16) for s in [−1/8, 1/8], that is exp on [−32, 0]: a polynomial in s, then seven squarings.
SQUARINGS = 7
HALF_RANGE = 0.125
_POLYNOMIAL = np.polynomial.Chebyshev.interpolate(
    lambda s: np.exp(s - HALF_RANGE), 8, domain=[-HALF_RANGE, HALF_RANGE]
)  # fmt: skip
C0, C1, C2, C3, C4, C5, C6, C7, C8 = (float(c) for c in _POLYNOMIAL.convert(kind=np.polynomial.Polynomial).coef)

FAST = {"reassoc", "contract", "arcp", "nsz"}
"""Sums may be reordered, which vector instructions need; NaN still goes through."""


class PackedGPs(NamedTuple):
    """B scalar sparse GPs with D inputs, M pseudo-inputs after padding. Built by `pack`, read by `predict_one`.

    Attributes:
        header: (B, 3 + 2 D) numbers that stand alone, in output units: columns OFFSET, PRIOR, NOISE, INPUTS….
        table: (B, 2 + D + M, M) one number per pseudo-input in each row: rows BIAS, WEIGHTS, CENTRES….
    """

    header: Float[np.ndarray, "B H"]
    table: Float[np.ndarray, "B R M"]


def pack(models: Sequence[SparseGP]) -> PackedGPs:
    """Lay out scalar sparse GPs for `predict_one`; their numbers of pseudo-inputs may differ.

    Raises:
        OptionError: if there are none, one has several outputs, or their inputs differ in number.
    """
    if not models:
        raise OptionError("at least one sparse GP must be packed")
    dimension = models[0].pseudo_inputs.shape[1]
    for number, model in enumerate(models):
        if model.weights.shape[1] != 1 or model.pseudo_inputs.shape[1] != dimension:
            raise OptionError(
                f"packed sparse GPs have 1 output and {dimension} inputs; number {number} has "
                f"{model.weights.shape[1]} and {model.pseudo_inputs.shape[1]}"
            )
    widest = max(len(model.pseudo_inputs) for model in models)
    padded = -(-widest // LANES) * LANES
    header = np.empty((len(models), INPUTS + 2 * dimension))
    table = np.zeros((len(models), CENTRES + dimension + padded, padded))
    table[:, BIAS] = -1.0  # padding: far away from any input
    unit = 1.0 / math.sqrt(2.0 * 2**SQUARINGS)  # −½ |x − z|² / 2⁷ = −|unit x − unit z|²
    for model, head, rows in zip(models, header, table, strict=True):
        count = len(model.pseudo_inputs)
        scaled = unit * model.pseudo_inputs / model.kernel.lengthscales
        signal, sd = model.kernel.signal_variance, model.outputs.sd[0]
        head[:INPUTS] = model.outputs.mean[0], signal * sd**2, model.noise_variance * sd**2
        head[INPUTS : INPUTS + dimension] = model.inputs.mean
        head[INPUTS + dimension :] = unit / (model.inputs.sd * model.kernel.lengthscales)
        rows[BIAS, :count] = HALF_RANGE - np.square(scaled).sum(axis=1)
        rows[WEIGHTS, :count] = signal * sd * model.weights[:, 0]
        rows[CENTRES : CENTRES + dimension, :count] = 2.0 * scaled.T
        factor = rows[CENTRES + dimension :]
        factor[:count, :count] = signal * sd * model.factor.T
    return PackedGPs(header, table)


@njit(cache=True)
def scratch(gps: PackedGPs) -> Float[np.ndarray, " M"]:
    """Working memory for `predict_one`: one per thread, made outside the loop."""
    return np.empty(gps.table.shape[2])


@njit(cache=True, error_model="numpy", fastmath=FAST)
def predict_one(
    gps: PackedGPs, which: int, x: Float[np.ndarray, " D"], memory: Float[np.ndarray, " M"]
) -> tuple[float, float]:
    """Mean and variance, the noise included, of one of the GPs at one input.

    Args:
        gps: packed models.
        which: index of the model, 0 ≤ which < B; not checked.
        x: (D,) input in its own units; NaN gives NaN.
        memory: from `scratch`; overwritten.

    Returns:
        Mean and variance in the units of the model's output; they equal `SparseGP.predict` to 1e-8 of the signal's
        standard deviation.
    """
    header, table = gps
    count = table.shape[2]
    dimension = (header.shape[1] - INPUTS) // 2
    norm = 0.0
    for d in range(dimension):
        norm += ((x[d] - header[which, INPUTS + d]) * header[which, INPUTS + dimension + d]) ** 2
    for m in range(count):
        memory[m] = table[which, BIAS, m] - norm
    for d in range(dimension):
        scaled = (x[d] - header[which, INPUTS + d]) * header[which, INPUTS + dimension + d]
        for m in range(count):
            memory[m] += scaled * table[which, CENTRES + d, m]

    mean = header[which, OFFSET]
    for m in range(count):
        s = memory[m]
        s = -HALF_RANGE if s < -HALF_RANGE else s  # exp(−32) is nothing
        e = C0 + s * (C1 + s * (C2 + s * (C3 + s * (C4 + s * (C5 + s * (C6 + s * (C7 + s * C8)))))))
        e *= e
        e *= e
        e *= e
        e *= e
        e *= e
        e *= e
        e *= e
        memory[m] = e  # k(x, z_m) / σf²
        mean += e * table[which, WEIGHTS, m]

    # |Uᵀ k|², four rows of Uᵀ at a time, from the diagonal on. Indices are unsigned because a signed one that might
    # be negative costs a check per element, and with it the vector instructions.
    variance = header[which, PRIOR]
    for row in range(0, count, 4):
        r0 = np.uint64(CENTRES + dimension + row)
        r1, r2, r3 = r0 + np.uint64(1), r0 + np.uint64(2), r0 + np.uint64(3)
        u0 = u1 = u2 = u3 = 0.0
        for m in range(np.uint64(row // LANES * LANES), np.uint64(count)):
            k = memory[m]
            u0 += table[which, r0, m] * k
            u1 += table[which, r1, m] * k
            u2 += table[which, r2, m] * k
            u3 += table[which, r3, m] * k
        variance -= u0 * u0 + u1 * u1 + u2 * u2 + u3 * u3
    return mean, max(variance, 0.0) + header[which, NOISE]
