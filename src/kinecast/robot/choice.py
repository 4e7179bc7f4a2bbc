"""What to do next, by expected time: every cube that is left and every way there, each timed beside what people may do.

A way to a cube is timed to the end of the grasp, and a way to a cube's place to the end of putting it down: it is there
that the arm is nearest to people and waits longest. Cubes are compared by what the people cost, which is the expected
time less the time that the cube takes from rest with nobody there: all of them are to be moved in the end.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from kinecast.robot.body import held
from kinecast.robot.cell import Cell
from kinecast.robot.chomp import People
from kinecast.robot.execution import within_limits
from kinecast.robot.expected_time import TravelTime, travel_time
from kinecast.robot.motions import STEP
from kinecast.robot.pick_place import DWELL, GraspConfigurations, Step, TaskSequence, straight
from kinecast.robot.planner import SPEED, NoPlan, Planner
from kinecast.robot.trajectory import Trajectory
from kinecast.robot.ur5 import UR5

WORTH = 0.3  # a loss below this is not worth another plan [s]
GAIN, CHANGE = 0.8, 0.4
"""Another way must be sooner by this, another cube by so much more [s]: predictions flicker."""
ORDER, TAKEN = 0.3, 2.0
"""Price of a cube that is not the next in order, and of one that the person is about to take, or has [s]."""
FORESEEN, LIKELY = 4.0, 0.5
"""A way bends around capsules that hold each limb with this probability for so long [s]; the last stay."""

ERRORS = {
    Step.REACH: (
        -0.63, -0.09, -0.01, -0.01, 0.0, 0.01, 0.03, 0.03, 0.05, 0.06,
        0.08, 0.11, 0.12, 0.16, 0.18, 0.22, 0.24, 0.36, 0.5, 0.86,
    ),
    Step.CARRY: (
        -0.04, -0.02, -0.02, -0.01, -0.01, 0.0, 0.0, 0.0, 0.0, 0.0,
        0.0, 0.01, 0.01, 0.02, 0.05, 0.09, 0.1, 0.13, 0.19, 0.23,
    ),
}  # fmt: skip
"""Twentieths of how much longer a way took than was expected, over its nominal time: what people do who were not seen
long enough, or who mind the arm. Of 160 ways in the `camera` cell, seeds 1000 to 1026 of benchmarks.collaboration."""


class Option(NamedTuple):
    """Something to do."""

    step: Step  # what the way is for
    target: str | None  # the cube; None to rest
    goals: Float[np.ndarray, "G 6"]  # where the way may end [rad]
    point: Float[np.ndarray, "3"] | None  # where the gripper then goes down to [m]; None at rest
    price: float = 0.0  # of doing this rather than another, less what it takes from rest with nobody there [s]


class Request(NamedTuple):
    """A choice wanted."""

    options: tuple[Option, ...]  # to choose from, the preferred first
    q: Float[np.ndarray, "6"]  # where the arm will stand when it begins [rad]
    start_time: float  # when [s]
    wait: float = 0.0  # from now until then [s]
    motions: Float[np.ndarray, "S N K 7"] | None = None
    """Of the people from now on (kinecast.robot.motions); None: nobody is there, or nothing is known of them."""
    present: Float[np.ndarray, "W 6"] | None = None
    """Configurations `STEP` apart in which the arm goes on with the first of the options if nothing is changed [rad];
    None where it must change, or stands."""


class Choice(NamedTuple):
    """What is best."""

    option: Option  # chosen
    plan: Trajectory | None  # the way; None: as before
    time: TravelTime  # from now to the option's end
    rows: Float[np.ndarray, "W 6"]  # configurations `STEP` apart to the option's end [rad]
    wait: float = 0.0  # until the plan is taken up, of the time; planning itself, mostly [s]

    @property
    def cost(self) -> float:
        """What it costs more than with nobody there [s]."""
        return self.time.priced + self.option.price

    @property
    def foretold(self) -> TravelTime:
        """The time as it will really be: with the errors that expected times have."""
        return self.time.with_errors(ERRORS.get(self.option.step, (0.0,)))


class Chooser:
    """Compares.

    Args:
        arm: its kinematics.
        cell: with the cubes, and the constants of monitoring.
    """

    def __init__(self, arm: UR5, cell: Cell) -> None:
        self.arm, self.cell, self._planner = arm, cell, Planner(arm, cell.scene)

    def choose(self, request: Request) -> Choice | NoPlan:
        """The option and the way that are done soonest, for what they are; or why there is none."""
        best, least = None, np.inf
        if request.present is not None:
            time = travel_time(self.arm, request.present, request.motions, self.cell.separation)
            best = Choice(request.options[0], None, time, request.present)
            if best.time.priced - best.time.nominal < WORTH:
                return best
            least = best.cost - GAIN
        reason = "out of reach"
        ways = []
        for option in request.options:
            plan = self._planner.plan(request.q, option.goals, request.start_time)
            if isinstance(plan, NoPlan):
                reason = plan.reason
            else:
                ways.append(self._new(option, plan, request))
        ways.sort(key=lambda way: way.cost)
        for choice in (*ways, *self._bent(ways, request)):
            changes = request.present is not None and choice.option is not request.options[0]
            if (cost := choice.cost + CHANGE * changes) < least:
                best, least = choice, cost
        return NoPlan(reason) if best is None else best

    def _new(self, option: Option, plan: Trajectory, request: Request) -> Choice:
        rows = grasp_rows(self.arm, self.cell, plan, option)
        time = travel_time(self.arm, rows, request.motions, self.cell.separation, request.wait)
        return Choice(option, plan, time, rows, request.wait)

    def _bent(self, ways: list[Choice], request: Request) -> Iterator[Choice]:
        """Where the best of the straight ways is slowed: ways to the same place that bend where speed would be lost."""
        if not ways or request.motions is None or ways[0].time.mean - ways[0].time.nominal < WORTH:
            return
        best, instants = ways[0], slice(round(FORESEEN / STEP) + 1)
        assert best.plan is not None
        capsules = held(request.motions[:, instants], LIKELY)
        times = request.start_time - request.wait + STEP * np.arange(len(capsules))
        for plan in self._planner.bent(best.plan, times, People(capsules, self.cell.separation)):
            bent = self._new(best.option, plan, request)
            if bent.time.priced < best.time.priced - WORTH:
                yield bent


def options_for(
    step: Step, target: str | None, sequence: TaskSequence, places: GraspConfigurations, q: Float[np.ndarray, "6"]
) -> tuple[Option, ...]:
    """What may be done in a step, what the arm is at first: every cube left, the cube's place, or where it rests.

    Args:
        step: REACH, CARRY or REST; target: the cube of the arm.
        sequence: cubes left, and who takes them.
        places: how the arm stands at cubes and places.
        q: (6,) where it is [rad].
    """
    if step is Step.REST:
        return (Option(step, target, places.rest(q), None),)
    if step is Step.CARRY:
        assert target is not None
        place = places.cell.cube(target).place
        return (Option(step, target, places.above(place, q), place),)
    found = []
    for name in sorted(sequence.remaining, key=lambda name: name != target):
        place = places.cell.cube(name).position
        price = ORDER * (name != sequence.remaining[0]) + TAKEN * sequence.is_taken(name) - places.usual(place, SPEED)
        found.append(Option(step, name, places.above(place, q), place, price))
    return tuple(found)


def grasp_rows(arm: UR5, cell: Cell, trajectory: Trajectory, option: Option) -> Float[np.ndarray, "W 6"]:
    """(W, 6) a way, the way down from its end, the gripper's time, and the way up again: `STEP` apart [rad]."""
    rows = _followed(trajectory, arm)
    if option.point is None:
        return rows
    to = cell.grasp(option.point)[:3, 3]
    down = straight(arm, rows[-1], to, 0.0)
    if down is None:
        return rows
    below = _followed(down, arm)[1:]
    still = np.repeat(below[-1:], int(np.ceil(DWELL / STEP)), axis=0)
    return np.concatenate([rows, below, still, below[::-1], rows[-1:]])


def _followed(trajectory: Trajectory, arm: UR5) -> Float[np.ndarray, "W 6"]:
    """Configurations `STEP` apart as it is followed, the last at its end or a little after [rad]."""
    trajectory = within_limits(trajectory, arm)
    count = int(np.ceil(trajectory.duration / STEP - 1e-6))
    return trajectory.at(trajectory.times[0] + STEP * np.arange(count + 1))
