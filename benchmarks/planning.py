"""CHOMP beside RRTConnect on seeded random problems; replans beside a person; the batched signed distance.

python -m benchmarks.planning [--problems N] [--seconds S] [--replans N] [--episodes N] [--out JSON]

A problem: a UR5 on a table, a start and a goal, both free, and ten capsules put across the straight way between them.
RRTConnect (OMPL) has S seconds, ten by default; kinecast's planner (CHOMP, and RRTConnect as its seed where CHOMP stays
stuck) may begin something new for as long. No setting was chosen on these problems. Every plan is then looked at again,
twice as finely as the planner does, by coal alone. A replan: an arm in motion beside a person whose samples are made up
here; no predictor takes part.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from benchmarks.machine import facts, milliseconds, save
from kinecast.geometry.scene import Scene
from kinecast.geometry.shapes import Box
from kinecast.robot.attempt import Attempt
from kinecast.robot.camera import Camera
from kinecast.robot.cell import Cell
from kinecast.robot.chomp import optimise, smoothest
from kinecast.robot.collaboration import generated_person, predictor_named
from kinecast.robot.collision import CollisionChecker
from kinecast.robot.occupancy import Occupancy, OccupancyOptions, occupied
from kinecast.robot.person import ReactivePerson
from kinecast.robot.planner import BEGUN_BY, Plan, Planner, PlannerOptions
from kinecast.robot.seeding import Seeder
from kinecast.robot.simulation import Simulation
from kinecast.robot.trajectory import Trajectory
from kinecast.robot.ur5 import UR5
from kinecast.types import Prediction

CAPSULES = 10
UNLIMITED = 10**9
FIRST_SEED = 1000
"""Of the problems: step sizes were chosen on those of the seeds below 60."""
RADIUS = (0.04, 0.10)
"""Of the capsules [m]: from a wrist to an upper arm in its sleeve."""
TABLE = Scene((Box(np.array([0.0, 0.0, -0.05]), np.array([2.4, 2.4, 0.1])),))


def main() -> None:
    """Times, prints, writes."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--problems", type=int, default=200)
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--replans", type=int, default=300)
    parser.add_argument("--episodes", type=int, default=4)
    parser.add_argument("--out", type=Path)
    arguments = parser.parse_args()
    before = facts()
    result = {
        **random_problems(arguments.problems, arguments.seconds),
        "descent": descent(min(arguments.problems, 100)),
        "replan": replans(arguments.replans),
        "signed_distance": signed_distance(),
        "cell": decisions(arguments.episodes),
    }
    save("planning", result, arguments.out, before)
    report(result)


@dataclass(frozen=True, eq=False)
class Problem:
    """From a start to a goal past capsules that stay."""

    start: Float[np.ndarray, "6"]
    goal: Float[np.ndarray, "6"]
    occupancy: Occupancy


def problem(checker: CollisionChecker, rng: np.random.Generator) -> Problem:
    """A random problem: free at both ends, and a capsule across the straight way."""
    while True:
        ends = _free(checker, rng), _free(checker, rng)
        if 0.5 < np.abs(ends[1] - ends[0]).max() < np.pi:
            break
    share = rng.uniform(0.15, 0.85, (400, 1))
    between = checker.arm.capsules(ends[0] + share * (ends[1] - ends[0]))
    rows: list[np.ndarray] = []
    for start, end in zip(between.start, between.end, strict=True):
        link = rng.integers(len(between.radius))
        centre = start[link] + rng.random() * (end[link] - start[link]) + rng.normal(0.0, 0.05, 3)
        half = 0.5 * rng.uniform(0.1, 0.5) * _direction(rng)
        row = np.concatenate([centre - half, centre + half, [rng.uniform(*RADIUS)]])
        if checker.clearances(np.array(ends), np.zeros(2), _staying(np.array([row])))[:, 0].min() > 0.03:
            rows.append(row)
        if len(rows) == CAPSULES:
            return Problem(*ends, _staying(np.array(rows)))
    return problem(checker, rng)


