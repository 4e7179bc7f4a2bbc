"""The view in the browser: a server, the simulation beside it, and one loop that sends what is to be seen now."""

from __future__ import annotations

import signal
import time

from kinecast.interrupts import answered
from kinecast.robot.episode import SceneSnapshot
from kinecast.view.panel import Panel
from kinecast.view.playback import Playback, Run, Setting, Simulations
from kinecast.view.server import open_server, stop_server, url_of
from kinecast.view.stage import Stage, look

PERIOD = 1 / 30  # between two moments sent [s]
LEAP = 0.1  # a busy machine plays more slowly rather than in leaps longer than this [s]


class Viewer:
    """Serves the cell to any number of browsers, which all see and control the same.

    The setting is simulated first; port 0 is any that is free. An OptionError where nothing can listen there.
    """

    def __init__(self, host: str, port: int, setting: Setting, simulations: Simulations) -> None:
        self.server = open_server(host, port, f"--host {host} --port {port}")
        self.stage = Stage(self.server.scene, simulations.cell)
        look(self.server.initial_camera)
        self.playback = Playback(Run(setting, simulations))
        self.panel = Panel(self.server.gui, setting, simulations, self.playback, self.stage.layers)
        self._shown: tuple[SceneSnapshot, dict[str, bool]] | None = None

    @property
    def url(self) -> str:
        """What a browser on this machine opens."""
        return url_of(self.server)

    def serve(self) -> None:
        """Sends what is to be seen, in the main thread, until Ctrl-C ends it.

        Ctrl-C is looked for between two pictures: an exception in the middle of one may be raised while the server
        holds a lock, or where Python can only print it.
        """
        signals: list[int] = []
        last = time.monotonic()
        with answered(lambda number, _: signals.append(number), signal.SIGINT):
            while not signals:
                time.sleep(PERIOD)
                now = time.monotonic()
                self.playback.advance(min(now - last, LEAP))
                last = now
                self.refresh()

    def refresh(self) -> None:
        """Sends what is to be seen now."""
        moment = self.playback.run.at(self.playback.position)
        with self.server.atomic():
            if moment is not None and (moment, self.stage.layers) != self._shown:
                self._shown = moment, dict(self.stage.layers)
                self.stage.show(moment)
            self.panel.show(moment)

    def close(self) -> None:
        """Ends simulation and server."""
        self.playback.run.give_up()
        stop_server(self.server)
