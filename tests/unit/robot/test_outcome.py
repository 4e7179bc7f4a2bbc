"""Figures of an episode, counted by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from kinecast.robot.cell import Cell
from kinecast.robot.episode import Episode, Tick, outcome_of
from kinecast.robot.simulated_person import PlayedPerson
from kinecast.types import Decision, Reaction, RobotState

CELL = Cell()
DT = 0.01
QUIET = Tick(0.0, RobotState.MOVING, 1.0, 0.5, 0.1, 0.4, 0.3, 0.5, 0.1)


def episode(*parts: tuple[float, Tick]) -> Episode:
    """Ticks that stay the same for so long [s], one part after another; every cube in its place at the end."""
    ticks: list[Tick] = []
    for seconds, tick in parts:
        ticks += [replace(tick, stamp=(len(ticks) + k) * DT) for k in range(round(seconds / DT))]
    end = ticks[-1].stamp
    return Episode(ticks=ticks, placed={name: end - k for k, name in enumerate(CELL.order)}, end=end)


def test_a_touch_counts_as_one_contact_and_as_a_moving_one_while_any_point_of_the_arm_moves() -> None:
    touch = replace(QUIET, distance=-0.001)
    outcome = outcome_of(episode((1.0, QUIET), (0.1, touch), (1.0, QUIET), (0.05, touch), (1.0, QUIET)), [], CELL)
    assert (outcome.contacts, outcome.contacts_moving) == (2, 2)
    assert outcome.least_distance == pytest.approx(-0.001)
    standing = replace(touch, arm_speed=0.005)
    outcome = outcome_of(episode((1.0, QUIET), (0.1, standing), (1.0, QUIET)), [], CELL)
    assert (outcome.contacts, outcome.contacts_moving) == (1, 0)


def test_too_near_counts_only_while_the_arm_moves() -> None:
    near = replace(QUIET, margin=-0.01)
    outcome = outcome_of(episode((1.0, QUIET), (0.2, near), (0.5, replace(near, arm_speed=0.0))), [], CELL)
    assert outcome.violation == pytest.approx(0.2)


@pytest.mark.parametrize(("state", "stops"), [
    (RobotState.WAITING, 1), (RobotState.STOPPED, 1), (RobotState.REPLANNING, 1),
    (RobotState.GRASPING, 0), (RobotState.PLACING, 0), (RobotState.DONE, 0),
])  # fmt: skip
def test_a_standstill_on_the_way_is_a_stop(state: RobotState, stops: int) -> None:
    still = replace(QUIET, state=state, arm_speed=0.0)
    outcome = outcome_of(episode((1.0, QUIET), (0.2, still), (1.0, QUIET), (0.4, still)), [], CELL)
    assert outcome.stops == stops, "0.2 s is none"
    assert outcome.stopped == pytest.approx(0.4 * stops)


def test_what_is_missing_is_named_and_the_episodes_end_counts() -> None:
    whole = episode((2.0, QUIET))
    assert outcome_of(whole, [], CELL).result == "done"
    assert outcome_of(whole, [], CELL).time_to_done == pytest.approx(1.99)
    del whole.placed["green"]
    whole.end = 7.0
    outcome = outcome_of(whole, [], CELL)
    assert outcome.result == "without green"
    assert outcome.time_to_done == 7.0


@pytest.mark.parametrize(("height", "false"), [(0.1, 0), (0.6, 1)])
def test_a_change_of_cube_is_false_if_nobody_reached_for_the_one_left(height: float, false: int) -> None:
    wrist = CELL.cube("green").position + np.array([0.0, 0.0, height])
    pose = np.stack([wrist + np.array([0.4, 0.0, 0.4]), wrist])
    person = PlayedPerson("a", ("left_shoulder", "left_wrist"), np.arange(2.0), np.stack([pose, pose]))
    whole = episode((2.0, QUIET))
    whole.decisions.append(
        Decision(
            1.0,
            RobotState.MOVING,
            "blue first",
            "blue",
            Reaction.TAKE_ANOTHER,
            speed=1.0,
            taken={"red": 0.0, "green": 0.8, "blue": 0.0},
        )
    )
    assert outcome_of(whole, [person], CELL).false_replans == false