def _free(checker: CollisionChecker, rng: np.random.Generator) -> Float[np.ndarray, "6"]:
    """A configuration that touches neither the table nor itself."""
    while True:
        q = rng.uniform(-np.pi, np.pi, 6)
        if (checker.clearances(q[None], np.zeros(1), Occupancy.empty()) > 0.02).all():
            return q


def _direction(rng: np.random.Generator) -> Float[np.ndarray, "3"]:
    direction = rng.standard_normal(3)
    return direction / np.linalg.norm(direction)


def _staying(rows: Float[np.ndarray, "K 7"]) -> Occupancy:
    """Capsules that neither move nor grow."""
    return Occupancy(0.0, np.zeros(1), rows[None, :, :3], rows[None, :, 3:6], rows[None, :, 6], 0.0, 0.0)


def random_problems(count: int, seconds: float, look: float = 0.005) -> dict[str, Any]:
    """Which of the problems each planner solves, in what time; plans are looked at again every `look` [m]."""
    planner = Planner(UR5(), TABLE, PlannerOptions(search_iterations=UNLIMITED, seeded=UNLIMITED))
    checker = planner.checker
    solved: dict[str, list[bool]] = {"rrt_connect": [], "kinecast": []}
    took: dict[str, list[float]] = {"rrt_connect": [], "kinecast": []}
    by: dict[str, int] = {}
    hits, clearances = 0, []
    _warm(planner)
    for seed in range(FIRST_SEED, FIRST_SEED + count):
        task = problem(checker, np.random.default_rng(seed))
        begin = time.perf_counter()
        path = Seeder(checker, task.occupancy, np.zeros(1), (0.0, 0.0, 0.0)).path(
            task.start, task.goal[None], seconds, UNLIMITED, seed
        )
        took["rrt_connect"].append(time.perf_counter() - begin)
        solved["rrt_connect"].append(path is not None)
        begin = time.perf_counter()
        plan = planner.plan(task.start, task.goal[None], task.occupancy, 0.0, budget=seconds / BEGUN_BY, seed=seed)
        took["kinecast"].append(time.perf_counter() - begin)
        solved["kinecast"].append(isinstance(plan, Plan))
        if isinstance(plan, Plan):
            by[plan.solved_by] = by.get(plan.solved_by, 0) + 1
            clearances.append(plan.clearance)
            hits += meets_anything(checker, plan.trajectory, task.occupancy, look)
    reference = np.array(solved["rrt_connect"])
    both = reference & np.array(solved["kinecast"])
    return {
        "problems": count,
        "seconds": seconds,
        "capsules": CAPSULES,
        "planners": {
            name: {
                "solved": int(np.sum(solved[name])),
                **milliseconds(took[name]),
                "p50_solved_ms": 1e3 * float(np.median(np.array(took[name])[np.array(solved[name])])),
            }
            for name in solved
        },
        "solved_by": by,
        "share_of_rrt_connect": float(both.sum() / max(reference.sum(), 1)),
        "unsolved_seeds": (FIRST_SEED + np.flatnonzero(reference & ~np.array(solved["kinecast"]))).tolist(),
        "recheck_collisions": hits,
        "least_clearance_mm": 1e3 * float(np.min(clearances)),
    }


def meets_anything(checker: CollisionChecker, trajectory: Trajectory, occupancy: Occupancy, look: float) -> bool:
    """Whether coal alone finds anything touched, looking every `look` [m] of the arm's way."""
    times = checker.looks(trajectory, look)
    q, _ = trajectory.at(times)
    return any(checker.touched(q, times, occupancy))


