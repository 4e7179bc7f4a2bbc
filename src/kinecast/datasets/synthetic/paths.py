"""Paths as people make them: minimum-jerk movements, one laid over the other."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

__all__ = ["Path", "Sway", "arch", "minimum_jerk"]

PEAK = 1.875
"""Peak over mean speed of a minimum-jerk movement: s'(1/2) = 15/8."""


def minimum_jerk(phase: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
    """s(τ) = 10 τ³ − 15 τ⁴ + 6 τ⁵, from 0 to 1, at rest outside (Flash & Hogan 1985)."""
    tau = np.clip(phase, 0.0, 1.0)
    s: Float[np.ndarray, "*n"] = tau**3 * (10.0 + tau * (-15.0 + 6.0 * tau))
    return s


def arch(phase: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
    """b(τ) = (20 u³ − 25 u⁴ + 8 u⁵) / 3 with u = 1 − |2τ − 1|: from 0 over 1 half-way to 0.

    d·s(τ) + v·b(τ) is the minimum-jerk movement by d through a via-point v off the middle of the straight
    line: the quintic spline that is at rest at both ends and smooth to the fourth derivative between.
    """
    u = 1.0 - np.abs(2.0 * np.clip(phase, 0.0, 1.0) - 1.0)
    b: Float[np.ndarray, "*n"] = u**3 * (20.0 + u * (-25.0 + 8.0 * u)) / 3.0
    return b


@dataclass(frozen=True)
class _Movement:
    """One displacement, with a via-point off its middle."""

    start: float
    duration: float
    displacement: Float[np.ndarray, " D"]
    via: Float[np.ndarray, " D"]


@dataclass
class Path:
    """A point that starts at rest and is moved again and again.

    A movement that begins before the last one has ended is added to it, as people do who change their mind
    in mid-reach (Flash & Henis 1991). All stays between the places moved to, as long as no movement
    overtakes the one before.
    """

    target: Float[np.ndarray, " D"]
    _start: Float[np.ndarray, " D"] = field(init=False)
    _movements: list[_Movement] = field(init=False, default_factory=list)

    def __post_init__(self) -> None:
        self._start = self.target

    def move(
        self,
        start: float,
        duration: float,
        target: Float[np.ndarray, " D"],
        via: Float[np.ndarray, " D"] | None = None,
    ) -> None:
        """Add a movement from the last target to a new one.

        Args:
            start, duration: [s].
            target: (D,) where it ends.
            via: (D,) offset of the via-point from the middle of the straight line; none if straight.
        """
        offset = np.zeros_like(target) if via is None else via
        self._movements.append(_Movement(start, duration, target - self.target, offset))
        self.target = target

    def at(self, times: Float[np.ndarray, " N"]) -> Float[np.ndarray, "N D"]:
        """(N, D) where it is at times [s]."""
        position = np.tile(self._start, (len(times), 1))
        for movement in self._movements:
            phase = (times - movement.start) / movement.duration
            position += minimum_jerk(phase)[:, None] * movement.displacement
            position += arch(phase)[:, None] * movement.via
        return position


class Sway:
    """Slow wandering that nobody intends: three sines per coordinate, between 0.1 and 0.5 Hz."""

    def __init__(self, rng: np.random.Generator, amplitude: Float[np.ndarray, " D"]) -> None:
        self._frequency = rng.uniform(0.1, 0.5, (3, len(amplitude)))
        self._phase = rng.uniform(0.0, 2 * np.pi, (3, len(amplitude)))
        self._amplitude = amplitude / 3

    def at(self, times: Float[np.ndarray, " N"]) -> Float[np.ndarray, "N D"]:
        """(N, D) offset at times [s], within ± the amplitude."""
        angle = 2 * np.pi * self._frequency * times[:, None, None] + self._phase
        offset: Float[np.ndarray, "N D"] = self._amplitude * np.sin(angle).sum(axis=1)
        return offset
