"""Moves along a trajectory at any share of its speed, within the limits of speed, acceleration and jerk; by ruckig.

The arm stays on the planned path whatever the speed: only the path's clock s runs slower. With q(s) the path,
q̇ = q' ṡ, q̈ = q'' ṡ² + q' s̈, q⃛ = q''' ṡ³ + 3 q'' ṡ s̈ + q' s⃛; s̈ and s⃛ are kept so small that all three stay within the
arm's limits for every ṡ that may come (to brake, with a jerk of its own: `UR5.stop_jerk`), on the piece of the path
where the arm can be while ṡ changes: a motion that is slow, or still speeding up, brakes harder than one at its
fastest. Every way begins and ends at rest.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from kinecast.errors import MissingExtraError, OptionError
from kinecast.robot.trajectory import Trajectory
from kinecast.robot.ur5 import UR5

try:
    import ruckig
except ImportError as error:  # pragma: no cover - the tests install it
    raise MissingExtraError("the robot", "robot") from error

SHARE = np.array([0.9, 0.6, 0.4])
"""Of the arm's speed, acceleration and jerk that a motion may use by itself: the rest is for changes of its clock."""
STANDS = 1e-3  # slower than this the arm stands [rad/s]
SAME = 1e-6  # from here to there it need not move [rad]
SLOWEST = 1e-3  # speed [rad/s] from which on a motion's clock is limited by it
GENTLEST = 0.5  # change of the clock's rate [1/s] that is always left
FORESIGHT = 0.35  # the clock's rate changes, or comes to rest, within so long on the motion [s]
STEEPEST = (50.0, 2000.0)
"""Changes of the clock's rate that are never needed [1/s, 1/s^2]: a motion that hardly moves would allow any."""


class _Clock(NamedTuple):
    """Where a motion is: its time s [s] and the first two derivatives of s."""

    s: float = 0.0
    rate: float = 0.0
    change: float = 0.0


class Executor:
    """Says at each step of the control loop where the arm should be.

    Args:
        arm: its limits.
        dt: of the control loop [s].
        q: (6,) where the arm rests at first [rad].

    Attributes:
        q, qd, qdd: (6,) the state last given [rad, rad/s, rad/s^2].
        slider: share of every speed that it really takes, 0..1: that of the speed slider on a real arm.
    """

    def __init__(self, arm: UR5, dt: float, q: Float[np.ndarray, "6"]) -> None:
        self.arm, self.dt, self.slider = arm, dt, 1.0
        self.q, self.qd, self.qdd = np.array(q, dtype=np.float64), np.zeros(6), np.zeros(6)
        self._motion: _Motion | None = None
        self._clock, self._scale = _Clock(), 1.0
        self._ruckig, self._change = ruckig.Ruckig(1), ruckig.Trajectory(1)

    @property
    def done(self) -> bool:
        """It has arrived, or never had anywhere to go."""
        return self._motion is None

    @property
    def at_rest(self) -> bool:
        """It stands."""
        return bool(np.abs(self.qd).max() < STANDS)

    @property
    def remaining(self) -> float:
        """Time to the end at full speed [s]."""
        return 0.0 if self._motion is None else self._motion.duration - self._clock.s

    def follow(self, trajectory: Trajectory) -> None:
        """From now on goes along this trajectory, from its first waypoint; straight there first where it is not.

        That way is not planned, and is short if the start is near. A trajectory too fast for the arm is followed
        more slowly.

        Raises:
            OptionError: the arm moves.
        """
        if not self.at_rest:
            raise OptionError(f"another trajectory while the arm moves at {np.abs(self.qd).max():.3f} rad/s")
        ways = [trajectory]
        if np.abs(self.q - trajectory.q[0]).max() > SAME:
            ways.insert(0, Trajectory(np.array([0.0, 0.01]), np.stack([self.q, trajectory.q[0]])))
        self._motion = _Motion([within_limits(way, self.arm) for way in ways], self.arm)
        self._clock = _Clock(rate=self._scale)  # at rest it may start at any rate: q' and q'' are 0

    def step(self, scale: float = 1.0) -> Float[np.ndarray, "6"]:
        """Where the arm should be one step of the loop later.

        Args:
            scale: share of the planned speed, 0..1; 0 brakes on the path.

        Returns:
            Angles (6,) [rad], with the speeds and accelerations `qd` and `qdd` within the arm's limits.
        """
        self._scale = min(max(float(scale * self.slider), 0.0), 1.0) if np.isfinite(scale) else 0.0
        if self._motion is not None:
            self._clock = self._later(self._motion, self._clock, self._scale)
            self.q, self.qd, self.qdd = self._motion.at(self._clock)
            if self._clock.s >= self._motion.duration - 1e-9:
                self._motion, self.qd, self.qdd = None, np.zeros(6), np.zeros(6)
        return self.q

    def stopping(self, after: float = 0.0) -> tuple[Float[np.ndarray, "6"], float]:
        """Where the arm comes to rest if it brakes after a while [s] (6,) [rad], and when [s from now]."""
        if self._motion is None:
            return self.q, 0.0
        clock, steps = self._clock, 0
        while steps * self.dt < after - 1e-9:
            clock, steps = self._later(self._motion, clock, self._scale), steps + 1
        while clock.rate > 1e-6 and steps * self.dt < after + 5.0:
            clock, steps = self._later(self._motion, clock, 0.0), steps + 1
        return self._motion.at(clock)[0], steps * self.dt

    def _later(self, motion: _Motion, clock: _Clock, scale: float) -> _Clock:
        """The motion's clock one step later, its rate on the way to the scale."""
        wish = ruckig.InputParameter(1)
        wish.control_interface = ruckig.ControlInterface.Velocity
        wish.current_position, wish.current_velocity, wish.current_acceleration = ([each] for each in clock)
        wish.target_velocity, wish.target_acceleration = [scale], [0.0]
        change, jerk = motion.bounds(clock.s, clock.rate, scale < clock.rate)
        wish.max_acceleration, wish.max_jerk = [change], [jerk]
        self._ruckig.calculate(wish, self._change)
        (later,), (rate,), (change,) = self._change.at_time(self.dt)
        return _Clock(max(later, clock.s), min(max(rate, 0.0), 1.0), change)


