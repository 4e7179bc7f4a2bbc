"""Moves along a trajectory at any share of its speed, within the limits of speed, acceleration and jerk; by ruckig.

The arm stays on the planned path whatever the speed: only the path's clock s runs slower. With q(s) the path,
q̇ = q' ṡ, q̈ = q'' ṡ² + q' s̈, q⃛ = q''' ṡ³ + 3 q'' ṡ s̈ + q' s⃛; s̈ and s⃛ are kept so small that all three stay within the
arm's limits for every ṡ that may come (to brake, with a jerk of its own: `UR5.stop_jerk`), on the piece of the path
where the arm can be while ṡ changes: a motion that is slow, or still speeding up, brakes harder than one at its
fastest. Where the arm is not on a new trajectory, ruckig leads over to it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from kinecast.errors import MissingExtraError, OptionError
from kinecast.robot.trajectory import Trajectory
from kinecast.robot.ur5 import UR5

try:
    import ruckig
except ImportError as error:  # pragma: no cover - the tests install it
    raise MissingExtraError("the robot", "robot") from error

__all__ = ["Executor", "within_limits"]

SHARE = np.array([0.9, 0.6, 0.4])
"""Of the arm's speed, acceleration and jerk that a motion may use by itself: the rest is for changes of its clock."""
SAME = (1e-6, 1e-5, 1e-3)
"""Differences in angle [rad], speed [rad/s] and acceleration [rad/s^2] up to which two states are one."""
SLOWEST = 1e-3
"""Speed [rad/s] from which on a motion's clock is limited by it."""
GENTLEST = 0.5
"""Change of the clock's rate [1/s] that is always left."""
FORESIGHT = 0.35
"""The clock's rate changes, or comes to rest, within so long on the motion [s]."""
STEEPEST = (50.0, 2000.0)
"""Changes of the clock's rate that are never needed [1/s, 1/s^2]: a motion that hardly moves would allow any."""


