"""How long a way takes beside people, and what is chosen by it."""

from __future__ import annotations

import numpy as np
import pytest

from kinecast.errors import OptionError
from kinecast.robot.cell import CELLS, Cell, cell_named
from kinecast.robot.choice import Chooser, Option, Request
from kinecast.robot.execution import Executor
from kinecast.robot.expected_time import TravelTime, travel_time
from kinecast.robot.motions import AHEAD, STEP, PoseHistory
from kinecast.robot.pick_place import GraspConfigurations, Step
from kinecast.robot.planner import NoPlan
from kinecast.robot.ur5 import UR5
from kinecast.types import Prediction, Status

CELL = Cell()
COUNT = round(AHEAD / STEP) + 1
ARMS = np.array([[0.0, -0.2, 0.5], [-0.05, -0.25, 0.2], [-0.25, -0.2, 0.1], [0.0, 0.2, 0.5], [-0.05, 0.25, 0.2],
                 [-0.25, 0.2, 0.1]])  # fmt: skip


def people(x: float, y: float = 0.0, samples: int = 5) -> Prediction:
    """Somebody who stays at x, y."""
    drawn = np.repeat(np.repeat((ARMS + np.array([x, y, 0.0]))[None, None], samples, axis=0), 15, axis=1)
    times = np.arange(1, 16) / 30
    return Prediction(0.0, times, drawn, drawn.mean(axis=0), np.zeros((15, 6, 3, 3)), ("",) * 6, "a", Status.OK)


def motions(x: float, y: float = 0.0) -> np.ndarray:
    return PoseHistory().ahead(people(x, y), 0.0, np.random.default_rng(0))


def way(arm: UR5) -> np.ndarray:
    """From rest to above the green cube."""
    places = GraspConfigurations(arm, CELL)
    start = places.rest(np.array([-0.9, -1.5, -1.6, -1.6, 1.57, 0.0]))[0]
    goal = places.above(CELL.cube("green").position, start)[0]
    share = np.linspace(0.0, 1.0, 21)[:, None]
    return start + share**3 * (10.0 + share * (6.0 * share - 15.0)) * (goal - start)


def test_with_nobody_near_it_takes_what_it_takes(arm: UR5) -> None:
    rows = way(arm)
    for nobody in (None, motions(4.0)):
        time = travel_time(arm, rows, nobody, CELL.separation, wait=0.3)
        assert time.nominal == pytest.approx(2.3)
        np.testing.assert_allclose(time.samples, 2.3)


def test_the_nearer_somebody_stands_the_longer_it_takes(arm: UR5) -> None:
    rows = way(arm)
    means = [travel_time(arm, rows, motions(x), CELL.separation).mean for x in (1.6, 1.2, 1.05, 0.95, 0.5)]
    assert np.all(np.diff(means) >= 0)
    assert means[0] == pytest.approx(2.0)
    assert means[-1] >= AHEAD, "who stands in the way holds it for as long as anything is known"


def test_errors_are_shares_of_the_time_with_nobody_there() -> None:
    time = TravelTime(4.0, np.array([4.0, 5.0])).with_errors((-0.1, 0.0, 0.3))
    assert time.nominal == 4.0
    np.testing.assert_allclose(time.samples, [3.6, 4.0, 4.6, 5.0, 5.2, 6.2])


def test_it_foretells_what_the_arm_then_needs(arm: UR5) -> None:
    """Against the executor, slowed by the same monitoring at every control step."""
    from kinecast.robot.separation import Moving, moving, separation
    from kinecast.robot.trajectory import Trajectory

    rows, body = way(arm), motions(1.17)
    foretold = travel_time(arm, rows, body, CELL.separation).mean
    executor, dt, steps = Executor(arm, 0.008, rows[0]), 0.008, 0
    trajectory = Trajectory(STEP * np.arange(len(rows)), rows)
    executor.follow(trajectory)
    person = Moving(body[0, 0], np.zeros((9, 6)), np.full(9, 0.1))
    rate = 1.0
    while not executor.done and steps < 2000:
        before = trajectory.duration - executor.remaining
        ahead = trajectory.at(before + np.array([0.0, 1e-3]))
        links = moving(arm.capsules(ahead), 1e-3)
        found = separation(links, person, CELL.separation)
        rate = min(found.scale, rate + 3.0 * dt)
        executor.step(rate)
        steps += 1
    assert foretold > 2.2, "it is slowed"
    assert foretold == pytest.approx(steps * dt, rel=0.12)


