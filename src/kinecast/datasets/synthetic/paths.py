"""Paths as people make them: minimum-jerk movements, one laid over the other."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from jaxtyping import Float

Point: TypeAlias = Float[np.ndarray, " D"]
Phase: TypeAlias = Float[np.ndarray, "*n"]

PEAK = 1.875
"""Peak over mean speed of a minimum-jerk movement: s'(1/2) = 15/8."""


def minimum_jerk(phase: Phase) -> Phase:
    """s(τ) = 10 τ³ − 15 τ⁴ + 6 τ⁵, from 0 to 1, at rest outside (Flash & Hogan 1985)."""
    tau = np.clip(phase, 0.0, 1.0)
    return np.multiply(tau**3, 10.0 + tau * (-15.0 + 6.0 * tau))


def arch(phase: Phase) -> Phase:
    """b(τ) = (20 u³ − 25 u⁴ + 8 u⁵) / 3 with u = 1 − |2τ − 1|: from 0 over 1 half-way to 0.

    d·s(τ) + v·b(τ) is the minimum-jerk movement by d through a via-point v off the middle of the straight
    line: the quintic spline that is at rest at both ends and smooth to the fourth derivative between.
    """
    u = 1.0 - np.abs(2.0 * np.clip(phase, 0.0, 1.0) - 1.0)
    return np.divide(u**3 * (20.0 + u * (-25.0 + 8.0 * u)), 3.0)


class Path:
    """A point that starts at rest and is moved again and again.

    A movement that begins before the last one has ended is added to it, as people do who change their mind
    in mid-reach (Flash & Henis 1991).
    """

    def __init__(self, start: Point) -> None:
        self.target = self._start = start
        self._movements: list[tuple[float, float, Point, Point | float]] = []

    def move(self, start: float, duration: float, target: Point, via: Point | float = 0.0) -> None:
        """Move on to a target from a time [s] on; `via` is how far the via-point is off the middle of the way."""
        self._movements.append((start, duration, target - self.target, via))
        self.target = target

    def at(self, times: Float[np.ndarray, " N"]) -> Float[np.ndarray, "N D"]:
        """(N, D) where it is at times [s]."""
        position = np.tile(self._start, (len(times), 1))
        for start, duration, displacement, via in self._movements:
            phase = ((times - start) / duration)[:, None]
            position += minimum_jerk(phase) * displacement
            position += arch(phase) * via
        return position


class Sway:
    """Slow wandering that nobody intends: three sines per coordinate, between 0.1 and 0.5 Hz."""

    def __init__(self, rng: np.random.Generator, amplitude: Point) -> None:
        self._frequency = rng.uniform(0.1, 0.5, (3, len(amplitude)))
        self._phase = rng.uniform(0.0, 2 * np.pi, (3, len(amplitude)))
        self._amplitude = amplitude / 3

    def at(self, times: Float[np.ndarray, " N"]) -> Float[np.ndarray, "N D"]:
        """(N, D) offset at times [s], within ± the amplitude."""
        angle = 2 * np.pi * self._frequency * times[:, None, None] + self._phase
        return np.multiply(self._amplitude, np.sin(angle).sum(axis=1))