def within_limits(trajectory: Trajectory, arm: UR5) -> Trajectory:
    """The motion as it is followed: slowed down where the arm could not follow."""
    return trajectory.within(SHARE[:, None] * np.stack([arm.max_speed, arm.max_acceleration, arm.max_jerk]))


class _Motion:
    """Trajectories one after another on one clock, and how much that clock's rate may change.

    Args:
        ways: each from where the last one ends.
        arm: its limits.
    """

    def __init__(self, ways: list[Trajectory], arm: UR5) -> None:
        self._ways, self._ends = ways, np.cumsum([way.duration for way in ways])
        self.duration = float(self._ends[-1])
        parts = [np.linspace(0.0, way.duration, 200) for way in ways]
        self._since = np.concatenate([end - part[-1] + part for end, part in zip(self._ends, parts, strict=True)])
        first, self._second, third = (
            np.concatenate([way.at(way.times[0] + part, order) for way, part in zip(ways, parts, strict=True)])
            for order in (1, 2, 3)
        )
        self._speed = np.maximum(np.abs(first), SLOWEST)
        self._speeding_up = np.sign(first) * self._second  # below 0 where the motion itself slows down
        self._jerk = np.abs(third)
        self._acceleration, self._max_jerk, self._stop_jerk = arm.max_acceleration, arm.max_jerk, arm.stop_jerk

    def at(self, clock: _Clock) -> tuple[Float[np.ndarray, "6"], Float[np.ndarray, "6"], Float[np.ndarray, "6"]]:
        """The arm's state at a clock's reading."""
        k = min(int(np.searchsorted(self._ends, clock.s, side="right")), len(self._ways) - 1)
        q, first, second = (
            self._ways[k].at(self._ways[k].times[-1] + clock.s - self._ends[k], order) for order in range(3)
        )
        return q, first * clock.rate, second * clock.rate**2 + first * clock.change

    def bounds(self, s: float, rate: float, braking: bool) -> tuple[float, float]:
        """Greatest sizes of s̈ [1/s] and s⃛ [1/s²], from s on at this rate, that keep within the arm's limits."""
        first = max(int(np.searchsorted(self._since, s)) - 1, 0)
        piece = slice(first, int(np.searchsorted(self._since, s + FORESIGHT)) + 1)
        speed, along = self._speed[piece], self._speeding_up[piece]
        # While it brakes the rate falls, and a motion that speeds up helps; while it does not, the rate may rise to 1.
        in_use = -np.minimum(along, 0.0) * rate**2 if braking else np.maximum(along, 0.0)
        left = np.maximum((self._stop_jerk if braking else self._max_jerk) - self._jerk[piece], 0.0)
        # What jerk is left is halved between 3 q'' ṡ s̈ and q' s⃛.
        change = min(
            float(((self._acceleration - in_use) / speed).min()),
            float((left / (6.0 * np.maximum(np.abs(self._second[piece]), SLOWEST))).min()),
        )
        change = min(max(change, GENTLEST), STEEPEST[0])
        return change, min(max(float((0.5 * left / speed).min()), 4 * GENTLEST), STEEPEST[1])
