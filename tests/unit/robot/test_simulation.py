"""The whole cell in simulation: one cube, and everything that can go wrong."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import replace

import jaxtyping
import numpy as np
import pytest

from kinecast.body.skeleton import ARM_JOINTS
from kinecast.robot.async_planner import Solve
from kinecast.robot.cell import Cell, cell_named
from kinecast.robot.choice import Choice, Chooser, Request
from kinecast.robot.episode import Episode
from kinecast.robot.people import CameraFrame
from kinecast.robot.planner import NoPlan
from kinecast.robot.simulated_person import Person
from kinecast.robot.simulation import Predict, Simulation
from kinecast.robot.ur5 import UR5
from kinecast.types import Decision, Prediction, RobotState, SkeletonFrame, Status

from .conftest import FaultyCamera, Visitor

JOINTS = (*ARM_JOINTS, "head", "pelvis")
FAR = np.array([
    [1.15, -0.2, 0.5], [1.1, -0.25, 0.2], [0.9, -0.2, 0.08],
    [1.15, 0.2, 0.5], [1.1, 0.25, 0.2], [0.9, 0.2, 0.08], [1.1, 0.0, 0.78], [1.2, 0.0, 0.0],
])  # fmt: skip
"""Somebody at the table with both hands on its edge."""
LAB = cell_named("lab")
CELL = replace(LAB, cubes=LAB.cubes[:1])
DT = 0.02
"""Coarser than the arm's own control, which is quicker [s]."""
CLEAN = {"noise": 0.001, "lost": 0.0, "dropped": 0.0}
"""A camera without faults but those that a test gives it."""


pytestmark = pytest.mark.usefixtures("without_checks")


def standing(pose: np.ndarray = FAR, name: str = "a", present: tuple[float, float] = (-np.inf, np.inf)) -> Visitor:
    """Somebody who stands still."""
    return Visitor(name, JOINTS, np.array([0.0, 1.0]), np.repeat(pose[None], 2, axis=0), present)


def stays(frame: SkeletonFrame, now: float) -> Prediction:
    """Predicts that everybody stays where they are, give or take 2 cm."""
    places = dict(zip(frame.joints, frame.positions, strict=True))
    arms = np.stack([places[name] for name in ARM_JOINTS])
    times = now + np.arange(1, 16) / 30
    drawn = arms + 0.02 * np.random.default_rng(0).standard_normal((40, 1, 6, 3)) + np.zeros((15, 1, 1))
    status = Status.OK if np.isfinite(arms).all() else Status.OCCLUDED
    mean, covariance = np.repeat(arms[None], 15, axis=0), np.zeros((15, 6, 3, 3))
    return Prediction(frame.stamp, times, drawn, mean, covariance, ARM_JOINTS, frame.person, status)


def play(
    people: Sequence[Person] = (),
    cell: Cell = CELL,
    solve: Solve | None = None,
    predict: Predict = stays,
    limit: float = 25.0,
    **faults: tuple[tuple[float, float], ...],
) -> Episode:
    """An episode to its end, with faults of the camera."""
    simulation = Simulation(people, predict, FaultyCamera(**CLEAN, **faults), cell, solve=solve, limit=limit, dt=DT)
    deque(simulation.steps(), maxlen=0)
    return simulation.episode


def of(episode: Episode, state: RobotState) -> list[Decision]:
    return [decision for decision in episode.decisions if decision.state is state]


def check(episode: Episode) -> None:
    """Nobody was touched, and the work was done."""
    assert min(tick.distance for tick in episode.ticks) > 0
    assert episode.placed.keys() == {"red"}
    assert episode.decisions[-1].state is RobotState.DONE


def speeds(episode: Episode, start: float, end: float) -> np.ndarray:
    return np.array([tick.arm_speed for tick in episode.ticks if start <= tick.stamp < end])


@pytest.fixture(scope="module")
def alone() -> Episode:
    return play()


def test_alone_it_moves_the_cube_and_ends(alone: Episode) -> None:
    check(alone)
    assert alone.end < 12.0
    named = [decision.state for decision in alone.decisions]
    assert [
        state for k, state in enumerate(named) if state in (RobotState.GRASPING, RobotState.PLACING, RobotState.DONE)
        and state not in named[:k]
    ] == [RobotState.GRASPING, RobotState.PLACING, RobotState.DONE]  # fmt: skip
    np.testing.assert_allclose(alone.scenes[-1].cubes["red"], CELL.cubes[0].place, atol=0.01)
    assert max(tick.arm_speed for tick in alone.ticks) < 1.5


def test_the_same_seed_gives_the_same_episode(alone: Episode) -> None:
    again = play(limit=3.0)
    assert again.decisions == alone.decisions[: len(again.decisions)]
    assert [tick.arm_speed for tick in again.ticks] == [tick.arm_speed for tick in alone.ticks[: len(again.ticks)]]


def test_a_person_who_stands_still_is_no_hindrance(alone: Episode) -> None:
    episode = play([standing()])
    check(episode)
    assert episode.end < alone.end + 3.0