@dataclass(frozen=True)
class _Clock:
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
    """

    def __init__(self, arm: UR5, dt: float, q: Float[np.ndarray, "6"] | None = None) -> None:
        if not 0 < dt <= 0.1:
            raise OptionError(f"dt {dt} s is outside (0, 0.1]")
        self.arm = arm
        self.dt = dt
        self.q = np.zeros(6) if q is None else np.array(q, dtype=np.float64)
        self.qd = np.zeros(6)
        self.qdd = np.zeros(6)
        self._limits = np.stack([arm.max_speed, arm.max_acceleration, arm.max_jerk])
        self._motions: list[_Path | _Bridge] = []
        self._clock = _Clock()
        self._pace = ruckig.Ruckig(1)
        self._change = ruckig.Trajectory(1)
        self._passed = 0.0  # duration of the motions that are behind [s]
        self._scale = 1.0

    @property
    def done(self) -> bool:
        """It has arrived, or never had anywhere to go."""
        return not self._motions

    @property
    def at_rest(self) -> bool:
        """It stands."""
        return bool(np.abs(self.qd).max() < 1e-3)

    @property
    def progress(self) -> float:
        """Time since the first waypoint of the trajectory at which the arm is [s]; below 0 on the way there."""
        return self._clock.s - sum(motion.duration for motion in self._motions[:-1])

    @property
    def remaining(self) -> float:
        """Time to the end at full speed [s]."""
        return sum(motion.duration for motion in self._motions) - self._clock.s

    def follow(self, trajectory: Trajectory) -> None:
        """From now on goes along this trajectory, from its first waypoint, joined smoothly from the present state.

        Where the state is that of the trajectory's start, the path is followed exactly. Else ruckig leads over to the
        start as fast as the limits allow; the way there is not planned, and is short if the start is near. A
        trajectory too fast for the arm is followed more slowly.
        """
        path = _Path(within_limits(trajectory, self.arm))
        start = path.derivatives(0.0)
        # At rest the clock may start at any rate: q' and q'' are 0 there.
        rest = np.abs(start[1]).max() <= SAME[1] and np.abs(start[2]).max() <= SAME[2]
        same = all(
            np.abs(a - b).max() <= tolerance for a, b, tolerance in zip(self._state(), start, SAME, strict=False)
        )
        if same:
            self._motions = [path]
            self._clock = _Clock(0.0, self._scale if rest else 1.0, 0.0)
        else:
            self._motions = [_Bridge(self._state(), start, self._limits), path]
            self._clock = _Clock(0.0, 1.0, 0.0)
        self._passed = 0.0
        self._bounds = _ClockBounds(self._motions, self.arm)

    def step(self, scale: float = 1.0) -> tuple[Float[np.ndarray, "6"], Float[np.ndarray, "6"], Float[np.ndarray, "6"]]:
        """Where the arm should be one step of the loop later.

        Args:
            scale: share of the planned speed, 0..1; 0 brakes on the path.

        Returns:
            Angles (6,) [rad], speeds (6,) [rad/s] and accelerations (6,) [rad/s^2], within the arm's limits.
        """
        self._scale = min(max(float(scale), 0.0), 1.0) if np.isfinite(scale) else 0.0
        if self._motions:
            self._clock = self._later(self._clock, self._scale)
            while self._motions and self._clock.s >= self._motions[0].duration - 1e-9:
                passed = self._motions.pop(0)
                self._passed += passed.duration
                self._clock = _Clock(self._clock.s - passed.duration, self._clock.rate, self._clock.change)
                if not self._motions:
                    self.q, self.qd, self.qdd = passed.derivatives(passed.duration)[0], np.zeros(6), np.zeros(6)
                    self._clock = _Clock()
                    return self._state()
            self.q, self.qd, self.qdd = self._at(self._clock)
        return self._state()

    def stopping(self, after: float = 0.0) -> tuple[Float[np.ndarray, "6"], float]:
        """Where the arm comes to rest if it brakes after a while [s] (6,) [rad], and when [s from now]."""
        clock, steps = self._clock, 0
        while steps * self.dt < after - 1e-9 and self._motions:
            clock, steps = self._later(clock, self._scale), steps + 1
        while clock.rate > 1e-6 and self._motions and steps * self.dt < after + 5.0:
            clock, steps = self._later(clock, 0.0), steps + 1
        return self._at(clock)[0], steps * self.dt

    def _state(self) -> tuple[Float[np.ndarray, "6"], Float[np.ndarray, "6"], Float[np.ndarray, "6"]]:
        return self.q, self.qd, self.qdd

    def _later(self, clock: _Clock, scale: float) -> _Clock:
        """The motion's clock one step later, its rate on the way to the scale."""
        wish = ruckig.InputParameter(1)
        wish.control_interface = ruckig.ControlInterface.Velocity
        wish.current_position, wish.current_velocity, wish.current_acceleration = (
            [clock.s], [clock.rate], [clock.change],
        )  # fmt: skip
        wish.target_velocity, wish.target_acceleration = [scale], [0.0]
        change, jerk = self._bounds.at(self._passed + clock.s, clock.rate, scale < clock.rate)
        wish.max_acceleration, wish.max_jerk = [change], [jerk]
        self._pace.calculate(wish, self._change)
        (later,), (rate,), (change,) = self._change.at_time(self.dt)
        return _Clock(max(later, clock.s), min(max(rate, 0.0), 1.0), change)

    def _at(self, clock: _Clock) -> tuple[Float[np.ndarray, "6"], Float[np.ndarray, "6"], Float[np.ndarray, "6"]]:
        """The arm's state at a clock's reading."""
        s = clock.s
        for motion in self._motions:
            if s < motion.duration:
                q, first, second = motion.derivatives(s)
                return q, first * clock.rate, second * clock.rate**2 + first * clock.change
            s -= motion.duration
        if not self._motions:
            return self.q, np.zeros(6), np.zeros(6)
        last = self._motions[-1]
        return last.derivatives(last.duration)[0], np.zeros(6), np.zeros(6)


