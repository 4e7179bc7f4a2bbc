"""What a depth camera and its skeleton tracker make of a person, as measured on HA4M."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float
from scipy.signal import lfilter

from kinecast.datasets.recording import Recording
from kinecast.datasets.synthetic.physique import JOINTS

BREATHING_TIME = 0.83
"""Correlation time of the common bone length [s]; HA4M: 0.96, 0.67, 0.26 after 1, 10, 30 frames at 30 Hz."""

LARGEST_JUMP = 24.0
"""Fastest tracker jump [m/s], HA4M V001."""

SWAPPED = 0.3
"""Share of jumps that exchange left and right for a moment; HA4M V001 at 34.1 s."""

LOST_FRAMES = 5.0
"""Mean length of a dropout, in frames."""

ARMS = (slice(0, 3), slice(3, 6))


def sense(
    truth: Recording,
    rng: np.random.Generator,
    noise: float,
    breathing: float,
    repeated: float,
    jumps: float,
    dropouts: float,
) -> Recording:
    """A recording of `physique.JOINTS` as a tracker would have made it; the flaws are those of `SyntheticOptions`."""
    positions = truth.positions * 1.0
    chest = positions[:, JOINTS.index("chest"), None]
    factor = 1.0 + breathing * _breathing(rng, len(positions), truth.rate)
    positions = chest + factor[:, None, None] * (positions - chest)
    spread = noise * np.array([1.5 if "elbow" in name or "wrist" in name else 1.0 for name in JOINTS])
    positions += rng.normal(0.0, 1.0, positions.shape) * spread[:, None]
    _jump(rng, positions, truth.rate, jumps)
    _lose(rng, positions, dropouts)
    for frame in np.flatnonzero(rng.random(len(positions) - 1) < repeated) + 1:
        positions[frame] = positions[frame - 1]
    return replace(truth, positions=positions, notes=("generated, with a simulated tracker",))


def _breathing(rng: np.random.Generator, frames: int, rate: float) -> Float[np.ndarray, " N"]:
    """(N,) first-order autoregression of standard deviation 1, cut at 2.5."""
    rho = np.exp(-1.0 / (BREATHING_TIME * rate))
    innovations = rng.normal(0.0, np.sqrt(1.0 - rho**2), frames)
    innovations[0] = rng.normal()
    series: Float[np.ndarray, " N"] = np.clip(lfilter([1.0], [1.0, -rho], innovations), -2.5, 2.5)
    return series


def _jump(rng: np.random.Generator, positions: Float[np.ndarray, "N 10 3"], rate: float, per_second: float) -> None:
    """For one to three frames an arm is somewhere else, or left is right (in place)."""
    frames = len(positions)
    for _ in range(rng.poisson(per_second * frames / rate)):
        start = int(rng.integers(frames))
        slip = slice(start, start + int(rng.integers(1, 4)))
        left, right = ARMS
        if rng.random() < SWAPPED:
            positions[slip, left], positions[slip, right] = (
                positions[slip, right].copy(),
                positions[slip, left].copy(),
            )
            continue
        first = int(rng.choice([1, 2, 2, 4, 5, 5]))  # an elbow with its wrist, or a wrist alone
        direction = rng.normal(size=3)
        far = min(rng.exponential(0.2) + 0.08, 0.9 * LARGEST_JUMP / rate)
        positions[slip, first : 3 * (first // 3) + 3] += far * direction / np.linalg.norm(direction)


def _lose(rng: np.random.Generator, positions: Float[np.ndarray, "N 10 3"], share: float) -> None:
    """Runs of frames without a wrist, or without wrist and elbow (in place)."""
    for arm in ARMS:
        starts = np.flatnonzero(rng.random(len(positions)) < share / LOST_FRAMES)
        for start, length in zip(starts, rng.geometric(1.0 / LOST_FRAMES, len(starts)), strict=True):
            first = arm.stop - int(rng.integers(1, 3))
            positions[start : start + length, first : arm.stop] = np.nan
