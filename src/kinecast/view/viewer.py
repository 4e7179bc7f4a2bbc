"""The view in the browser: a server, the simulation beside it, and one loop that sends what is to be seen now."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Callable, Sequence

from kinecast.robot.cell import Cell
from kinecast.robot.episode import Scenery
from kinecast.robot.simulation import Simulation
from kinecast.robot.ur5 import UR5
from kinecast.types import Decision
from kinecast.view.film import Film
from kinecast.view.panel import Panel
from kinecast.view.playback import Playback
from kinecast.view.runs import Runs, Setting
from kinecast.view.server import open_server, stop_server, url_of
from kinecast.view.stage import Stage, look

__all__ = ["Viewer"]

PERIOD = 1 / 30
"""Between two moments sent [s]."""
LEAP = 0.1
"""A busy machine plays more slowly rather than in leaps longer than this [s]."""


class Viewer:
    """Serves the cell to any number of browsers, which all see and control the same.

    Args:
        host, port: where it listens; port 0 is any that is free.
        setting: what is simulated first.
        scenarios, predictors: to choose from.
        cell: what is shown.
        make, tell, end: see kinecast.view.runs.Runs.

    Raises:
        OptionError: nothing can listen there.
    """

    def __init__(
        self,
        host: str,
        port: int,
        setting: Setting,
        scenarios: Sequence[str],
        predictors: Sequence[str],
        cell: Cell,
        make: Callable[[Setting], Simulation],
        tell: Callable[[Decision], None],
        end: Callable[[Setting, Simulation], str],
    ) -> None:
        self._server = open_server(host, port, f"--host {host} --port {port}")
        self._stage = Stage(self._server.scene, cell, UR5())
        look(self._server.initial_camera)
        self._closing = threading.Event()
        self._runs = Runs(make, tell, end)
        self.playback = Playback(self._runs.begin(setting))
        self._panel = Panel(
            self._server.gui, cell, setting, scenarios, predictors, self.playback, self._choose, self._stage.layers
        )
        self._shown: tuple[Film, Scenery, dict[str, bool]] | None = None

    @property
    def url(self) -> str:
        """What a browser on this machine opens."""
        return url_of(self._server)

    def serve(self) -> None:
        """Sends what is to be seen, in the main thread, until it is closed or Ctrl-C ends it.

        Ctrl-C is looked for between two pictures: an exception in the middle of one may be raised while the server
        holds a lock, or where Python can only print it.
        """
        signals: list[int] = []
        before = signal.signal(signal.SIGINT, lambda number, _: signals.append(number))
        last = time.monotonic()
        try:
            while not self._closing.wait(PERIOD) and not signals:
                now = time.monotonic()
                self.playback.advance(min(now - last, LEAP))
                last = now
                self.refresh()
        finally:
            signal.signal(signal.SIGINT, before)

    def refresh(self) -> None:
        """Sends what is to be seen now."""
        film = self.playback.film
        moment = film.at(self.playback.position)
        with self._server.atomic():
            if moment is not None:
                seen = film, moment, dict(self._stage.layers)
                if seen != self._shown:
                    self._stage.show(moment)
                self._shown = seen
            self._panel.show(film, moment)

    def close(self) -> None:
        """Ends simulation and server."""
        self._closing.set()
        self._runs.close()
        stop_server(self._server)

    def _choose(self, setting: Setting) -> None:
        self.playback.load(self._runs.begin(setting))
