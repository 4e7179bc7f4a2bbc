"""The view in the browser: a server, the simulation beside it, and one loop that sends what is to be seen now."""

from __future__ import annotations

import contextlib
import io
import socket
import threading
import time
from collections.abc import Callable, Sequence

from kinecast.errors import MissingExtraError, OptionError
from kinecast.robot.cell import Cell
from kinecast.robot.episode import Scenery
from kinecast.robot.simulation import Simulation
from kinecast.robot.ur5 import UR5
from kinecast.service.film import Film
from kinecast.service.panel import Panel
from kinecast.service.playback import Playback
from kinecast.service.runs import Runs, Setting
from kinecast.service.stage import Stage, look
from kinecast.types import Decision

try:
    from viser import ViserServer
except ImportError as error:  # pragma: no cover - the tests install it
    raise MissingExtraError("the browser view", "view") from error

__all__ = ["Viewer", "check_address"]

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
        make, tell, end: see kinecast.service.runs.Runs.

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
        check_address(host, port)
        with contextlib.redirect_stdout(io.StringIO()):  # it prints a banner
            self._server = _Server(host, port, label="kinecast", verbose=False)
        self.host, self.port = host, self._server.get_port()
        if port not in (0, self.port):  # taken in the meantime, so that it went on to the next
            self._stop_server()
            raise OptionError(f"--port {port}: is taken")
        self._server.gui.configure_theme(
            control_width="large", show_logo=False, show_share_button=False, brand_color=(31, 120, 200)
        )
        self._server.gui.main_panel.dock_right()
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
        name = "127.0.0.1" if self.host in ("0.0.0.0", "") else f"[{self.host}]" if ":" in self.host else self.host
        return f"http://{name}:{self.port}"

    def serve(self) -> None:
        """Sends what is to be seen, until it is closed."""
        last = time.monotonic()
        while not self._closing.wait(PERIOD):
            now = time.monotonic()
            self.playback.advance(min(now - last, LEAP))
            last = now
            self.refresh()

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
        self._stop_server()

    def _choose(self, setting: Setting) -> None:
        self.playback.load(self._runs.begin(setting))

    def _stop_server(self) -> None:
        with contextlib.redirect_stdout(io.StringIO()):
            self._server.stop()


class _Server(ViserServer):
    """A server that opens no tunnel to a public address, whoever asks for one."""

    def request_share_url(self, verbose: bool = True) -> str | None:  # noqa: ARG002
        return None


def check_address(host: str, port: int) -> None:
    """Check that a server can listen there.

    Raises:
        OptionError: it cannot; the message says why.
    """
    if not 0 <= port <= 65535:
        raise OptionError(f"--port {port}: allowed is 0 (any free one) to 65535")
    try:
        found = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)
        family, kind, protocol, _, address = found[0]
        with socket.socket(family, kind, protocol) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind(address)
            probe.listen()
    except (OSError, UnicodeError) as error:
        why = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
        raise OptionError(f"--host {host} --port {port}: nothing can listen there ({why})") from None
