"""CHOMP beside RRTConnect on seeded random problems; plans and decisions beside a generated person.

python -m benchmarks.planning [--problems N] [--seconds S] [--episodes N] [--out JSON]

A problem: a UR5 on a table, a start and a goal, both free, and ten capsules put across the straight way between them.
RRTConnect (OMPL) has 2000 steps of about 0.5 ms for each of S seconds, ten by default; kinecast's planner (CHOMP, and
RRTConnect as its seed where CHOMP stays stuck) may begin S searches of 2000 steps. No setting was chosen on these
problems. Every plan is then looked at again, twice as finely as the planner does.
"""

from __future__ import annotations

import argparse
import time
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from benchmarks.machine import facts, milliseconds, save
from kinecast.geometry.scene import Scene
from kinecast.geometry.shapes import Box, Capsule
from kinecast.robot.cell import Cell
from kinecast.robot.chomp import Chomp
from kinecast.robot.collaboration import generated_person, predictor_named
from kinecast.robot.collision import LOOKS, CollisionChecker
from kinecast.robot.planner import SCENE_MARGINS, WAYPOINTS, NoPlan, Planner, searched
from kinecast.robot.simulated_person import Camera, ReactivePerson
from kinecast.robot.simulation import Simulation
from kinecast.robot.trajectory import Trajectory, minimum_jerk
from kinecast.robot.ur5 import UR5

CAPSULES = 10
STEPS = 2000
"""Of a search, for each second."""
FIRST_SEED = 1000
"""Of the problems: step sizes were chosen on those of the seeds below 60."""
RADIUS = (0.04, 0.10)
"""Of the capsules [m]: from a wrist to an upper arm in its sleeve."""
FREE = 0.03
"""So far from both ends of the way [m]."""
TABLE = Box(np.array([0.0, 0.0, -0.05]), np.array([2.4, 2.4, 0.1]))