def descent(count: int) -> dict[str, Any]:
    """The descent alone, 40 waypoints, on the same problems, from the straight way."""
    planner = Planner(UR5(), TABLE)
    options = planner.options.chomp
    seconds, free = [], 0
    for seed in range(count):
        task = problem(planner.checker, np.random.default_rng(seed))
        times, dt = np.linspace(0.0, 2.0, options.waypoints), 2.0 / (options.waypoints - 1)
        attempt = Attempt(planner.checker, planner.options, task.start, task.occupancy, 0.0)
        surroundings = attempt.surroundings(times)
        begin = time.perf_counter()
        straight = smoothest(task.start, task.goal, options.waypoints, dt, np.zeros(6), np.zeros(6))
        _, excess, _ = optimise(planner.arm, straight, straight, surroundings, options)
        seconds.append(time.perf_counter() - begin)
        free += excess > 0
    return {"waypoints": options.waypoints, "free": int(free), **milliseconds(seconds)}


def person(rng: np.random.Generator, now: float) -> Prediction:
    """A person across the table whose right hand reaches over it, as samples that spread with time."""
    times = now + np.arange(1, 16) / 30
    left = np.array([[-1.2, 0.2, 0.5], [-1.12, 0.3, 0.25], [-0.9, 0.25, 0.15]])
    arms = np.concatenate([left, left * [1, -1, 1]])
    target = np.array([rng.uniform(-0.8, -0.5), rng.uniform(-0.4, 0.4), rng.uniform(0.05, 0.25)])
    progress = np.clip((np.arange(1, 16) / 15)[:, None], 0, 1) * rng.uniform(0.2, 1.0)
    mean = np.repeat(arms[None], 15, axis=0)
    mean[:, 5] += progress * (target - arms[5])
    mean[:, 4] += 0.4 * progress * (target - arms[5])
    spread = 0.035 * (np.arange(1, 16) / 15)[:, None, None]
    samples = mean + spread * rng.standard_normal((1000, 1, 6, 3)) * np.array([0.2, 0.6, 1, 0.2, 0.6, 1])[:, None]
    return Prediction(now, times, samples, mean, np.zeros((15, 6, 3, 3)), ("joint",) * 6)


def replans(count: int) -> dict[str, Any]:
    """Plans for an arm in motion, with the planner's budget of 0.1 s, to a place above the table."""
    arm = UR5()
    planner = Planner(arm, TABLE)
    rng = np.random.default_rng(0)
    home = _poses(planner, np.array([-0.35, -0.35, 0.25]))
    home = home[np.abs(home).max(axis=1).argsort()][:1]
    _warm(planner)
    occupied([person(rng, 0.0)], 0.0)
    took, found, regions, reasons = [], 0, [], {}
    for _ in range(count):
        place = np.array([rng.uniform(-0.55, -0.25), rng.uniform(0.1, 0.45), rng.uniform(0.12, 0.3)])
        goals = arm.inverse_kinematics(_down(place))
        first = planner.plan(home[0], goals, Occupancy.empty(), 0.0)
        if not isinstance(first, Plan):
            continue
        now = rng.uniform(0.1, 0.4) * first.trajectory.duration
        q, qd, qdd, _ = first.trajectory.derivatives(now)
        begin = time.perf_counter()
        occupancy = occupied([person(rng, now)], now + 0.03, OccupancyOptions())
        regions.append(time.perf_counter() - begin)
        begin = time.perf_counter()
        plan = planner.plan(q, goals, occupancy, now + 0.1, velocity=qd, acceleration=qdd)
        took.append(time.perf_counter() - begin)
        found += isinstance(plan, Plan)
        if not isinstance(plan, Plan):
            reasons[plan.reason] = reasons.get(plan.reason, 0) + 1
    return {"found": found, "reasons": reasons, **milliseconds(took), "region": milliseconds(regions)}


