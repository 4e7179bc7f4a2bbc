"""Obstacles that move: a shape carried along, without turning."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from jaxtyping import Float

from kinecast.errors import OptionError
from kinecast.geometry.shapes import Shape

__all__ = ["ConstantVelocity", "Motion", "MovingObstacle", "Waypoints"]


@dataclass(frozen=True, eq=False)
class ConstantVelocity:
    """x(t) = x0 + v (t − since).

    Attributes:
        velocity: (3,) [m/s].
        since: time [s] at which the shape is where it was defined.
    """

    velocity: Float[np.ndarray, " 3"]
    since: float = 0.0

    def __post_init__(self) -> None:
        velocity = np.array(self.velocity, dtype=np.float64)
        if velocity.shape != (3,) or not np.all(np.isfinite(velocity)):
            raise OptionError(f"velocity {velocity.tolist()} m/s must be three finite numbers")
        if not np.isfinite(self.since):
            raise OptionError(f"since {self.since} s must be finite")
        object.__setattr__(self, "velocity", velocity)

    def origins(self, start: Float[np.ndarray, " 3"], times: Float[np.ndarray, " T"]) -> Float[np.ndarray, "T 3"]:
        """(T, 3) origins [m] at times [s]."""
        return start + self.velocity * (times - self.since)[:, None]


@dataclass(frozen=True, eq=False)
class Waypoints:
    """Straight from place to place; at rest before the first time and after the last.

    Attributes:
        times: (K,) increasing [s].
        positions: (K, 3) of the shape's origin [m].
    """

    times: Float[np.ndarray, " K"]
    positions: Float[np.ndarray, "K 3"]

    def __post_init__(self) -> None:
        times = np.array(self.times, dtype=np.float64)
        positions = np.array(self.positions, dtype=np.float64)
        if times.ndim != 1 or positions.shape != (len(times), 3) or len(times) == 0:
            raise OptionError(
                f"waypoints: {positions.shape} positions for {times.shape} times, expected (K, 3) for (K,)"
            )
        if not (np.all(np.isfinite(times)) and np.all(np.isfinite(positions))):
            raise OptionError("waypoints: times and positions must be finite")
        if not np.all(np.diff(times) > 0):
            raise OptionError(f"waypoints: times must increase, found {times.tolist()} s")
        object.__setattr__(self, "times", times)
        object.__setattr__(self, "positions", positions)

    def origins(
        self,
        start: Float[np.ndarray, " 3"],  # noqa: ARG002
        times: Float[np.ndarray, " T"],
    ) -> Float[np.ndarray, "T 3"]:
        """(T, 3) origins [m] at times [s], wherever the shape was defined."""
        return np.stack([np.interp(times, self.times, axis) for axis in self.positions.T], axis=-1)


Motion: TypeAlias = ConstantVelocity | Waypoints
"""Where the origin of a shape is over time."""


@dataclass(frozen=True, eq=False)
class MovingObstacle:
    """A shape and where it goes.

    Attributes:
        shape: the obstacle as it is when its motion starts.
        motion: where its origin is over time.
    """

    shape: Shape
    motion: Motion

    def rows(self, times: Float[np.ndarray, " T"]) -> Float[np.ndarray, "T 17"]:
        """(T, ROW) the shape at each time [s] (kinecast.geometry.distances)."""
        rows = self.shape.rows(times)
        rows[:, 1:4] = self.motion.origins(self.shape.origin, times)
        return rows
