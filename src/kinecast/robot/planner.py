"""Plans: CHOMP first, from a straight way; where it fails, from a path that RRTConnect found; always checked finely."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from kinecast.geometry.scene import Scene
from kinecast.robot.attempt import Attempt, PlannerOptions
from kinecast.robot.collision import CollisionChecker
from kinecast.robot.occupancy import Occupancy
from kinecast.robot.pick_place import nearest, postures
from kinecast.robot.seeding import Seeder
from kinecast.robot.separation import SeparationOptions
from kinecast.robot.trajectory import Trajectory
from kinecast.robot.ur5 import UR5

__all__ = ["BEGUN_BY", "NoPlan", "Plan", "Planner", "PlannerOptions"]

SEARCH_MARGINS = ((0.01, 0.003, 0.003), (0.001, 0.003, 0.003), (0.001, 0.0, 0.0))
"""Kept by searched paths from persons' regions, from the scene and from the arm itself [m], in turn: what follows them
cuts corners."""
GOALS_AT_ONCE = 24
ENOUGH_GOALS = 8
"""Free goals that are enough; they are looked for by so many at once."""
BEGUN_BY = 0.6
"""Share of the budget after which nothing new is begun: what is under way takes its time."""
WANTED = 1.0
"""Speed of a body point that the arm wants beside people [m/s]: about what it reaches on the way to a cube."""
DRAWN_IN = (0.3, 0.3)
"""Distance from the arm's axis and height of a hand that is drawn in [m]."""
ROOM = 0.1
ROOM_WORTH = 2.0
"""So much room around a goal [m], from persons, the scene and the arm itself, is worth a later arrival [s/m]."""


@dataclass(frozen=True)
class Plan:
    """A motion that was checked.

    Attributes:
        trajectory: from the start to one of the goals.
        clearance: least distance to persons' regions along it [m], no more than 2 m.
        solved_by: `chomp`, `chomp from rrt` or `rrt`.
        milliseconds: it took to plan.
        goal: index of the goal it leads to.
    """

    trajectory: Trajectory
    clearance: float
    solved_by: str
    milliseconds: float
    goal: int = 0


@dataclass(frozen=True)
class NoPlan:
    """No motion was found.

    Attributes:
        reason: in words.
        milliseconds: it took to find that out.
    """

    reason: str
    milliseconds: float = 0.0


