"""One start, and the checked motions that lead from it to a goal."""

from __future__ import annotations

import time
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
from jaxtyping import Float

from kinecast.errors import OptionError
from kinecast.geometry.shapes import Capsule
from kinecast.robot.chomp import ChompOptions, Surroundings, optimise, smoothest
from kinecast.robot.collision import Clearance, CollisionChecker
from kinecast.robot.execution import SHARE
from kinecast.robot.occupancy import Occupancy
from kinecast.robot.seeding import evenly
from kinecast.robot.trajectory import Trajectory
from kinecast.robot.ur5 import LINKS

__all__ = ["Attempt", "PlannerOptions"]

LEG = 14
"""Waypoints of a straight leg between two corners."""


@dataclass(frozen=True)
class PlannerOptions:
    """How plans are made.

    Attributes:
        speed: greatest speed of an angle [rad/s]: half of what the arm can do, as beside people nothing is gained by
            more.
        acceleration: greatest acceleration of an angle [rad/s^2]: less than half of the arm's, the rest is for braking.
        jerk: greatest jerk of an angle [rad/s^3]: less than half of the arm's.
        shortest: duration of the shortest motion [s].
        straight_goals: goals tried from a straight way, nearest first.
        seeded: attempts from a searched path.
        search_iterations: most of one search, about 0.2 ms each; with a budget without end, plans then depend only
            on the question.
        chomp: of the descent.
    """

    speed: float = 1.57
    acceleration: float = 4.0
    jerk: float = 75.0
    shortest: float = 0.4
    straight_goals: int = 2
    seeded: int = 2
    search_iterations: int = 400
    chomp: ChompOptions = field(default_factory=ChompOptions)

    def __post_init__(self) -> None:
        for name in ("speed", "acceleration", "jerk", "shortest"):
            if not 0 < getattr(self, name) < np.inf:
                raise OptionError(f"{name} {getattr(self, name)} must be above 0")