def test_a_person_never_seen_a_silent_camera_and_joints_that_are_nan_hold_the_arm_until_they_are_seen() -> None:
    episode = play([standing()], silent=((2.0, 3.2),), blind=((0.0, 1.0), (3.8, 4.8)))
    check(episode)
    stopped = [(each.stamp, each.reason) for each in of(episode, RobotState.STOPPED)]
    assert any("never seen" in reason for stamp, reason in stopped if stamp < 1.1)
    assert speeds(episode, 0.0, 1.0).max() < 1e-3
    assert "camera is silent" in [reason for stamp, reason in stopped if 2.0 < stamp < 3.2][-1]
    assert speeds(episode, 2.6, 3.2).max() < 1e-3
    assert speeds(episode, 3.4, 3.8).max() > 0.1
    assert any("near" in each.reason or "may" in each.reason for each in episode.decisions if 3.8 < each.stamp < 4.9)
    assert speeds(episode, 4.5, 4.8).max() < 0.1


def test_nobody_known_and_a_silent_camera_stop_the_arm_too() -> None:
    assert speeds(play([], silent=((1.5, 2.5),), limit=2.5), 2.1, 2.5).max() < 1e-3


def test_somebody_who_appears_0_3_m_from_the_arm_stops_it_at_once() -> None:
    away = play(limit=1.21)
    tip = away.scenes[-1].way[0]
    hand = FAR + (tip + np.array([0.4, 0.0, 0.1]) - FAR[2])  # the left wrist, its hand towards the arm
    episode = play([standing(hand, present=(1.2, 4.0))])
    check(episode)
    first = next(tick for tick in episode.ticks if tick.distance < 5.0)
    assert first.distance < 0.4
    assert min(tick.speed for tick in episode.ticks if 1.24 <= tick.stamp < 1.5) < 0.3
    assert any("person" in decision.reason for decision in episode.decisions if 1.2 <= decision.stamp < 2.0)
    assert speeds(episode, 4.5, 6.5).max() > 0.1


def test_a_cube_out_of_reach_is_given_up_and_the_others_are_done() -> None:
    red, green, _ = LAB.cubes
    cell = replace(LAB, cubes=(replace(red, position=np.array([1.4, 0.3, 0.005])), green))
    episode = play(cell=cell)
    assert episode.given_up == ["red"]
    assert episode.placed.keys() == {"green"}
    assert episode.decisions[-1].state is RobotState.DONE
    assert "without red" in episode.decisions[-1].reason


def test_the_last_cube_blocked_for_a_while_it_waits_says_why_and_goes_on() -> None:
    cube = CELL.cubes[0].position
    pose = FAR.copy()
    pose[3:6] = cube + np.array([[0.5, 0.05, 0.4], [0.3, 0.05, 0.25], [0.09, 0.0, 0.09]])
    episode = play([standing(pose, present=(0.0, 4.0))])
    check(episode)
    held = of(episode, RobotState.STOPPED) + of(episode, RobotState.SLOWED) + of(episode, RobotState.WAITING)
    assert any("person" in decision.reason and decision.stamp < 3.0 for decision in held)
    assert not [decision for decision in of(episode, RobotState.GRASPING) if decision.stamp < 4.0]


def test_a_planner_that_crashes_is_asked_again() -> None:
    calls, working = [], Chooser(UR5(), CELL).choose

    def failing(request: Request) -> Choice | NoPlan:
        calls.append(request)
        if len(calls) <= 3:
            raise RuntimeError("out of luck")
        return working(request)

    episode = play(solve=failing)
    check(episode)
    assert any("planner failed: out of luck" in decision.reason for decision in episode.decisions)
    assert speeds(episode, 0.0, 1.5).max() < 1e-3


def test_a_predictor_that_is_never_sure_means_the_reachable_set_and_a_slower_arm(alone: Episode) -> None:
    def unsure(frame: SkeletonFrame, now: float) -> Prediction:
        return replace(stays(frame, now), status=Status.UNFAMILIAR)

    episode = play([standing()], predict=unsure, limit=6.0)
    assert min(tick.distance for tick in episode.ticks) > 0
    assert sum(tick.speed for tick in episode.ticks) < sum(tick.speed for tick in alone.ticks if tick.stamp < 6.0)
    assert any(decision.state in (RobotState.SLOWED, RobotState.WAITING) for decision in episode.decisions)


def test_what_cannot_be_used_stops_the_arm_without_an_exception() -> None:
    simulation = Simulation([standing()], stays, FaultyCamera(**CLEAN), CELL, limit=1.0, dt=DT)
    bad = SkeletonFrame(0.5, JOINTS, np.zeros((3, 3)), "a")
    for k, command in enumerate(simulation.steps()):
        if k == 28:
            simulation.supervisor.see(CameraFrame(0.55, (bad,)), [], 0.56)
            assert simulation.supervisor.control(0.56).decision.state is RobotState.STOPPED
            break
        assert command.decision is not None


def test_every_shape_is_as_stated() -> None:
    jaxtyping.config.update("jaxtyping_disable", False)
    try:
        episode = play([standing()], limit=0.6)
    finally:
        jaxtyping.config.update("jaxtyping_disable", True)
    assert len(episode.ticks) == 30
