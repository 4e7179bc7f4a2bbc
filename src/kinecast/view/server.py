"""A server that browsers connect to: on the address it was told, or not at all."""

from __future__ import annotations

import contextlib
import io
import logging
import socket

from viser import ViserServer
from websockets.exceptions import InvalidHandshake

from kinecast.errors import OptionError


class _Server(ViserServer):
    """A server that opens no tunnel to a public address, whoever asks for one."""

    def request_share_url(self, verbose: bool = True) -> str | None:
        return None


def _worth_a_trace(record: logging.LogRecord) -> bool:
    """Browsers open connections ahead, and leave them without a request: websockets logs a traceback of each."""
    error = record.exc_info[1] if record.exc_info else None
    return not isinstance(error, InvalidHandshake | EOFError | ConnectionError)


def open_server(host: str, port: int, name: str) -> ViserServer:
    """A server with an empty scene and a panel on the right; port 0 is any that is free.

    An OptionError that begins with the name, and says why, where nothing can listen there.
    """
    if not 0 <= port <= 65535:
        raise OptionError(f"{name}: allowed is 0 (any free one) to 65535")
    try:
        family, *_ = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        socket.create_server((host, port), family=family).close()
    except (OSError, UnicodeError) as error:
        why = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
        raise OptionError(f"{name}: nothing can listen there ({why})") from None
    logging.getLogger("websockets.server").addFilter(_worth_a_trace)
    with contextlib.redirect_stdout(io.StringIO()):  # it prints a banner
        server = _Server(host, port, label="kinecast", verbose=False)
    if port not in (0, server.get_port()):  # taken in the meantime, so that it went on to the next
        stop_server(server)
        raise OptionError(f"{name}: is taken")
    server.gui.configure_theme(
        control_width="large", show_logo=False, show_share_button=False, brand_color=(31, 120, 200)
    )
    server.gui.main_panel.dock_right()
    return server


def stop_server(server: ViserServer) -> None:
    """Says goodbye to browsers and stops listening."""
    with contextlib.redirect_stdout(io.StringIO()):
        server.stop()


def url_of(server: ViserServer) -> str:
    """What a browser on this machine opens."""
    host = server.get_host()
    name = "127.0.0.1" if host in ("0.0.0.0", "") else f"[{host}]" if ":" in host else host
    return f"http://{name}:{server.get_port()}"