def test_a_person_goes_on_as_they_did_before() -> None:
    history, reach = PoseHistory(), np.array([-0.3, 0.0, 0.0])
    for k in range(300):  # two seconds of rest, one second of reaching out, over and over
        out = max(np.sin(np.pi * ((k * STEP) % 3.0 - 2.0)), 0.0) if (k * STEP) % 3.0 > 2.0 else 0.0
        history.add(k * STEP, ARMS + out * reach)
    out = ARMS + reach
    carried = history._carry_on(out[None].repeat(40, axis=0), np.zeros((40, 6, 3)), 30, np.random.default_rng(0))
    away = np.linalg.norm(carried[:, :, 2] - ARMS[2], axis=-1)
    assert away[:, 10].mean() < 0.05, "drawn back after a second, as ever"
    assert away[:, 11:].max() > 0.25, "and out again"
    rested = history._carry_on(ARMS[None].repeat(40, axis=0), np.zeros((40, 6, 3)), 10, np.random.default_rng(0))
    begun = np.linalg.norm(rested[:, :, 2] - ARMS[2], axis=-1).max(axis=1) > 0.1
    assert 0.2 < begun.mean() < 0.8, "who rests begins within a second about as often as before"


def test_without_a_past_they_stand_and_what_is_new_returns() -> None:
    history, now = PoseHistory(), ARMS[None] - np.array([0.5, 0.0, 0.0])
    still = np.zeros((1, 6, 3))
    np.testing.assert_array_equal(history._carry_on(now, still, 5, np.random.default_rng(0)), now[:, None].repeat(5, 1))
    history.add(0.0, np.full((6, 3), np.nan))
    for k in range(10):
        history.add(k * STEP, ARMS)
    later = history._carry_on(now, still, 40, np.random.default_rng(0))[0, -1]
    assert np.abs(later - ARMS).max() < 0.02


def options(arm: UR5, q: np.ndarray) -> tuple[Option, ...]:
    places = GraspConfigurations(arm, CELL)
    return tuple(
        Option(Step.REACH, cube.name, places.above(cube.position, q), cube.position, -places.usual(cube.position, 1.57))
        for cube in CELL.cubes
    )


@pytest.fixture(scope="module")
def chooser() -> Chooser:
    return Chooser(UR5(), CELL)


def test_the_cube_that_nobody_is_at_comes_first(arm: UR5, chooser: Chooser) -> None:
    q = way(arm)[0]
    for y, first in ((0.38, {"blue", "green"}), (-0.38, {"red", "green"})):
        found = chooser.choose(Request(options(arm, q), q, 0.1, 0.1, motions(0.72, y)))
        assert not isinstance(found, NoPlan)
        assert found.option.target in first
        assert found.plan is not None
        assert found.time.nominal <= found.time.mean + 1e-9


def test_it_goes_on_unless_something_is_clearly_sooner(arm: UR5, chooser: Chooser) -> None:
    q = way(arm)[0]
    whole = chooser.choose(Request(options(arm, q)[:1], q, 0.0))
    assert not isinstance(whole, NoPlan)
    free = chooser.choose(Request(options(arm, q), q, 0.3, 0.3, motions(3.0), whole.rows))
    assert not isinstance(free, NoPlan)
    assert free.plan is None
    blocked = chooser.choose(Request(options(arm, q), q, 0.3, 0.3, motions(0.72, 0.38), whole.rows))
    assert not isinstance(blocked, NoPlan)
    assert blocked.plan is not None
    assert blocked.option.target != "red"


def test_out_of_reach_is_no_choice(arm: UR5, chooser: Chooser) -> None:
    q = way(arm)[0]
    nowhere = Option(Step.REACH, "red", np.empty((0, 6)), None)
    assert isinstance(chooser.choose(Request((nowhere,), q, 0.0)), NoPlan)


def test_cells_have_their_constants_and_others_are_refused() -> None:
    lab, camera, certified = (cell_named(name).separation for name in CELLS)
    assert lab.constant < camera.constant == certified.constant == pytest.approx(0.19)
    assert certified.least_speed == 1.6
    assert Cell().separation == camera
    with pytest.raises(OptionError, match="'office' is none of lab, camera, certified"):
        cell_named("office")