def decisions(episodes: int, limit: float = 60.0) -> dict[str, Any]:
    """Frame in to decision out, and the plans beside it, in generated episodes: by the clock and in processor time.

    Clocks of a busy machine also count whoever else computes on it.
    """
    result: dict[str, Any] = {}
    for name, clock in (("clock", time.perf_counter), ("processor", time.process_time)):
        latencies: list[float] = []
        plannings: list[float] = []
        for seed in range(FIRST_SEED, FIRST_SEED + episodes):
            cell = Cell()
            people = [ReactivePerson(generated_person(seed, cell))]
            predict = predictor_named("kinecast", people)
            simulation = Simulation(people, predict, Camera(seed=seed), cell, limit=limit, clock=clock)
            episode = simulation.run()
            if name == "clock" and seed == FIRST_SEED:
                continue  # in which everything is compiled
            latencies += episode.latencies
            plannings += episode.plannings
        result[name] = {"decision": milliseconds(latencies), "plan": milliseconds(plannings)}
    return result


def _down(place: Float[np.ndarray, "3"]) -> Float[np.ndarray, "4 4"]:
    """A tool at a place that points down."""
    T = np.diag([1.0, -1.0, -1.0, 1.0])
    T[:3, 3] = place
    return T


def _poses(planner: Planner, place: Float[np.ndarray, "3"]) -> Float[np.ndarray, "B 6"]:
    """Free configurations with the tool at a place, pointing down."""
    q = planner.arm.inverse_kinematics(_down(place))
    return q[(planner.checker.clearances(q, np.zeros(len(q)), Occupancy.empty()) > 0.01).all(axis=1)]


def _warm(planner: Planner) -> None:
    """Compiles everything once."""
    task = problem(planner.checker, np.random.default_rng(10_000))
    planner.plan(task.start, task.goal[None], task.occupancy, 0.0, budget=1.0)
    Seeder(planner.checker, task.occupancy, np.zeros(1), (0.0, 0.0, 0.0)).path(
        task.start, task.goal[None], 1.0, UNLIMITED
    )


def signed_distance(repeats: int = 200) -> dict[str, Any]:
    """50 waypoints, the body points of all links, 60 moving capsules, with the gradient."""
    arm, rng = UR5(), np.random.default_rng(0)
    points = arm.body_points(rng.uniform(-3, 3, (50, 6))).positions
    middle = rng.normal(0.0, 0.6, (15, 60, 3))
    half = rng.normal(0.0, 0.1, (15, 60, 3))
    occupancy = Occupancy(0.0, np.arange(1, 16) / 30, middle - half, middle + half, np.full((15, 60), 0.08))
    when = np.linspace(0.0, 1.0, 50)
    occupancy.signed_distance(points, when)
    seconds = []
    for _ in range(repeats):
        begin = time.perf_counter()
        occupancy.signed_distance(points, when)
        seconds.append(time.perf_counter() - begin)
    return {"waypoints": 50, "points": points.shape[1], "capsules": 60, **milliseconds(seconds)}


def report(result: Mapping[str, Any]) -> None:
    """Prints the tables."""
    print(f"{'planner':16}{'solved':>8}{'p50 ms':>10}{'p99 ms':>10}")
    for name, row in result["planners"].items():
        print(f"{name:16}{row['solved']:8d}{row['p50_ms']:10.1f}{row['p99_ms']:10.1f}")
    share, seconds = 100 * result["share_of_rrt_connect"], result["seconds"]
    print(f"{result['problems']} problems; {share:.1f} % of what RRTConnect solves in {seconds:.0f} s")
    print(f"by {result['solved_by']}; a finer look finds {result['recheck_collisions']} collisions")
    for name in ("descent", "replan", "signed_distance"):
        row = result[name]
        print(f"{name:16}{'':8}{row['p50_ms']:10.2f}{row['p99_ms']:10.2f}")
    for clock, rows in result["cell"].items():
        for name, row in rows.items():
            print(f"{name + ' by ' + clock:24}{row['p50_ms']:10.2f}{row['p99_ms']:10.2f}")
    print(f"replans that found a way: {result['replan']['found']} of {result['replan']['count']}")


if __name__ == "__main__":
    main()