class Planner:
    """Plans motions of an arm in a scene among people.

    Args:
        arm: the arm.
        scene: what stands around it.
        options: see PlannerOptions.
    """

    def __init__(self, arm: UR5, scene: Scene | None = None, options: PlannerOptions | None = None) -> None:
        self.arm = arm
        self.options = options or PlannerOptions()
        self.checker = CollisionChecker(arm, scene)

    @property
    def scene(self) -> Scene:
        """What stands around the arm."""
        return self.checker.scene

    def plan(
        self,
        q: Float[np.ndarray, "6"],
        goals: Float[np.ndarray, "G 6"],
        occupancy: Occupancy,
        start_time: float,
        budget: float = 0.1,
        velocity: Float[np.ndarray, "6"] | None = None,
        acceleration: Float[np.ndarray, "6"] | None = None,
        seed: int = 0,
    ) -> Plan | NoPlan:
        """A motion to whichever goal is reached soonest and free.

        Args:
            q: (6,) where the arm is at the start time [rad].
            goals: (G, 6) [rad], any of them will do.
            occupancy: where people may be, each at its time.
            start_time: when the motion starts [s], on the occupancy's clock.
            budget: time until an answer is due [s]; past 0.6 of it no descent is begun any more.
            velocity, acceleration: (6,) of the arm at the start, if it is moving [rad/s, rad/s^2].
            seed: of the search.

        Returns:
            A plan that was checked, or why there is none.
        """
        begin = time.perf_counter()
        job = Attempt(self.checker, self.options, q, occupancy, start_time, velocity, acceleration)
        answer: Plan | str = self._attempt(job, np.asarray(goals, dtype=np.float64), begin + BEGUN_BY * budget, seed)
        took = 1e3 * (time.perf_counter() - begin)
        return NoPlan(answer, took) if isinstance(answer, str) else replace(answer, milliseconds=took)

    def bent(
        self,
        plan: Plan,
        q: Float[np.ndarray, "6"],
        goals: Float[np.ndarray, "G 6"],
        people: Occupancy,
        start_time: float,
        separation: SeparationOptions,
    ) -> Iterator[Plan]:
        """Ways to where a plan leads that bend where speed would be lost beside people: from its own side, and inside.

        Args:
            plan: with nobody there.
            q: (6,) where the arm rests at the start time [rad].
            goals: (G, 6) of the plan [rad].
            people: where they may be; they are no obstacles, they cost time.
            start_time: [s].
            separation: of monitoring.
        """
        job = Attempt(self.checker, self.options, q, Occupancy.empty(start_time), start_time)
        half = separation.least_speed + separation.braking * separation.reaction
        slowing = (separation.constant, half, separation.braking, WANTED, 0.3)
        chomp = replace(self.options.chomp, person_margin=0.0, waypoints=24, least_iterations=25, most_iterations=40)
        goal = goals[plan.goal]
        for corners in (None, *self._inside(q, goal)):
            trajectory = job.bent(goal, corners, people, slowing, chomp)
            if trajectory is not None:
                yield Plan(trajectory, plan.clearance, "chomp", 0.0, plan.goal)

    def _inside(self, q: Float[np.ndarray, "6"], goal: Float[np.ndarray, "6"]) -> list[Float[np.ndarray, "3 6"]]:
        """Corners of a way past the arm's own foot, the hand drawn in; none where it cannot be."""
        start, end = (self.arm.forward_kinematics(each)[:3, 3] for each in (q, goal))
        turn = 0.5 * (math.atan2(start[1], start[0]) + math.atan2(end[1], end[0]))
        T = np.diag([1.0, -1.0, -1.0, 1.0])
        T[:3, 3] = DRAWN_IN[0] * math.cos(turn), DRAWN_IN[0] * math.sin(turn), DRAWN_IN[1]
        found = nearest(postures(self.arm, T), 0.5 * (q + goal), self.arm.q_range, 1)
        return [np.stack([q, middle, goal]) for middle in found]

    def _attempt(self, job: Attempt, goals: Float[np.ndarray, "G 6"], end: float, seed: int) -> Plan | str:
        """A plan, or the reason why there is none."""
        options = self.options
        reason = job.bad_start()
        if reason:
            return reason
        order, arrivals, reason = self._usable(job, goals)
        if reason:
            return reason
        blocked = ""
        for k in order[: options.straight_goals]:
            found = job.solve(goals[k], until=end)
            if isinstance(found, tuple):
                return Plan(found[0], found[1].person, "chomp", 0.0, int(k))
            blocked = found
            if time.perf_counter() > end:
                return f"{blocked}; no time left"
        last = float(arrivals[order].min())
        for attempt in range(options.seeded):
            left = end - time.perf_counter()
            if left <= 0:
                return f"{blocked}; no way around it found in time"
            # Wide ways first; half of the time is kept for narrow ones.
            margins = SEARCH_MARGINS[attempt % len(SEARCH_MARGINS)]
            corners = self._way_around(job, goals[order], last, margins, 0.5 * left, seed + attempt)
            if corners is None:
                continue
            k = int(order[np.abs(goals[order] - corners[-1]).max(axis=1).argmin()])
            found = job.solve(goals[k], corners, end)
            if isinstance(found, tuple):
                return Plan(found[0], found[1].person, "chomp from rrt", 0.0, k)
            found = job.legs(corners)
            if isinstance(found, tuple):
                return Plan(found[0], found[1].person, "rrt", 0.0, k)
            blocked = found
        return f"{blocked}; no way around it"

    def _way_around(
        self,
        job: Attempt,
        goals: Float[np.ndarray, "G 6"],
        last: float,
        margins: tuple[float, float, float],
        seconds: float,
        seed: int,
    ) -> Float[np.ndarray, "M 6"] | None:
        """Corners of a path past all that may be filled until the end, or, where that leaves no way, soon, or now."""
        duration = last - job.start_time
        for share in (1.0, 0.5, 0.0):
            times = job.start_time + duration * share * np.linspace(0.0, 1.0, 5)
            seeder = Seeder(self.checker, job.occupancy, times, margins)
            if seeder.keeps(job.q) and any(seeder.keeps(goal) for goal in goals):
                return seeder.path(job.q, goals, seconds, self.options.search_iterations, seed)
        return None

    def _usable(
        self, job: Attempt, goals: Float[np.ndarray, "G 6"]
    ) -> tuple[Int[np.ndarray, " U"], Float[np.ndarray, " G"], str]:
        """Goals that are free on arrival, the best first: soon reached, with room around; arrivals [s]; why none is."""
        if len(goals) == 0 or goals.shape[1:] != (6,) or not np.isfinite(goals).all():
            return np.empty(0, dtype=np.int64), np.empty(len(goals)), "the goal is out of reach"
        arrivals = job.start_time + np.array([job.duration(goal) for goal in goals])
        soonest = np.argsort(arrivals, kind="stable")
        reason = "the goal is blocked by the scene or the arm itself"
        found: dict[int, float] = {}
        for some in np.array_split(soonest, max(len(soonest) // GOALS_AT_ONCE, 1)):
            clear = self.checker.clearances(goals[some], arrivals[some], job.occupancy)
            stands = (clear[:, 1:] > 0).all(axis=1)
            if stands.any():
                reason = "the goal is in a person's region"
            price = arrivals[some] - ROOM_WORTH * np.minimum(clear, ROOM).sum(axis=1)
            free = stands & (clear[:, 0] > 0.5 * self.checker.step)
            found.update(zip(some[free].tolist(), price[free].tolist(), strict=True))
            if len(found) >= ENOUGH_GOALS:
                break
        best = sorted(found, key=lambda goal: found[goal])
        return np.array(best, dtype=np.int64), arrivals, "" if found else reason
