"""Plans are checked, within the limits, and where there is none the reason is said."""

from __future__ import annotations

import math
import subprocess
import sys
from collections.abc import Iterator

import numpy as np
import pytest

from kinecast.errors import OptionError
from kinecast.robot.attempt import Attempt
from kinecast.robot.execution import SHARE
from kinecast.robot.occupancy import Occupancy, occupied
from kinecast.robot.planner import NoPlan, Plan, Planner, PlannerOptions
from kinecast.robot.ur5 import UR5

from .conftest import HOME, down, prediction, staying

AWAY = HOME + np.array([-1.5, 0, 0, 0, 0, 0])
POST = [-0.45, 0.0, 0.0, -0.45, 0.0, 0.15, 0.06]
WALL = staying(*[[-0.9, 0.0, z, -0.42, 0.0, z, 0.06] for z in (0.1, 0.25, 0.4, 0.55)])


def assert_usable(planner: Planner, plan: Plan | NoPlan, occupancy: Occupancy) -> Plan:
    assert isinstance(plan, Plan), plan
    times = planner.checker.looks(plan.trajectory, 0.002)
    q, _ = plan.trajectory.at(times)
    assert not any(planner.checker.touched(q, times, occupancy))
    assert planner.checker.clearances(q, times, occupancy)[:, 0].min() >= plan.clearance - 1e-3
    return plan


def test_in_the_open_it_goes_straight(planner: Planner) -> None:
    plan = assert_usable(planner, planner.plan(HOME, AWAY[None], Occupancy.empty(), 7.0), Occupancy.empty())
    assert plan.solved_by == "chomp"
    assert plan.trajectory.times[0] == 7.0
    np.testing.assert_allclose(plan.trajectory.q[[0, -1]], [HOME, AWAY], atol=1e-12)
    speed, acceleration, jerk = plan.trajectory.peaks()
    assert speed.max() <= 1.02 * planner.options.speed
    assert acceleration.max() <= 1.02**2 * planner.options.acceleration
    assert jerk.max() <= 1.02**3 * planner.options.jerk
    assert plan.milliseconds > 0


def test_past_a_post_the_descent_finds_a_way(planner: Planner) -> None:
    plan = assert_usable(planner, planner.plan(HOME, AWAY[None], staying(POST), 0.0), staying(POST))
    assert plan.solved_by == "chomp"
    assert plan.clearance > 0.005


def test_past_a_wall_the_search_finds_a_way(planner: Planner) -> None:
    plan = planner.plan(HOME, AWAY[None], WALL, 0.0, budget=math.inf)
    assert "rrt" in assert_usable(planner, plan, WALL).solved_by


def test_without_an_end_of_time_the_answer_depends_on_the_question_alone(planner: Planner) -> None:
    one, other = (planner.plan(HOME, AWAY[None], WALL, 0.0, budget=math.inf) for _ in range(2))
    assert isinstance(one, Plan)
    assert isinstance(other, Plan)
    np.testing.assert_array_equal(one.trajectory.q, other.trajectory.q)


def test_straight_legs_from_corner_to_corner_are_the_last_resort(planner: Planner) -> None:
    attempt = Attempt(planner.checker, planner.options, HOME, Occupancy.empty(), 1.0)
    corner = HOME + np.array([-0.7, -0.3, 0, 0, 0, 0])
    found = attempt.legs(np.stack([HOME, corner, AWAY]))
    assert isinstance(found, tuple)
    trajectory = found[0]
    places, rates = trajectory.at(trajectory.times)
    nearest = np.abs(places - corner).max(axis=1).argmin()
    np.testing.assert_allclose(places[nearest], corner, atol=1e-9)
    assert np.abs(rates[nearest]).max() < 0.1
    assert trajectory.peaks()[0].max() < 1.1 * planner.options.speed


def test_the_nearest_of_several_goals_is_taken_and_a_blocked_one_is_not(planner: Planner, arm: UR5) -> None:
    goals = np.stack([AWAY, HOME + 0.1])
    plan = planner.plan(HOME, goals, Occupancy.empty(), 0.0)
    assert isinstance(plan, Plan)
    assert plan.goal == 1
    x, y, z = arm.forward_kinematics(AWAY)[:3, 3]
    blocked = staying([x, y, z, x, y, z + 0.1, 0.05])
    assert isinstance(planner.plan(HOME, goals, blocked, 0.0), Plan)
    none = planner.plan(HOME, AWAY[None], blocked, 0.0)
    assert isinstance(none, NoPlan)
    assert none.reason == "the goal is in a person's region"


