"""A stack's processes for many samples at once, side by side in lanes.

A loop over lanes does the same to every sample, without branches, so the compiler turns it into vector instructions;
what all samples share (pseudo-inputs, weights) is read once for all of them.
"""

from __future__ import annotations

import math
from typing import NamedTuple, no_type_check

import numpy as np
from jaxtyping import Float, Int
from numba import njit

from kinecast.body.elementary import power_of_two
from kinecast.prediction.series import SeriesStack

__all__ = ["LANES", "Tiles", "lane_memory", "next_values", "tiled"]

LANES = 64
"""Samples side by side: what one series needs for them stays in the first-level cache (M = 32)."""
STRIP = 6
"""Inputs taken in one go; 0.2 s at 30 Hz are six."""
TILE = 4
"""Side of the squares in which the variance's factor is read: 16 numbers fit into registers."""

HALF_LOG2_E = 0.5 / math.log(2.0)


class Tiles(NamedTuple):
    """A `SeriesStack` laid out for `next_values`.

    Inputs are scaled so that k_m = 2^(centres_m · u + bias_m − |u|²) with u = gain ∘ x − offset. Padding is zero.

    Attributes:
        gain, offset: (D, N).
        centres: (D, M, N) twice the pseudo-inputs, N padded to whole strips.
        bias: (D, M) minus the squared length of each pseudo-input.
        weights: (D, M).
        factor: (D, R, M, TILE, TILE) in squares, rows outside.
        first: (D, R) first square of each row that is not zero.
        centre, signal, noise: (D,).
    """

    gain: Float[np.ndarray, "D N"]
    offset: Float[np.ndarray, "D N"]
    centres: Float[np.ndarray, "D M P"]
    bias: Float[np.ndarray, "D M"]
    weights: Float[np.ndarray, "D M"]
    factor: Float[np.ndarray, "D R C 4 4"]
    first: Int[np.ndarray, "D R"]
    centre: Float[np.ndarray, " D"]
    signal: Float[np.ndarray, " D"]
    noise: Float[np.ndarray, " D"]


