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

LANES = 8
"""M is padded to a multiple of this many doubles, one AVX-512 register."""

# exp(128 s − 16) for s in [−1/8, 1/8], that is exp on [−32, 0]: a polynomial in s, then seven squarings.
SQUARINGS = 7
HALF_RANGE = 0.125
_POLYNOMIAL = np.polynomial.Chebyshev.interpolate(
    lambda s: np.exp(s - HALF_RANGE), 8, domain=[-HALF_RANGE, HALF_RANGE]
)  # fmt: skip
C0, C1, C2, C3, C4, C5, C6, C7, C8 = (
    float(c) for c in _POLYNOMIAL.convert(kind=np.polynomial.Polynomial).coef
)

FAST = {"reassoc", "contract", "arcp", "nsz"}
"""Sums may be reordered, which vector instructions need; NaN still goes through."""


class PackedGPs(NamedTuple):
    """B scalar sparse GPs with D inputs; M padded. Built by `pack`, read by `predict_one`.

    Attributes:
        shift: (B, D) input means.
        rate: (B, D) factors that take a shifted input to the units of `centres`.
        centres: (B, D, M) pseudo-inputs, scaled and doubled.
        bias: (B, M) what the exponent holds besides the input.
        weights: (B, M) of the mean, in output units.
        factors: (B, M, M) of the variance, lower triangular, in output units.
        offset: (B,) output means.
        prior: (B,) signal variances, in output units.
        noise: (B,) noise variances, in output units.
    """

    shift: Float[np.ndarray, "B D"]
    rate: Float[np.ndarray, "B D"]
    centres: Float[np.ndarray, "B D M"]
    bias: Float[np.ndarray, "B M"]
    weights: Float[np.ndarray, "B M"]
    factors: Float[np.ndarray, "B M M"]
    offset: Float[np.ndarray, " B"]
    prior: Float[np.ndarray, " B"]
    noise: Float[np.ndarray, " B"]


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
    centres = np.zeros((len(models), dimension, padded))
    bias = np.full((len(models), padded), -1.0)  # padding: far away from any input
    weights = np.zeros((len(models), padded))
    factors = np.zeros((len(models), padded, padded))
    unit = 1.0 / math.sqrt(2.0 * 2**SQUARINGS)  # −½ |x − z|² / 2⁷ = −|unit x − unit z|²
    for b, model in enumerate(models):
        count = len(model.pseudo_inputs)
        scaled = unit * model.pseudo_inputs / model.kernel.lengthscales
        gain = model.kernel.signal_variance * model.outputs.sd[0]
        centres[b, :, :count] = 2.0 * scaled.T
        bias[b, :count] = HALF_RANGE - np.square(scaled).sum(axis=1)
        weights[b, :count] = gain * model.weights[:, 0]
        factors[b, :count, :count] = gain * model.factor
    squared = np.array([model.outputs.sd[0] ** 2 for model in models])
    return PackedGPs(
        shift=np.stack([model.inputs.mean for model in models]),
        rate=np.stack([unit / (model.inputs.sd * model.kernel.lengthscales) for model in models]),
        centres=centres,
        bias=bias,
        weights=weights,
        factors=factors,
        offset=np.array([model.outputs.mean[0] for model in models]),
        prior=np.array([model.kernel.signal_variance for model in models]) * squared,
        noise=np.array([model.noise_variance for model in models]) * squared,
    )


@njit(cache=True)
def scratch(gps: PackedGPs) -> Float[np.ndarray, "2 M"]:
    """Working memory for `predict_one`: one per thread, made outside the loop."""
    return np.empty((2, gps.bias.shape[1]))


@njit(cache=True, error_model="numpy", fastmath=FAST)
def predict_one(
    gps: PackedGPs, which: int, x: Float[np.ndarray, " D"], memory: Float[np.ndarray, "2 M"]
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
    dimension, count = gps.centres.shape[1:]
    k, explained = memory[0], memory[1]
    bias, weights, factors = gps.bias[which], gps.weights[which], gps.factors[which]
    norm = 0.0
    for d in range(dimension):
        norm += ((x[d] - gps.shift[which, d]) * gps.rate[which, d]) ** 2
    for m in range(count):
        k[m] = bias[m] - norm
    for d in range(dimension):
        scaled = (x[d] - gps.shift[which, d]) * gps.rate[which, d]
        centres = gps.centres[which, d]
        for m in range(count):
            k[m] += scaled * centres[m]
    mean = gps.offset[which]
    for m in range(count):
        s = k[m]
        s = -HALF_RANGE if s < -HALF_RANGE else s  # exp(−32) is nothing
        e = C0 + s * (C1 + s * (C2 + s * (C3 + s * (C4 + s * (C5 + s * (C6 + s * (C7 + s * C8)))))))
        e *= e
        e *= e
        e *= e
        e *= e
        e *= e
        e *= e
        e *= e
        k[m] = e
        explained[m] = 0.0
        mean += e * weights[m]
    for m in range(0, count, 4):  # Uᵀ k, four rows of U at a time, up to the block of the diagonal
        k0, k1, k2, k3 = k[m], k[m + 1], k[m + 2], k[m + 3]
        row0, row1, row2, row3 = factors[m], factors[m + 1], factors[m + 2], factors[m + 3]
        for j in range((m // LANES + 1) * LANES):
            explained[j] += k0 * row0[j] + k1 * row1[j] + k2 * row2[j] + k3 * row3[j]
    variance = gps.prior[which]
    for m in range(count):
        variance -= explained[m] * explained[m]
    return mean, max(variance, 0.0) + gps.noise[which]