def within_limits(trajectory: Trajectory, arm: UR5) -> Trajectory:
    """The motion as it is followed: slowed down where the arm could not follow."""
    limits = np.stack([arm.max_speed, arm.max_acceleration, arm.max_jerk])
    slower = trajectory.excess(SHARE[:, None] * limits)
    return trajectory if slower <= 1 else trajectory.stretched(slower)


class _Path:
    """A trajectory as a motion of its own clock."""

    def __init__(self, trajectory: Trajectory) -> None:
        self.trajectory = trajectory
        self.duration = self.trajectory.duration

    def derivatives(self, s: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Angles and their first two derivatives by the clock."""
        q, first, second = self.trajectory.derivatives(self.trajectory.times[0] + min(s, self.duration), 2)
        return q, first, second

    def profile(self) -> tuple[np.ndarray, np.ndarray]:
        """M instants (M,) and the first three derivatives there (M, 3, 6)."""
        since = np.linspace(0.0, self.duration, 200)
        return since, np.stack(self.trajectory.derivatives(self.trajectory.times[0] + since)[1:], axis=1)


class _Bridge:
    """The fastest way from one state to another within a share of the limits."""

    def __init__(
        self,
        start: tuple[np.ndarray, np.ndarray, np.ndarray],
        end: tuple[np.ndarray, np.ndarray, np.ndarray],
        limits: Float[np.ndarray, "3 6"],
    ) -> None:
        wish = ruckig.InputParameter(6)
        wish.current_position, wish.current_velocity, wish.current_acceleration = (part.tolist() for part in start)
        wish.target_position, wish.target_velocity, wish.target_acceleration = (part.tolist() for part in end)
        shares = SHARE[:, None] * limits
        wish.max_velocity, wish.max_acceleration, wish.max_jerk = (part.tolist() for part in shares)
        self._way = ruckig.Trajectory(6)
        result = ruckig.Ruckig(6).calculate(wish, self._way)
        if result != ruckig.Result.Working:
            raise OptionError(
                f"no motion leads from {start[0].tolist()} to {end[0].tolist()} within the limits: {result}"
            )
        self.duration = float(self._way.duration)
        self._jerk = limits[2] * SHARE[2]

    def derivatives(self, s: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Angles and their first two derivatives by the clock."""
        q, first, second = (np.array(part) for part in self._way.at_time(min(s, self.duration)))
        return q, first, second

    def profile(self) -> tuple[np.ndarray, np.ndarray]:
        """M instants (M,) and the first three derivatives there (M, 3, 6); ruckig's jerk is always the greatest."""
        since = np.linspace(0.0, self.duration, 100)
        return since, np.array([[*self.derivatives(s)[1:], self._jerk] for s in since])


class _ClockBounds:
    """Greatest sizes of s̈ and s⃛ at which acceleration and jerk stay within the limits.

    Args:
        motions: one after another.
        arm: its limits.
    """

    def __init__(self, motions: list[_Path | _Bridge], arm: UR5) -> None:
        profiles = [motion.profile() for motion in motions]
        begins = np.cumsum([0.0, *(motion.duration for motion in motions[:-1])])
        self._since = np.concatenate([begin + since for begin, (since, _) in zip(begins, profiles, strict=True)])
        first, self._second, third = np.moveaxis(np.concatenate([parts for _, parts in profiles]), 1, 0)
        self._speed = np.maximum(np.abs(first), SLOWEST)
        self._speeding_up = np.sign(first) * self._second  # below 0 where the motion itself slows down
        self._jerk = np.abs(third)
        self._acceleration, self._max_jerk, self._stop_jerk = arm.max_acceleration, arm.max_jerk, arm.stop_jerk

    def at(self, since: float, rate: float, braking: bool) -> tuple[float, float]:
        """From so long after the first motion's start [s] on, at a rate of the clock: s̈ [1/s] and s⃛ [1/s²]."""
        first = max(int(np.searchsorted(self._since, since)) - 1, 0)
        piece = slice(first, int(np.searchsorted(self._since, since + FORESIGHT)) + 1)
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