def test_of_two_goals_as_near_the_one_with_more_room_is_taken(planner: Planner, arm: UR5) -> None:
    goals = HOME + np.array([[0.5, 0, 0, 0, 0, 0], [-0.5, 0, 0, 0, 0, 0]])
    for tight in (0, 1):
        x, y, z = arm.forward_kinematics(goals[tight])[:3, 3]
        beside = staying([x - 0.25, y, z, x - 0.25, y, z + 0.1, 0.1])
        plan = planner.plan(HOME, goals, beside, 0.0)
        assert isinstance(plan, Plan)
        assert plan.goal == 1 - tight


def test_every_branch_of_a_place_is_a_goal(planner: Planner, arm: UR5) -> None:
    place = down(-0.4, 0.3, 0.2)
    plan = planner.plan(HOME, arm.inverse_kinematics(place), Occupancy.empty(), 0.0)
    assert isinstance(plan, Plan)
    np.testing.assert_allclose(arm.forward_kinematics(plan.trajectory.q[-1]), place, atol=1e-8)


def test_beside_a_person_it_keeps_out_of_the_predicted_region(planner: Planner) -> None:
    region = occupied([prediction(spread=0.03, x=-1.15)], 0.03)
    assert_usable(planner, planner.plan(HOME, AWAY[None], region, 0.03), region)


def test_a_moving_start_is_taken_up_as_it_is(planner: Planner, arm: UR5) -> None:
    first = planner.plan(HOME, AWAY[None], Occupancy.empty(), 0.0)
    assert isinstance(first, Plan)
    now = 0.2 * first.trajectory.duration
    q, qd, qdd, _ = first.trajectory.derivatives(now)
    onward = AWAY + np.array([-0.3, 0, 0, 0, 0, 0.3])
    plan = planner.plan(q, onward[None], Occupancy.empty(), now, velocity=qd, acceleration=qdd)
    assert isinstance(plan, Plan)
    start = plan.trajectory.derivatives(now)
    for found, expected in zip(start, (q, qd, qdd), strict=False):
        np.testing.assert_allclose(found, expected, atol=1e-6)
    limits = SHARE[:, None] * np.stack([arm.max_speed, arm.max_acceleration, arm.max_jerk])
    assert (np.stack(plan.trajectory.peaks()) <= 1.1 * limits).all()


def _refusals(arm: UR5) -> Iterator[tuple[str, dict[str, object]]]:
    yield "the goal is out of reach", {"goals": np.empty((0, 6))}
    yield "the goal is out of reach", {"goals": np.full((1, 6), np.nan)}
    yield "the arm's state is not known", {"q": np.full(6, np.nan)}
    yield "the arm's state is not known", {"velocity": np.full(6, np.inf)}
    under = HOME + np.array([0, 0.6, 0, 0, 0, 0])
    yield "the goal is blocked by the scene or the arm itself", {"goals": under[None]}
    yield "the arm touches the scene or itself", {"q": under}
    x, y, z = arm.forward_kinematics(HOME)[:3, 3]
    yield "the arm is in a person's region", {"occupancy": staying([x, y, z, x, y, z, 0.1])}


def test_why_there_is_no_plan_is_said_in_words(planner: Planner, arm: UR5) -> None:
    usual = {"q": HOME, "goals": AWAY[None], "occupancy": Occupancy.empty(), "start_time": 0.0}
    for reason, change in _refusals(arm):
        answer = planner.plan(**{**usual, **change})  # type: ignore[arg-type]
        assert isinstance(answer, NoPlan)
        assert answer.reason == reason


def test_where_there_is_no_way_it_gives_up_in_time(planner: Planner) -> None:
    sealed = staying(*[[-1.2, 0.0, z, 1.2, 0.0, z, 0.15] for z in np.arange(0.0, 1.6, 0.2)])
    planner.plan(HOME, AWAY[None], sealed, 0.0, budget=0.05)
    answer = planner.plan(HOME, AWAY[None], sealed, 0.0, budget=0.05)
    assert isinstance(answer, NoPlan)
    assert "person's region" in answer.reason
    assert answer.milliseconds < 1000


@pytest.mark.parametrize("change", [{"speed": 0.0}, {"acceleration": -1.0}, {"jerk": np.inf}, {"shortest": np.nan}])
def test_impossible_options_are_refused(change: dict[str, float]) -> None:
    with pytest.raises(OptionError):
        PlannerOptions(**change)


def test_the_library_needs_none_of_the_robots_packages_and_the_robot_names_the_pip_command() -> None:
    code = """
import sys, kinecast, kinecast.types
packages = {"pinocchio": "ur5", "coal": "collision", "ruckig": "execution", "ompl": "seeding"}
print(sorted(packages.keys() & set(sys.modules)))
for package, module in packages.items():
    sys.modules[package] = None
    try:
        __import__(f"kinecast.robot.{module}")
    except ImportError as error:
        print(error)
    del sys.modules[package]
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded, *errors = done.stdout.splitlines()
    assert loaded == "[]"
    assert errors == ["the robot needs optional packages: pip install 'kinecast[robot]'"] * 4
