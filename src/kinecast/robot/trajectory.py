"""A timed path of the arm: waypoints joined by a smooth spline."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.interpolate import BSpline, make_interp_spline

from kinecast.errors import OptionError

__all__ = ["Trajectory"]


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Waypoints joined by a quintic spline that ends at rest: angle, speed and acceleration are continuous.

    Attributes:
        times: (W,) increasing, W of 2 or more [s], on the clock of the frames' stamps.
        q: (W, 6) [rad].
        start_velocity: (6,) at the first waypoint [rad/s]; at rest by default.
        start_acceleration: (6,) there [rad/s^2].

    Raises:
        OptionError: fewer than two waypoints, times that do not increase, or anything not finite.
    """

    times: Float[np.ndarray, " W"]
    q: Float[np.ndarray, "W 6"]
    start_velocity: Float[np.ndarray, "6"] = field(default_factory=lambda: np.zeros(6))
    start_acceleration: Float[np.ndarray, "6"] = field(default_factory=lambda: np.zeros(6))

    def __post_init__(self) -> None:
        if len(self.times) < 2 or len(self.q) != len(self.times):
            raise OptionError(f"{len(self.q)} waypoints for {len(self.times)} times: at least two, one for each")
        parts = (self.times, self.q, self.start_velocity, self.start_acceleration)
        if not all(np.isfinite(part).all() for part in parts):
            raise OptionError("a trajectory must be finite")
        if not np.all(np.diff(self.times) > 0):
            raise OptionError(f"a trajectory's times must increase, found {self.times.tolist()} s")

    @property
    def duration(self) -> float:
        """From the first waypoint to the last [s]."""
        return float(self.times[-1] - self.times[0])

    @cached_property
    def _splines(self) -> tuple[BSpline, ...]:
        """The spline over the time since its start, and its three derivatives."""
        since = self.times - self.times[0]
        first = [(1, self.start_velocity), (2, self.start_acceleration)]
        last = [(1, np.zeros(6)), (2, np.zeros(6))]
        ends: Any = (first, last)  # as SciPy documents; its stubs know the simple forms only
        spline = make_interp_spline(since, self.q, k=5, bc_type=ends)
        return (spline, spline.derivative(1), spline.derivative(2), spline.derivative(3))

    def at(self, t: float | Float[np.ndarray, " N"]) -> tuple[Float[np.ndarray, "*N 6"], Float[np.ndarray, "*N 6"]]:
        """Angles [rad] and speeds [rad/s] at time t [s]; at rest before its start and after its end."""
        q, qd = self._evaluate(t, 2)
        return q, qd

    def derivatives(self, t: float | Float[np.ndarray, " N"]) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Angles, speeds, accelerations and jerks (…, 6) at t [s]; at rest before its start and after its end.

        At the very start it has its start velocity.
        """
        q, qd, qdd, qddd = self._evaluate(t, 4)
        return q, qd, qdd, qddd

    def _evaluate(self, t: float | Float[np.ndarray, " N"], count: int) -> list[np.ndarray]:
        """Angles and as many of their derivatives as are asked for, `count` in all."""
        since = np.asarray(t, dtype=np.float64) - self.times[0]
        within = np.clip(since, 0.0, self.duration)
        moving = (since == within)[..., None]
        q, *rates = (spline(within) for spline in self._splines[:count])
        return [q, *(np.where(moving, rate, 0.0) for rate in rates)]

    def delayed(self, seconds: float) -> Trajectory:
        """The same motion, later."""
        return Trajectory(self.times + seconds, self.q, self.start_velocity, self.start_acceleration)

    def stretched(self, factor: float) -> Trajectory:
        """The same path in `factor` times the time, from the same start time."""
        times = self.times[0] + factor * (self.times - self.times[0])
        return Trajectory(times, self.q, self.start_velocity / factor, self.start_acceleration / factor**2)

    def peaks(self, count: int = 200) -> tuple[Float[np.ndarray, "6"], Float[np.ndarray, "6"], Float[np.ndarray, "6"]]:
        """(6,) greatest speed [rad/s], acceleration [rad/s^2] and jerk [rad/s^3] of each angle, at `count` instants."""
        _, qd, qdd, qddd = self.derivatives(np.linspace(self.times[0], self.times[-1], count))
        return np.abs(qd).max(axis=0), np.abs(qdd).max(axis=0), np.abs(qddd).max(axis=0)