class Attempt:
    """One start among one set of people, and the motions that lead from it to a goal."""

    def __init__(
        self,
        checker: CollisionChecker,
        options: PlannerOptions,
        q: Float[np.ndarray, "6"],
        occupancy: Occupancy,
        start_time: float,
        velocity: Float[np.ndarray, "6"] | None = None,
        acceleration: Float[np.ndarray, "6"] | None = None,
    ) -> None:
        self.checker = checker
        self.arm = checker.arm
        self.options = options
        self.q = np.asarray(q, dtype=np.float64)
        self.occupancy = occupancy
        self.start_time = start_time
        self.velocity = np.zeros(6) if velocity is None else np.asarray(velocity, dtype=np.float64)
        self.acceleration = np.zeros(6) if acceleration is None else np.asarray(acceleration, dtype=np.float64)
        self.moving = bool(self.velocity.any() or self.acceleration.any())

    def bad_start(self) -> str:
        """Why nothing can start here; empty where something can."""
        if not np.isfinite(np.concatenate([self.q, self.velocity, self.acceleration])).all():
            return "the arm's state is not known"
        [(person, scene, own)] = self.checker.clearances(self.q[None], np.array([self.start_time]), self.occupancy)
        if scene < 0 or own < 0:
            return "the arm touches the scene or itself"
        return "the arm is in a person's region" if person < 0 else ""

    def duration(
        self, goal: Float[np.ndarray, "6"], start: Float[np.ndarray, "6"] | None = None, longer: float = 1.0
    ) -> float:
        """Of a motion of least jerk from rest to rest, `longer` than the straight way, within the limits [s]."""
        options = self.options
        way = longer * float(np.abs(goal - (self.q if start is None else start)).max())
        # Peaks of 10 s³ − 15 s⁴ + 6 s⁵: speed 15/8, acceleration 10/√3, jerk 60.
        return max(
            1.875 * way / options.speed,
            float(np.sqrt(5.7735 * way / options.acceleration)),
            float(np.cbrt(60.0 * way / options.jerk)),
            options.shortest,
        )

    def solve(
        self, goal: Float[np.ndarray, "6"], corners: Float[np.ndarray, "M 6"] | None = None, until: float = np.inf
    ) -> tuple[Trajectory, Clearance] | str:
        """A checked trajectory to one goal, or what was in its way.

        Args:
            goal: (6,) [rad].
            corners: of a path to begin with; straight without.
            until: no descent but the first is begun later than this [s, time.perf_counter].
        """
        chomp = self.options.chomp
        count = chomp.waypoints
        path, duration = self._along(goal, corners, count)
        duration = self._slowed(goal, duration)
        reference = self._smoothest(goal, duration, count)
        path = reference if path is None else path
        blocked = ""
        for _ in range(4):
            if blocked and time.perf_counter() > until:
                break
            times = self.start_time + np.linspace(0.0, duration, count)
            path, excess, _ = optimise(self.arm, path, reference, self.surroundings(times), chomp)
            trajectory = Trajectory(times, path, self.velocity, self.acceleration)
            stretch = self._stretch(trajectory)
            if stretch > 1.0:
                blocked = "its own speed"
                duration *= stretch
                before, reference = reference, self._smoothest(goal, duration, count)
                path = path + reference - before  # a moving start leads on differently at another pace
                continue
            clearance = self.checker.check(trajectory, self.occupancy)
            if clearance.free:
                return trajectory, clearance
            blocked = clearance.what
            if excess <= 0:
                break  # stuck: wider margins would not free it
            chomp = replace(chomp, person_margin=chomp.person_margin + 0.01, scene_margin=chomp.scene_margin + 0.005)
        return f"{blocked} is in the way"

    def bent(
        self,
        goal: Float[np.ndarray, "6"],
        corners: Float[np.ndarray, "M 6"] | None,
        people: Occupancy,
        slowing: tuple[float, float, float, float, float],
        chomp: ChompOptions,
    ) -> Trajectory | None:
        """A way that bends where monitoring would slow the arm down beside people; None where it meets the scene."""
        path, duration = self._along(goal, corners, chomp.waypoints)
        reference = self._smoothest(goal, duration, chomp.waypoints)
        times = self.start_time + np.linspace(0.0, duration, chomp.waypoints)
        surroundings = replace(self.surroundings(times), capsules=people.rows_at(times), slowing=slowing)
        path, _, _ = optimise(self.arm, reference if path is None else path, reference, surroundings, chomp)
        trajectory = Trajectory(times, path)
        for _ in range(3):
            stretch = self._stretch(trajectory)
            if stretch <= 1.0:
                break
            trajectory = trajectory.stretched(stretch)
        return trajectory if self.checker.check(trajectory, self.occupancy).free else None

    def _along(
        self, goal: Float[np.ndarray, "6"], corners: Float[np.ndarray, "M 6"] | None, count: int
    ) -> tuple[Float[np.ndarray, "W 6"] | None, float]:
        """Waypoints along corners, if there are any, and the time that this way takes from rest [s]."""
        if corners is None:
            return None, self.duration(goal)
        s = np.linspace(0.0, 1.0, count)
        path = evenly(corners, 10 * s**3 - 15 * s**4 + 6 * s**5)
        longer = float(np.abs(np.diff(path, axis=0)).sum(axis=0).max() / max(np.abs(goal - self.q).max(), 0.1))
        return path, self.duration(goal, longer=max(longer, 1.0))

    def legs(self, corners: Float[np.ndarray, "M 6"]) -> tuple[Trajectory, Clearance] | str:
        """A checked trajectory straight from corner to corner, at rest in each, or what was in its way."""
        if self.moving:
            return "its own speed is in the way"
        s = np.linspace(0.0, 1.0, LEG)[1:]
        share = 10 * s**3 - 15 * s**4 + 6 * s**5
        times, q = [np.array([self.start_time])], [corners[:1]]
        for start, end in pairwise(corners):
            times.append(times[-1][-1] + s * self.duration(end, start))
            q.append(start + share[:, None] * (end - start))
        trajectory = Trajectory(np.concatenate(times), np.concatenate(q))
        clearance = self.checker.check(trajectory, self.occupancy)
        return (trajectory, clearance) if clearance.free else f"{clearance.what} is in the way"

    def _smoothest(self, goal: Float[np.ndarray, "6"], duration: float, count: int) -> Float[np.ndarray, "W 6"]:
        return smoothest(self.q, goal, count, duration / (count - 1), self.velocity, self.acceleration)

    def _slowed(self, goal: Float[np.ndarray, "6"], duration: float) -> float:
        """The duration, made long enough for a moving start [s]: it may have to turn round first."""
        if not self.moving:
            return duration
        for _ in range(4):
            times = self.start_time + np.linspace(0.0, duration, self.options.chomp.waypoints)
            q = self._smoothest(goal, duration, len(times))
            trajectory = Trajectory(times, q, self.velocity, self.acceleration)
            stretch = self._stretch(trajectory)
            if stretch <= 1.0:
                break
            duration *= stretch
        return duration

    def _stretch(self, trajectory: Trajectory) -> float:
        """How much longer a trajectory should take to be within speed, acceleration and jerk; 1 where it is within."""
        allowed = np.array([self.options.speed, self.options.acceleration, self.options.jerk])
        if self.moving:  # it cannot simply be slowed down: all that execution leaves for it may be used
            arm = self.arm
            allowed = SHARE * np.array([arm.max_speed.min(), arm.max_acceleration.min(), arm.max_jerk.min()])
        used = np.array([peak.max() for peak in trajectory.peaks(100)])
        stretch = float(((used / allowed) ** (1.0 / np.array([1, 2, 3]))).max())
        return float(min(max(1.02 * stretch, 1.05), 2.0)) if stretch > 1.02 else 1.0

    def surroundings(self, times: Float[np.ndarray, " W"]) -> Surroundings:
        """What is in the way of waypoints at these times [s]; the arm's own pedestal too, from the elbow on."""
        pedestal = np.repeat(Capsule(*self.arm.pedestal).row[None, None], len(times), axis=0)
        rows = np.concatenate([self.checker.scene.rows(times), pedestal], axis=1)
        first_link = np.append(self.checker.first_link, LINKS.index("elbow"))
        return Surroundings(self.occupancy.rows_at(times), rows, first_link)