@njit(cache=True)
@no_type_check
def tiled(stack: SeriesStack) -> Tiles:
    """The stack laid out for `next_values`: some ten microseconds, so made anew for every rollout."""
    series, inputs, pseudo = stack.pseudo.shape
    rank = stack.factor.shape[1]
    rows, columns = (rank + TILE - 1) // TILE, (pseudo + TILE - 1) // TILE
    unit = math.sqrt(HALF_LOG2_E)
    centres = np.zeros((series, TILE * columns, (inputs + STRIP - 1) // STRIP * STRIP))
    bias, weights = np.zeros((series, TILE * columns)), np.zeros((series, TILE * columns))
    factor = np.zeros((series, rows, columns, TILE, TILE))
    first = np.full((series, rows), columns)
    for d in range(series):
        for m in range(pseudo):
            weights[d, m] = stack.weights[d, m]
            for n in range(inputs):
                z = unit * stack.pseudo[d, n, m]
                centres[d, m, n] = 2.0 * z
                bias[d, m] -= z * z
            for r in range(rank):
                if stack.factor[d, r, m] != 0.0:
                    factor[d, r // TILE, m // TILE, r % TILE, m % TILE] = stack.factor[d, r, m]
                    first[d, r // TILE] = min(first[d, r // TILE], m // TILE)
    return Tiles(
        unit * stack.gain, unit * stack.offset, centres, bias, weights, factor, first,
        stack.centre, stack.signal, stack.noise,
    )  # fmt: skip


@njit(cache=True)
@no_type_check
def lane_memory(tiles: Tiles) -> Float[np.ndarray, "K L"]:
    """Working memory for `next_values`, one per thread."""
    return np.zeros((tiles.bias.shape[1] + 5 + tiles.centres.shape[2], LANES))


@njit(cache=True, fastmath={"contract"}, error_model="numpy")
@no_type_check
def next_values(
    x: Float[np.ndarray, "N L"],
    series: int,
    tiles: Tiles,
    memory: Float[np.ndarray, "K L"],
    mean: Float[np.ndarray, " L"],
    spread: Float[np.ndarray, " L"],
) -> None:
    """Mean and spread of one series' next value in each lane.

    Args:
        x: (N, L) its last values, finite.
        series: which of the stack.
        tiles: the processes.
        memory: from `lane_memory`.
        mean, spread: (L,) receive the result.
    """
    inputs, lanes = x.shape
    pseudo, padded = tiles.centres.shape[1:]
    square = memory[pseudo]
    u = memory[pseudo + 5 :]
    for lane in range(lanes):
        square[lane] = 0.0
        mean[lane] = tiles.centre[series]
        spread[lane] = tiles.signal[series]
    for n in range(inputs):
        gain, offset = tiles.gain[series, n], tiles.offset[series, n]
        x_n, u_n = x[n], u[n]
        for lane in range(lanes):
            value = gain * x_n[lane] - offset
            u_n[lane] = value
            square[lane] += value * value

    for m in range(pseudo):
        bias, weight = tiles.bias[series, m], tiles.weights[series, m]
        kernel = memory[m]
        for lane in range(lanes):
            kernel[lane] = bias - square[lane]
        for n in range(0, padded, STRIP):
            z = tiles.centres[series, m, n : n + STRIP]
            z0, z1, z2, z3, z4, z5 = z[0], z[1], z[2], z[3], z[4], z[5]
            u0, u1, u2, u3, u4, u5 = u[n], u[n + 1], u[n + 2], u[n + 3], u[n + 4], u[n + 5]
            for lane in range(lanes):
                near = z0 * u0[lane] + z1 * u1[lane] + z2 * u2[lane]
                kernel[lane] += near + (z3 * u3[lane] + z4 * u4[lane] + z5 * u5[lane])
        for lane in range(lanes):
            k = power_of_two(max(kernel[lane], -1000.0))
            kernel[lane] = k
            mean[lane] += weight * k

    a0, a1, a2, a3 = memory[pseudo + 1], memory[pseudo + 2], memory[pseudo + 3], memory[pseudo + 4]
    for row in range(tiles.factor.shape[1]):
        for lane in range(lanes):
            a0[lane] = a1[lane] = a2[lane] = a3[lane] = 0.0
        for column in range(tiles.first[series, row], tiles.factor.shape[2]):
            f = tiles.factor[series, row, column]
            f00, f01, f02, f03 = f[0, 0], f[0, 1], f[0, 2], f[0, 3]
            f10, f11, f12, f13 = f[1, 0], f[1, 1], f[1, 2], f[1, 3]
            f20, f21, f22, f23 = f[2, 0], f[2, 1], f[2, 2], f[2, 3]
            f30, f31, f32, f33 = f[3, 0], f[3, 1], f[3, 2], f[3, 3]
            m = TILE * column
            k0, k1, k2, k3 = memory[m], memory[m + 1], memory[m + 2], memory[m + 3]
            for lane in range(lanes):
                x0, x1, x2, x3 = k0[lane], k1[lane], k2[lane], k3[lane]
                a0[lane] += f00 * x0 + f01 * x1 + f02 * x2 + f03 * x3
                a1[lane] += f10 * x0 + f11 * x1 + f12 * x2 + f13 * x3
                a2[lane] += f20 * x0 + f21 * x1 + f22 * x2 + f23 * x3
                a3[lane] += f30 * x0 + f31 * x1 + f32 * x2 + f33 * x3
        for lane in range(lanes):
            spread[lane] -= a0[lane] ** 2 + a1[lane] ** 2 + a2[lane] ** 2 + a3[lane] ** 2
    noise = tiles.noise[series]
    for lane in range(lanes):
        spread[lane] = math.sqrt(max(spread[lane], 0.0) + noise)
