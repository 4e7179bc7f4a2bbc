"""Runs in the background, and going through what they have shown."""

from __future__ import annotations

import threading
from dataclasses import replace

import numpy as np

from kinecast.errors import OptionError
from kinecast.robot.cell import Cell
from kinecast.robot.episode import Episode, SceneSnapshot
from kinecast.robot.simulation import Simulation
from kinecast.types import Decision, RobotState
from kinecast.view.playback import Playback, Run, Setting, Simulations

from .simulated import LONG, simulation


def moment(stamp: float) -> SceneSnapshot:
    nothing = np.empty((0, 3))
    decision = Decision(stamp, RobotState.MOVING, "On its way.")
    return SceneSnapshot(stamp, np.zeros(6), (), {}, np.empty((0, 0, 2, 3)), np.empty((0, 7)), nothing, decision)


class Shown(Run):
    """A run that shows so many moments, one a second, and goes on."""

    def __init__(self, count: int) -> None:
        self.episode, self.ending = Episode(scenes=[moment(float(stamp)) for stamp in range(count)]), ""


def test_a_run_gives_the_last_moment_not_after_a_time() -> None:
    run = Shown(5)
    stamps = [each.stamp for time in (-1.0, 0.0, 0.9, 1.0, 3.5, 99.0) if (each := run.at(time)) is not None]
    assert stamps == [0, 0, 0, 1, 3, 4]
    assert Shown(0).at(0.0) is None
    assert Shown(0).last == 0.0


def test_playing_waits_at_the_newest_moment_and_stops_at_the_end() -> None:
    run = Shown(3)
    playback = Playback(run)
    playback.advance(1.5)
    assert playback.position == 1.5
    playback.advance(5.0)
    assert playback.position == 2.0
    assert playback.playing  # more may come
    run.episode.scenes.append(moment(3.0))
    run.ending = "done"
    playback.advance(5.0)
    assert playback.position == 3.0
    assert not playback.playing
    playback.toggle()  # again from the beginning
    assert playback.playing
    assert playback.position == 0.0


def test_pausing_and_going_to_a_time_stand_still() -> None:
    playback = Playback(Shown(11))
    playback.seek(4.0)
    playback.advance(1.0)
    assert playback.position == 4.0
    assert not playback.playing
    playback.seek(99.0)
    assert playback.position == 10.0
    playback.seek(-1.0)
    assert playback.position == 0.0
    playback.toggle()
    playback.rate = 0.5
    playback.advance(1.0)
    assert playback.position == 0.5
    playback.toggle()
    playback.advance(1.0)
    assert playback.position == 0.5
    playback.load(Shown(2))
    assert playback.position == 0.0
    assert playback.playing


def test_a_run_that_fails_is_told_and_another_can_follow() -> None:
    def make(setting: Setting) -> Simulation:
        if setting.scenario == "broken":
            raise OptionError("no such thing")
        return simulation(0.1)

    simulations = Simulations((), (), Cell(), make, lambda _: None, lambda *_: "done")
    broken = Run(Setting("broken", "none"), simulations)
    broken._thread.join(LONG)
    assert broken.ending == "The simulation failed: no such thing"
    following = Run(Setting("avoid", "none"), simulations, broken)
    following._thread.join(LONG)
    assert following.ending == "done"


def test_a_run_is_given_up_for_the_next() -> None:
    begun, gate = threading.Event(), threading.Event()
    told: list[Decision] = []

    def make(_: Setting) -> Simulation:
        begun.set()
        assert gate.wait(LONG)
        return simulation(0.1)

    simulations = Simulations((), (), Cell(), make, told.append, lambda setting, _: setting.scenario)
    first = Run(Setting("first", "none"), simulations)
    assert begun.wait(LONG)
    second = Run(Setting("second", "none"), replace(simulations, make=lambda _: simulation(0.1)), first)
    gate.set()
    second._thread.join(LONG)
    assert second.ending == "second"
    assert first.ending == ""
    assert not first._thread.is_alive()
    assert told == second.episode.decisions
