"""Runs of the simulation in a thread of their own: one at a time, given up as soon as another one is asked for."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from dataclasses import dataclass

from kinecast.errors import OptionError
from kinecast.robot.simulation import Simulation
from kinecast.types import Decision
from kinecast.view.film import Film

__all__ = ["Runs", "Setting"]

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Setting:
    """What is simulated.

    Attributes:
        scenario: what the person does.
        predictor: what predicts them.
        level: probability that an occupied capsule holds its limb, in (0, 1].
    """

    scenario: str
    predictor: str
    level: float = 0.95

    def __post_init__(self) -> None:
        if not 0 < self.level <= 1:
            raise OptionError(f"level {self.level} is outside (0, 1]")


class Runs:
    """Simulates what is asked for, as fast as it can, and waits for nobody who looks on.

    Args:
        make: a simulation, ready to run.
        tell: called with every new decision, in the thread of the simulation.
        end: called with a simulation that came to its end; says how, in words.
    """

    def __init__(
        self,
        make: Callable[[Setting], Simulation],
        tell: Callable[[Decision], None],
        end: Callable[[Setting, Simulation], str],
    ) -> None:
        self._make, self._tell, self._end = make, tell, end
        self._wake = threading.Condition()
        self._asked: tuple[Setting, Film] | None = None
        self._closed = False
        self._thread = threading.Thread(target=self._work, name="simulation", daemon=True)
        self._thread.start()

    def begin(self, setting: Setting) -> Film:
        """Asks for a run; the one before is given up. Returns what it will be recorded on."""
        film = Film()
        with self._wake:
            self._asked = setting, film
            self._wake.notify()
        return film

    def close(self) -> None:
        """Ends the present run, and the thread."""
        with self._wake:
            self._closed = True
            self._wake.notify()
        self._thread.join()

    def _work(self) -> None:
        done: tuple[Setting, Film] | None = None
        while True:
            with self._wake:
                self._wake.wait_for(lambda done=done: self._closed or self._asked is not done)  # type: ignore[misc]
                if self._closed:
                    return
                done = self._asked
            assert done is not None
            setting, film = done
            try:
                self._run(setting, film)
            except Exception as error:  # whoever looks on is told, and may ask for another run
                log.exception("the simulation of %s failed", setting)
                film.finish(f"The simulation failed: {error}")

    def _run(self, setting: Setting, film: Film) -> None:
        simulation = self._make(setting)
        scenes, shown = simulation.episode.scenes, 0
        for command in simulation.steps():
            if self._closed or self._asked is None or self._asked[1] is not film:
                return
            if command.news:
                film.tell(command.decision)
                self._tell(command.decision)
            if len(scenes) > shown:
                film.add(scenes[-1])
                shown = len(scenes)
        film.finish(self._end(setting, simulation))
