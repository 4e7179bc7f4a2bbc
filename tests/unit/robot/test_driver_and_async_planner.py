"""The simulated driver, and where plans are asked for."""

from __future__ import annotations

import threading
import time

import numpy as np
import pytest

from kinecast.robot.async_planner import AsyncPlanner
from kinecast.robot.cell import Cell
from kinecast.robot.choice import Choice, Chooser, Option, Request
from kinecast.robot.pick_place import Step, nearest, postures
from kinecast.robot.planner import NoPlan
from kinecast.robot.simulation import SimulatedDriver
from kinecast.robot.ur5 import UR5

START = np.array([-0.9, -1.5, -1.6, -1.6, 1.57, 0.0])


@pytest.fixture(scope="module")
def cell() -> Cell:
    return Cell()


def test_the_simulated_arm_is_no_faster_than_its_joints(arm: UR5, cell: Cell) -> None:
    driver = SimulatedDriver(arm, cell, START)
    sent = driver.move(START + 1.0)
    np.testing.assert_allclose(sent - START, arm.max_speed * driver.dt)
    np.testing.assert_array_equal(driver.q, sent)


def test_a_cube_is_carried_while_it_is_held(arm: UR5, cell: Cell) -> None:
    red = cell.cubes[0]
    q = nearest(postures(arm, cell.grasp(red.position)), START, arm.q_range)[0]
    driver = SimulatedDriver(arm, cell, q)
    driver.grip(True)
    assert driver.held == "red"
    for _ in range(30):
        driver.move(q + 0.2 * np.eye(6)[0])
    driver.grip(False)
    put = driver.cubes["red"].copy()
    turn = np.array([[np.cos(0.2), -np.sin(0.2)], [np.sin(0.2), np.cos(0.2)]])
    np.testing.assert_allclose(put[:2], turn @ red.position[:2], atol=1e-6)
    driver.move(q)
    np.testing.assert_array_equal(driver.cubes["red"], put)


def test_nothing_is_held_where_no_cube_is(arm: UR5, cell: Cell) -> None:
    driver = SimulatedDriver(arm, cell, START)
    driver.grip(True)
    assert driver.held is None
    assert driver.gripped


def request(arm: UR5, cell: Cell) -> Request:
    goals = nearest(postures(arm, cell.grasp(cell.cubes[2].position, cell.hover)), START, arm.q_range)
    option = Option(Step.REACH, "blue", goals, cell.cubes[2].position)
    return Request((option,), START, 0.1, 0.1)


def test_a_plan_is_answered_after_its_latency_and_once(arm: UR5, cell: Cell) -> None:
    planner = AsyncPlanner(Chooser(arm, cell).choose)
    planner.ask(request(arm, cell), 1.0)
    assert planner.pending is not None
    assert planner.answer(1.09) is None
    answer = planner.answer(1.1)
    assert isinstance(answer, Choice)
    assert answer.plan is not None
    assert planner.answer(1.2) is None
    assert planner.pending is None


@pytest.mark.parametrize("threaded", [False, True])
def test_a_planner_that_raises_or_finds_nothing_is_an_answer(threaded: bool, arm: UR5, cell: Cell) -> None:
    def broken(_: Request) -> Choice | NoPlan:
        raise ValueError("broken")

    for solve, crashed, words in ((broken, True, "broken"), (lambda _: NoPlan("no way"), False, "no way")):
        planner = AsyncPlanner(solve, threaded)
        planner.ask(request(arm, cell), 0.0)
        answer = None
        for _ in range(6000):
            answer = planner.answer(1.0)
            if answer is not None:
                break
            time.sleep(0.01)
        assert isinstance(answer, NoPlan)
        assert answer.crashed is crashed
        assert words in answer.reason
        planner.close()


def test_a_thread_does_not_make_the_asker_wait(arm: UR5, cell: Cell) -> None:
    asked_for = threading.Event()

    def slow(_: Request) -> Choice | NoPlan:
        return NoPlan("waited for" if asked_for.wait(60.0) else "never asked for")

    planner = AsyncPlanner(slow, threaded=True)
    planner.ask(request(arm, cell), 0.0)
    assert planner.answer(0.0) is None
    asked_for.set()
    planner.close()
