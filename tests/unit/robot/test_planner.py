"""Plans are checked, within the limits, and where there is none the reason is said."""

from __future__ import annotations

import subprocess
import sys
from itertools import pairwise

import numpy as np

from kinecast.geometry.shapes import Capsule
from kinecast.robot.cell import CAMERA
from kinecast.robot.chomp import People
from kinecast.robot.collision import CollisionChecker
from kinecast.robot.planner import LIMITS, SPEED, NoPlan, Planner, searched
from kinecast.robot.trajectory import Trajectory
from kinecast.robot.ur5 import UR5

from .conftest import AWAY, HOME, POST, WALL, down, posts


def assert_usable(planner: Planner, plan: Trajectory | NoPlan) -> Trajectory:
    assert isinstance(plan, Trajectory), plan
    q = plan.at(planner.checker.looks(plan, 0.002))
    assert not any(planner.checker.touched(each) for each in q)
    return plan


def test_in_the_open_it_goes_straight(planner: Planner) -> None:
    plan = assert_usable(planner, planner.plan(HOME, AWAY[None], 7.0))
    assert plan.times[0] == 7.0
    np.testing.assert_allclose(plan.q[[0, -1]], [HOME, AWAY], atol=1e-12)
    assert plan.within(1.02 * LIMITS) is plan


def test_past_a_post_the_descent_finds_a_way(arm: UR5) -> None:
    planner = Planner(arm, posts(POST), searches=0)
    assert_usable(planner, planner.plan(HOME, AWAY[None], 0.0))


def test_past_a_wall_the_search_finds_a_way_and_the_answer_depends_on_the_question_alone(arm: UR5) -> None:
    planner = Planner(arm, posts(*WALL), searches=2, iterations=400)
    one, other = (assert_usable(planner, planner.plan(HOME, AWAY[None], 0.0)) for _ in range(2))
    stuck = Planner(arm, posts(*WALL), searches=0).plan(HOME, AWAY[None], 0.0)
    assert isinstance(stuck, NoPlan)
    assert stuck.reason.endswith("is in the way; no way around it")
    np.testing.assert_array_equal(one.q, other.q)


def test_straight_legs_from_corner_to_corner_are_the_last_resort(planner: Planner) -> None:
    corner = HOME + np.array([-0.7, -0.3, 0, 0, 0, 0])
    trajectory = planner._legs(np.stack([HOME, corner, AWAY]), 1.0)
    assert isinstance(trajectory, Trajectory)
    places, rates = (trajectory.at(trajectory.times, order) for order in (0, 1))
    nearest = np.abs(places - corner).max(axis=1).argmin()
    np.testing.assert_allclose(places[nearest], corner, atol=1e-9)
    assert np.abs(rates[nearest]).max() < 0.1
    assert trajectory.within(np.array([1.1 * SPEED, np.inf, np.inf])) is trajectory


def test_the_nearest_of_several_goals_is_taken_and_a_blocked_one_is_not(planner: Planner, arm: UR5) -> None:
    goals = np.stack([AWAY, HOME + 0.1])
    plan = planner.plan(HOME, goals, 0.0)
    assert isinstance(plan, Trajectory)
    np.testing.assert_allclose(plan.q[-1], goals[1])
    x, y, z = arm.forward_kinematics(AWAY)[:3, 3]
    blocked = Planner(arm, posts([x, y, z, x, y, z + 0.1, 0.05]))
    assert isinstance(blocked.plan(HOME, goals, 0.0), Trajectory)
    none = blocked.plan(HOME, AWAY[None], 0.0)
    assert isinstance(none, NoPlan)
    assert none.reason == "the goal is blocked by the scene or the arm itself"


def test_of_two_goals_as_near_the_one_with_more_room_is_taken(arm: UR5) -> None:
    goals = HOME + np.array([[0.5, 0, 0, 0, 0, 0], [-0.5, 0, 0, 0, 0, 0]])
    for tight in (0, 1):
        x, y, z = arm.forward_kinematics(goals[tight])[:3, 3]
        plan = Planner(arm, posts([x - 0.25, y, z, x - 0.25, y, z + 0.1, 0.1])).plan(HOME, goals, 0.0)
        assert isinstance(plan, Trajectory)
        np.testing.assert_allclose(plan.q[-1], goals[1 - tight])


