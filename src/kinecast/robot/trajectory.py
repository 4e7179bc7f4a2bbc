"""A timed path of the arm, from rest to rest: waypoints joined by a smooth spline."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.interpolate import BSpline, make_interp_spline


def minimum_jerk(count: int) -> Float[np.ndarray, " count"]:
    """(count,) shares 10 s³ − 15 s⁴ + 6 s⁵ of the way from rest to rest of least jerk, evenly spaced in time.

    The greatest speed is 15/8 of the mean; of a way of 1 in a time of 1 the greatest acceleration is 10/√3, jerk 60.
    """
    s = np.linspace(0.0, 1.0, count)
    return 10 * s**3 - 15 * s**4 + 6 * s**5


def rest_to_rest(times: Float[np.ndarray, " W"], values: Float[np.ndarray, "W D"]) -> BSpline:
    """The quintic spline through values at these times, without speed and acceleration at both ends."""
    still = [(1, np.zeros(values.shape[1])), (2, np.zeros(values.shape[1]))]
    ends: Any = (still, still)  # as SciPy documents; its stubs know the simple forms only
    return make_interp_spline(times, values, k=5, bc_type=ends)


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Waypoints joined by a quintic spline from rest to rest: angle, speed and acceleration are continuous."""

    times: Float[np.ndarray, " W"]  # increasing, W of 2 or more [s], on the clock of the frames' stamps
    q: Float[np.ndarray, "W 6"]  # [rad]

    @property
    def duration(self) -> float:
        """From the first waypoint to the last [s]."""
        return float(self.times[-1] - self.times[0])

    @cached_property
    def _splines(self) -> tuple[BSpline, ...]:
        """The spline over the time since its start, and its three derivatives."""
        spline = rest_to_rest(self.times - self.times[0], self.q)
        return (spline, *(spline.derivative(order) for order in (1, 2, 3)))

    def at(self, t: float | Float[np.ndarray, " N"], order: int = 0) -> Float[np.ndarray, "*N 6"]:
        """Angles (…, 6) at time t [s] [rad], or their derivative of an order up to 3; at rest before and after."""
        since = np.asarray(t, dtype=np.float64) - self.times[0]
        within = np.clip(since, 0.0, self.duration)
        values: Float[np.ndarray, "*N 6"] = self._splines[order](within)
        return values if order == 0 else np.where((since == within)[..., None], values, 0.0)

    def within(self, limits: Float[np.ndarray, "3 *D"], tolerance: float = 1.0) -> Trajectory:
        """The same path from the same start time, slowed down to limits of speed, acceleration and jerk.

        If it needs no more than `tolerance` times its time it stays as it is; others are slowed to as much less.
        """
        rates = np.abs([self.at(np.linspace(self.times[0], self.times[-1], 200), order) for order in (1, 2, 3)])
        used = (rates.max(axis=1) / np.reshape(limits, (3, -1))).max(axis=1)
        excess = float((used ** (1.0 / np.array([1, 2, 3]))).max())
        if excess <= tolerance:
            return self
        return Trajectory(self.times[0] + tolerance * excess * (self.times - self.times[0]), self.q)
