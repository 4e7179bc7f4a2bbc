"""The whole loop with what the library ships: how soon it reacts, and faults of the camera and of persons together."""

from __future__ import annotations

from collections import deque

import numpy as np
import pytest

from kinecast.robot.cell import Cell
from kinecast.robot.collaboration import generated_person, predictor_named, simulate_scenario
from kinecast.robot.simulated_person import ReactivePerson
from kinecast.robot.simulation import Simulation
from kinecast.types import Reaction, RobotState

from .conftest import FaultyCamera, Visitor

pytestmark = pytest.mark.usefixtures("without_checks")


def test_it_follows_another_path_within_150_ms_of_the_first_prediction_that_says_so() -> None:
    simulation = simulate_scenario("replan", "oracle", 0)
    said = switched = follows = np.inf
    for command in simulation.steps():
        decision = command.decision
        if simulation.supervisor.sequence.probabilities["green"] >= 0.5:
            said = min(said, decision.stamp)
        if decision.reaction is Reaction.CHANGE_CUBE:
            assert decision.target == "blue"
            switched = min(switched, decision.stamp)
        if decision.target == "blue" and simulation.planner.pending is None:
            follows = decision.stamp
            break
    moving = [tick.arm_speed for tick in simulation.episode.ticks if said - 0.05 < tick.stamp < said]
    assert min(moving) > 0.05, "in mid-motion"
    assert switched - said <= 0.15
    assert follows - said <= 0.15


def test_a_silent_camera_lost_joints_and_people_who_come_and_go_with_the_shipped_model() -> None:
    cell = Cell(cubes=Cell().cubes[:1])
    whole = generated_person(5, Cell())
    people = [
        ReactivePerson(Visitor("a", whole.joints, whole.stamps, whole.positions, (0.0, 3.5))),
        ReactivePerson(Visitor("b", whole.joints, whole.stamps, whole.positions, (3.3, 5.0))),
    ]
    camera = FaultyCamera(lost=0.1, dropped=0.1, silent=((1.0, 2.0),), blind=((2.5, 3.0),), seed=2)
    simulation = Simulation(people, predictor_named("kinecast", people, 40), camera, cell, limit=40.0, dt=0.02)
    deque(simulation.steps(), maxlen=0)
    episode = simulation.episode
    outcome = simulation.outcome()
    assert outcome.result == "done"
    assert outcome.contacts_moving == 0
    stopped = [each.reason for each in episode.decisions if each.state is RobotState.STOPPED]
    assert any("camera is silent" in reason for reason in stopped)
    assert not any("failed" in each.reason for each in episode.decisions)
    speed = {round(tick.stamp, 2): tick.arm_speed for tick in episode.ticks}
    assert max(v for t, v in speed.items() if 1.7 <= t < 2.0) < 1e-3
    assert max(v for t, v in speed.items() if t > 2.1) > 0.1
