"""Runs of the simulation in threads of their own, and going through what they have shown so far."""

from __future__ import annotations

import logging
import threading
from bisect import bisect_right
from collections.abc import Callable
from dataclasses import dataclass

from kinecast.robot.cell import Cell
from kinecast.robot.episode import Episode, SceneSnapshot
from kinecast.robot.simulation import Simulation
from kinecast.types import Decision

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Setting:
    """What is simulated."""

    scenario: str  # what the person does
    predictor: str  # what predicts them
    level: float = 0.95  # probability that an occupied capsule holds its limb


@dataclass(frozen=True)
class Simulations:
    """What can be simulated, and how."""

    scenarios: tuple[str, ...]  # to choose from
    predictors: tuple[str, ...]
    cell: Cell
    make: Callable[[Setting], Simulation]  # a simulation, ready to run
    tell: Callable[[Decision], None]  # called with every new decision, in the thread of the simulation
    end: Callable[[Setting, Simulation], str]  # called with one that came to its end; says how, in words


class Run:
    """Simulates as fast as it can, and waits for nobody who looks on; the run before is given up for it."""

    def __init__(self, setting: Setting, simulations: Simulations, before: Run | None = None) -> None:
        self.setting, self.episode, self.ending = setting, Episode(), ""
        """What happened so far; how it ended, in words, empty while it goes on."""
        self._simulations, self._given_up = simulations, False
        self._thread = threading.Thread(target=self._run, args=(before,), name="simulation", daemon=True)
        self._thread.start()

    @property
    def last(self) -> float:
        """Stamp of the newest moment [s]; 0 before the first."""
        return self.episode.scenes[-1].stamp if self.episode.scenes else 0.0

    def at(self, time: float) -> SceneSnapshot | None:
        """The last moment not after a time [s], else the first; None before there is one."""
        scenes = self.episode.scenes
        return scenes[max(bisect_right(scenes, time, key=lambda each: each.stamp) - 1, 0)] if scenes else None

    def give_up(self) -> None:
        """Ends it, and waits until it has ended."""
        self._given_up = True
        self._thread.join()

    def _run(self, before: Run | None) -> None:
        if before is not None:
            before.give_up()
        try:
            self._simulate()
        except Exception as error:  # whoever looks on is told, and may ask for another run
            log.exception("the simulation of %s failed", self.setting)
            self.ending = f"The simulation failed: {error}"

    def _simulate(self) -> None:
        if self._given_up:
            return
        simulation = self._simulations.make(self.setting)
        self.episode = simulation.episode
        for command in simulation.steps():
            if self._given_up:
                return
            if command.news:
                self._simulations.tell(command.decision)
        self.ending = self._simulations.end(self.setting, simulation)


class Playback:
    """A position in a run. It plays until the newest moment, and waits there while the run goes on."""

    def __init__(self, run: Run) -> None:
        self._lock = threading.Lock()
        self.rate = 1.0  # how fast it plays; 1 as it happened
        self.load(run)

    def load(self, run: Run) -> None:
        """Another run, from its beginning."""
        with self._lock:
            self.run, self.position, self.playing = run, 0.0, True

    def toggle(self) -> None:
        """Pauses what plays; plays what does not, from the beginning where it has come to its end."""
        with self._lock:
            self.playing = not self.playing
            if self.playing and self.run.ending and self.position >= self.run.last:
                self.position = 0.0

    def seek(self, time: float) -> None:
        """Goes to a time [s], or as near as there is, and stands there."""
        with self._lock:
            self.playing = False
            self.position = min(max(time, 0.0), self.run.last)

    def advance(self, seconds: float) -> None:
        """Time has gone by, on the viewer's clock [s]."""
        with self._lock:
            if self.playing:
                self.position = min(self.position + self.rate * seconds, self.run.last)
                self.playing = not (self.run.ending and self.position >= self.run.last)