def main() -> None:
    """Times, prints, writes."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--problems", type=int, default=200)
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--episodes", type=int, default=4)
    parser.add_argument("--out", type=Path)
    arguments = parser.parse_args()
    before = facts()
    result = {
        **random_problems(arguments.problems, arguments.seconds),
        "descent": descent(min(arguments.problems, 100)),
        "cell": decisions(arguments.episodes),
    }
    save("planning", result, arguments.out, before)
    report(result)


@dataclass(frozen=True, eq=False)
class Problem:
    """From a start to a goal past what stands around."""

    start: Float[np.ndarray, "6"]
    goal: Float[np.ndarray, "6"]
    scene: Scene


def problem(rng: np.random.Generator) -> Problem:
    """A random problem: free at both ends, and capsules across the straight way."""
    arm, checker = UR5(), CollisionChecker(UR5(), Scene((TABLE,)))
    while True:
        ends = np.stack([_free(checker, rng), _free(checker, rng)])
        if 0.5 < np.abs(ends[1] - ends[0]).max() < np.pi:
            break
    links = arm.capsules(ends)
    share = rng.uniform(0.15, 0.85, (400, 1))
    between = arm.capsules(ends[0] + share * (ends[1] - ends[0]))
    capsules: list[Capsule] = []
    for start, end in zip(between[..., :3], between[..., 3:6], strict=True):
        link = rng.integers(between.shape[1])
        centre = start[link] + rng.random() * (end[link] - start[link]) + rng.normal(0.0, 0.05, 3)
        half = 0.5 * rng.uniform(0.1, 0.5) * _direction(rng)
        capsule = Capsule(centre - half, centre + half, rng.uniform(*RADIUS))
        if (capsule.segment_distance(links[..., :3], links[..., 3:6]) - links[..., 6]).min() > FREE:
            capsules.append(capsule)
        if len(capsules) == CAPSULES:
            return Problem(ends[0], ends[1], Scene((TABLE, *capsules)))
    return problem(rng)


def _free(checker: CollisionChecker, rng: np.random.Generator) -> Float[np.ndarray, "6"]:
    """A configuration that touches neither the table nor itself."""
    while True:
        q = rng.uniform(-np.pi, np.pi, 6)
        if not checker.touched(q, 0.02):
            return q


def _direction(rng: np.random.Generator) -> Float[np.ndarray, "3"]:
    direction = rng.standard_normal(3)
    return direction / np.linalg.norm(direction)


def random_problems(count: int, seconds: float) -> dict[str, Any]:
    """Which of the problems each planner solves, in what time; plans are looked at again."""
    solved: dict[str, list[bool]] = {"rrt_connect": [], "kinecast": []}
    took: dict[str, list[float]] = {"rrt_connect": [], "kinecast": []}
    hits, clearances = 0, []
    _warm()
    for seed in range(FIRST_SEED, FIRST_SEED + count):
        task = problem(np.random.default_rng(seed))
        planner = Planner(UR5(), task.scene, searches=max(1, round(seconds)), iterations=STEPS)
        begin = time.perf_counter()
        path = searched(planner.checker, task.start, task.goal[None], 0.0, round(STEPS * seconds), seed)
        took["rrt_connect"].append(time.perf_counter() - begin)
        solved["rrt_connect"].append(path is not None)
        begin = time.perf_counter()
        plan = planner.plan(task.start, task.goal[None], 0.0)
        took["kinecast"].append(time.perf_counter() - begin)
        solved["kinecast"].append(not isinstance(plan, NoPlan))
        if not isinstance(plan, NoPlan):
            clearance = least_clearance(planner.checker, plan)
            clearances.append(clearance)
            hits += clearance < 0
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
        "share_of_rrt_connect": float(both.sum() / max(reference.sum(), 1)),
        "unsolved_seeds": (FIRST_SEED + np.flatnonzero(reference & ~np.array(solved["kinecast"]))).tolist(),
        "recheck_collisions": hits,
        "least_clearance_mm": 1e3 * float(np.min(clearances)),
    }


def least_clearance(checker: CollisionChecker, trajectory: Trajectory) -> float:
    """Least distance [m] of the arm to the scene or itself, looked at twice as finely as the planner does."""
    q = trajectory.at(checker.looks(trajectory, 0.5 * LOOKS[0]))
    return min(min(checker.clearance(each)) for each in q)


def descent(count: int) -> dict[str, Any]:
    """The descent alone on the same problems, from the straight way."""
    arm, seconds, free = UR5(), [], 0
    for seed in range(count):
        task = problem(np.random.default_rng(seed))
        straight = task.start + minimum_jerk(WAYPOINTS)[:, None] * (task.goal - task.start)
        begin = time.perf_counter()
        _, excess = Chomp(arm, task.scene.rows(np.zeros(1))[0]).optimise(straight, SCENE_MARGINS[0])
        seconds.append(time.perf_counter() - begin)
        free += excess > 0
    return {"waypoints": WAYPOINTS, "free": int(free), **milliseconds(seconds)}


def decisions(episodes: int, limit: float = 60.0) -> dict[str, Any]:
    """Frame in to decision out, and the plans beside it, in generated episodes."""
    latencies: list[float] = []
    plannings: list[float] = []
    for seed in range(FIRST_SEED - 1, FIRST_SEED + episodes):
        cell = Cell()
        people = [ReactivePerson(generated_person(seed, cell))]
        simulation = Simulation(people, predictor_named("kinecast", people), Camera(seed=seed), cell, limit=limit)
        deque(simulation.steps(), maxlen=0)
        if seed >= FIRST_SEED:  # in the one before everything is compiled
            latencies += simulation.episode.latencies
            plannings += simulation.episode.plannings
    return {"decision": milliseconds(latencies), "plan": milliseconds(plannings)}


def _warm() -> None:
    """Compiles everything once."""
    task = problem(np.random.default_rng(10_000))
    Planner(UR5(), task.scene).plan(task.start, task.goal[None], 0.0)


def report(result: Mapping[str, Any]) -> None:
    """Prints the tables."""
    print(f"{'planner':16}{'solved':>8}{'p50 ms':>10}{'p99 ms':>10}")
    for name, row in result["planners"].items():
        print(f"{name:16}{row['solved']:8d}{row['p50_ms']:10.1f}{row['p99_ms']:10.1f}")
    share, seconds = 100 * result["share_of_rrt_connect"], result["seconds"]
    print(f"{result['problems']} problems; {share:.1f} % of what RRTConnect solves in {seconds:.0f} s")
    print(f"a finer look finds {result['recheck_collisions']} collisions")
    row = result["descent"]
    print(f"{'descent':16}{row['free']:8d}{row['p50_ms']:10.2f}{row['p99_ms']:10.2f}")
    for name, row in result["cell"].items():
        print(f"{name:24}{row['p50_ms']:10.2f}{row['p99_ms']:10.2f}")


if __name__ == "__main__":
    main()
