"""Random numbers by the hundred thousand, drawn in parallel: a rollout needs more of them than anything else.

Each of 1024 streams is a xoshiro256+ generator (Blackman and Vigna, 2021) seeded from the caller's generator, so the
same state gives the same numbers, however many threads draw them.
"""

from __future__ import annotations

import math
from typing import no_type_check

import numpy as np
from jaxtyping import Float, UInt64
from numba import njit, prange

from kinecast.body.elementary import logarithm, sine_cosine

__all__ = ["hashed", "hashed_uniform", "normals", "uniforms"]

BLOCKS, LANES = 16, 64
"""Streams: LANES of them side by side in each block."""
TURN = 2.0 * math.pi
ONE = np.uint64(1023 << 52)
BELOW_ONE = 1.0 - 2.0**-53


def normals(rng: np.random.Generator, *shape: int) -> Float[np.ndarray, "..."]:
    """Standard normal draws of a shape."""
    return _drawn(rng, shape, True)


def uniforms(rng: np.random.Generator, *shape: int) -> Float[np.ndarray, "..."]:
    """Draws from the open interval (0, 1), 2^-52 apart, of a shape."""
    return _drawn(rng, shape, False)


def _drawn(rng: np.random.Generator, shape: tuple[int, ...], normal: bool) -> Float[np.ndarray, "..."]:
    count = math.prod(shape)
    pairs = -(-count // (2 * BLOCKS * LANES))
    out = np.empty((BLOCKS, 2 * pairs, LANES))
    seeds = rng.integers(0, 2**64, size=(BLOCKS, 4, LANES), dtype=np.uint64)
    _fill(seeds, normal, out)
    return out.ravel()[:count].reshape(shape)


@njit(cache=True)
@no_type_check
def _next(state: UInt64[np.ndarray, "4 L"], out: Float[np.ndarray, " L"]) -> None:
    """One number in (0, 1) from each stream: 52 bits behind the exponent of 1 make a double in [1, 2)."""
    s0, s1, s2, s3 = state[0], state[1], state[2], state[3]
    for lane in range(LANES):
        a, b, c, d = s0[lane], s1[lane], s2[lane], s3[lane]
        bits = ((a + d) >> np.uint64(12)) | ONE
        out[lane] = np.uint64(bits).view(np.float64) - BELOW_ONE
        c, d = c ^ a, d ^ b
        s1[lane], s0[lane] = b ^ c, a ^ d
        s2[lane] = c ^ (b << np.uint64(17))
        s3[lane] = (d << np.uint64(45)) | (d >> np.uint64(19))


@njit(cache=True, parallel=True)
@no_type_check
def _fill(seeds: UInt64[np.ndarray, "B 4 L"], normal: bool, out: Float[np.ndarray, "B K L"]) -> None:
    """Uniform draws, or normal ones by Box and Muller's transform of each pair."""
    for block in prange(len(seeds)):
        state = seeds[block].copy()
        for k in range(0, out.shape[1], 2):
            u, v = out[block, k], out[block, k + 1]
            _next(state, u)
            _next(state, v)
            if normal:
                for lane in range(LANES):
                    radius = math.sqrt(-2.0 * logarithm(u[lane]))
                    sine, cosine = sine_cosine(TURN * v[lane])
                    u[lane], v[lane] = radius * cosine, radius * sine


@njit(cache=True)
@no_type_check
def hashed(seed: np.uint64, number: np.uint64) -> np.uint64:
    """The number-th 64 random bits of a seed (splitmix64: Steele, Lea and Flood, 2014); a seed in its turn."""
    z = seed + (number + np.uint64(1)) * np.uint64(0x9E3779B97F4A7C15)
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return z ^ (z >> np.uint64(31))


@njit(cache=True)
@no_type_check
def hashed_uniform(seed: np.uint64, number: np.uint64) -> float:
    """The number-th uniform draw in (0, 1) of a seed, for the few wanted."""
    return ((hashed(seed, number) >> np.uint64(12)) + 0.5) * 2.0**-52