def test_every_branch_of_a_place_is_a_goal(planner: Planner, arm: UR5) -> None:
    place = down(-0.4, 0.3, 0.2)
    plan = planner.plan(HOME, arm.inverse_kinematics(place), 0.0)
    assert isinstance(plan, Trajectory)
    np.testing.assert_allclose(arm.forward_kinematics(plan.q[-1]), place, atol=1e-8)


def test_beside_somebody_a_way_bends_away_from_them(planner: Planner) -> None:
    straight = planner.plan(HOME, AWAY[None], 5.0)
    assert isinstance(straight, Trajectory)
    somebody = Capsule(np.array([-1.1, 0.0, 0.1]), np.array([-1.1, 0.0, 0.5]), 0.1)
    row = np.concatenate([somebody.start, somebody.end, [somebody.radius]])
    people = People(np.tile(row, (2, 1, 1)), CAMERA)

    def nearest(plan: Trajectory) -> float:
        links = planner.arm.capsules(plan.at(np.linspace(*plan.times[[0, -1]], 50)))
        return float((somebody.segment_distance(links[..., :3], links[..., 3:6]) - links[..., 6]).min())

    bent = list(planner.bent(straight, np.array([5.0, 9.0]), people))
    assert bent
    for plan in bent:
        assert_usable(planner, plan)
        np.testing.assert_allclose(plan.q[[0, -1]], [HOME, AWAY], atol=1e-12)
    assert max(map(nearest, bent)) > nearest(straight) + 0.05


def test_why_there_is_no_plan_is_said_in_words(planner: Planner) -> None:
    under = HOME + np.array([0, 0.6, 0, 0, 0, 0])
    usual = {"q": HOME, "goals": AWAY[None], "start_time": 0.0}
    for reason, change in (
        ("the goal is out of reach", {"goals": np.empty((0, 6))}),
        ("the goal is blocked by the scene or the arm itself", {"goals": under[None]}),
        ("the arm touches the scene or itself", {"q": under}),
    ):
        answer = planner.plan(**{**usual, **change})  # type: ignore[arg-type]
        assert isinstance(answer, NoPlan)
        assert answer.reason == reason


def test_the_library_needs_none_of_the_robots_packages_and_the_robot_names_the_pip_command() -> None:
    code = """
import sys, kinecast, kinecast.types
packages = {"pinocchio": "ur5", "coal": "collision", "ruckig": "execution", "ompl": "planner"}
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


def test_a_path_leads_from_the_start_to_a_goal_and_is_free_the_same_for_the_same_seed(arm: UR5) -> None:
    checker = CollisionChecker(arm, posts(*WALL))
    paths = [searched(checker, HOME, AWAY[None], 0.003, 5000, seed) for seed in (3, 4, 3)]
    for corners in paths:
        assert corners is not None
        np.testing.assert_allclose(corners[[0, -1]], [HOME, AWAY], atol=1e-12)
        assert not any(checker.touched(q) for leg in pairwise(corners) for q in np.linspace(*leg, 200))
    np.testing.assert_array_equal(paths[0], paths[2])
    assert paths[0].shape != paths[1].shape or not np.allclose(paths[0], paths[1])


def test_it_stops_when_iterations_are_over(arm: UR5) -> None:
    assert searched(CollisionChecker(arm, posts(*WALL)), HOME, AWAY[None], 0.003, 2) is None


def test_a_blocked_end_has_no_path(arm: UR5) -> None:
    blocked = CollisionChecker(arm, posts([-0.4, -0.3, 0.1, -0.4, -0.3, 0.4, 0.1]))
    assert searched(blocked, HOME, AWAY[None], 0.003, 10) is None
    assert searched(blocked, AWAY, HOME[None], 0.003, 10) is None
