"""What nobody could avoid: the time that the people cost an arm that knows all they will do.

python -m benchmarks.least_time [--episodes N] [--first SEED] [--cell lab|camera|certified] [--data FOLDER] [--out JSON]

The people are those of benchmarks.collaboration, and mind no arm. For every order of the cubes the arm goes the
straight ways, one after another without a pause, and is rolled forward under monitoring beside what each person truly
does (kinecast.robot.expected_time). The best order's time, less the best with nobody there, could be avoided only by a
way that bends, by waiting elsewhere, or by people who give way. It knows the whole episode, which no oracle of half a
second does.
"""

from __future__ import annotations

import argparse
import os
from itertools import permutations
from pathlib import Path

import numpy as np

from benchmarks.collaboration import person, recordings
from benchmarks.machine import RESULTS, facts, save
from kinecast.body.skeleton import ARM_JOINTS
from kinecast.robot.body import body_capsules
from kinecast.robot.cell import CELLS, Cell, cell_named
from kinecast.robot.choice import Option, grasp_rows
from kinecast.robot.expected_time import travel_time
from kinecast.robot.motions import STEP
from kinecast.robot.pick_place import GraspConfigurations, Step
from kinecast.robot.planner import NoPlan, Planner
from kinecast.robot.simulated_person import Person
from kinecast.robot.simulation import UPRIGHT
from kinecast.robot.ur5 import UR5

LONGEST = 120.0
"""Of an episode [s]."""


class Ways:
    """The straight ways of all orders, looked for once.

    Args:
        cell: with the cubes, and the constants of monitoring.
    """

    def __init__(self, cell: Cell) -> None:
        self.arm, self.cell = UR5(), cell
        self._planner, self._places = Planner(self.arm, cell.scene), GraspConfigurations(self.arm, cell)
        self._rows: dict[tuple[str, ...], list[np.ndarray]] = {}

    def rows(self, order: tuple[str, ...]) -> list[np.ndarray]:
        """(W, 6) of each way to a cube and to its place, in an order of the cubes: `STEP` apart [rad]."""
        if order not in self._rows:
            before = self.rows(order[:-1]) if order else []
            found, q = list(before), before[-1][-1] if before else self._places.rest(UPRIGHT)[0]
            for step, point in (
                ((Step.REACH, self.cell.cube(order[-1]).position), (Step.CARRY, self.cell.cube(order[-1]).place))
                if order
                else ()
            ):
                option = Option(step, order[-1], self._places.above(point, q), point)
                plan = self._planner.plan(q, option.goals, 0.0)
                if isinstance(plan, NoPlan):
                    raise SystemExit(f"no way {step.value} ({order[-1]}): {plan.reason}")
                found.append(grasp_rows(self.arm, self.cell, plan, option))
                q = found[-1][-1]
            self._rows[order] = found
        return self._rows[order]

    def least_time(self, somebody: Person | None) -> float:
        """Of the best order, beside what somebody truly does [s]."""
        motion = None if somebody is None else true_motion(somebody)
        return min(self._time(self.rows(order), motion) for order in permutations(self.cell.order))

    def _time(self, ways: list[np.ndarray], motion: np.ndarray | None) -> float:
        now = 0.0
        for rows in ways:
            left = None if motion is None else motion[:, min(round(now / STEP), motion.shape[1] - 2) :]
            now += travel_time(self.arm, rows, left, self.cell.separation).mean
        return now


def true_motion(somebody: Person) -> np.ndarray:
    """(1, N, 9, 7) capsules of all that a person does in an episode, `STEP` apart."""
    poses = np.array([somebody.at(STEP * n) for n in range(round(LONGEST / STEP))])
    arms = poses[:, [somebody.joints.index(name) for name in ARM_JOINTS]]
    return body_capsules(ARM_JOINTS, arms)[None]


def main() -> None:
    """Computes, prints, writes."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--episodes", type=int, default=100)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--data", default=os.environ.get("KINECAST_DATA", "../shared/data"))
    parser.add_argument("--cell", default="camera", choices=tuple(CELLS))
    parser.add_argument("--out", type=Path)
    arguments = parser.parse_args()
    before = facts()
    cell, sets = cell_named(arguments.cell), recordings(arguments.data)
    ways = Ways(cell)
    empty = ways.least_time(None)
    seeds = range(arguments.first, arguments.first + arguments.episodes)
    lost = {seed: ways.least_time(person(seed, sets, cell)) - empty for seed in seeds}
    for seed, seconds in lost.items():
        print(f"{seed:5d} {seconds:6.2f} s")
    mean, error = float(np.mean(list(lost.values()))), float(np.std(list(lost.values())) / len(lost) ** 0.5)
    print(f"nobody there: {empty:.1f} s; nobody could avoid {mean:.2f} ± {error:.2f} s of {len(lost)} episodes")
    result = {"settings": {"cell": arguments.cell, "episodes": len(lost), "first": arguments.first}, "empty_s": empty}
    save("least_time", {**result, "unavoidable_s": lost}, arguments.out or RESULTS / "least_time.json", before)


if __name__ == "__main__":
    main()
