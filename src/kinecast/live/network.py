"""The thread in which everything that talks to a network runs, addresses, and WebSocket servers."""

from __future__ import annotations

import asyncio
import logging
import re
import threading
from collections.abc import Callable, Coroutine
from dataclasses import dataclass
from typing import Any, TypeVar
from urllib.parse import urlsplit

from websockets.asyncio.server import Server, ServerConnection, serve
from websockets.exceptions import ConnectionClosed
from websockets.typing import Origin

from kinecast.errors import OptionError

LOOPBACK = "127.0.0.1"
MOST_CLIENTS = 16  # webSocket clients of one source or sink
TOO_BIG, TRY_LATER = 1009, 1013  # close codes of RFC 6455
_LOCAL = re.compile(r"https?://(localhost|127\.0\.0\.1|\[::1\])(:\d+)?")
OWN_PAGES: list[Origin | re.Pattern[str] | None] = [None, _LOCAL]
"""Programs, and web pages served by this machine: any other page open in a browser here must not listen or lie."""
GOODBYE, CLOSING = 2.0, 5.0  # seconds that a client has to say goodbye, and that closing takes at the most

_T = TypeVar("_T")


@dataclass(frozen=True)
class Address:
    """Where to listen: a host of this machine, and a port, where 0 is any that is free."""

    scheme: str
    host: str
    port: int

    @classmethod
    def parse(cls, text: str, default: int | None = None) -> Address:
        """From `SCHEME://HOST:PORT`, else an OptionError; no host is the loopback, no port the default, if any."""
        try:
            parts = urlsplit(text)
            port = default if parts.port is None else parts.port
        except ValueError as error:
            raise OptionError(f"{text}: {error}") from None
        if port is None or parts.path not in ("", "/") or parts.username is not None or parts.fragment:
            raise OptionError(f"{text}: expected {parts.scheme}://HOST:PORT")
        return cls(parts.scheme, parts.hostname or LOOPBACK, port)

    def __str__(self) -> str:
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"{self.scheme}://{host}:{self.port}"


class Network:
    """An asyncio loop in a thread of its own, so that no client ever holds up the predictor."""

    def __init__(self) -> None:
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._run, name="network", daemon=True)
        self._thread.start()

    def open(self, address: Address, opening: Coroutine[Any, Any, _T]) -> _T:
        """What `opening` gives, run in the loop; an OptionError where nothing can listen at the address."""
        try:
            return asyncio.run_coroutine_threadsafe(opening, self._loop).result()
        except (OSError, UnicodeError, OverflowError) as error:
            why = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
            raise OptionError(f"{address}: nothing can listen there ({why})") from None

    def soon(self, call: Callable[[], object]) -> None:
        """Has the loop call it; does not wait."""
        self._loop.call_soon_threadsafe(call)

    def finish(self, ending: Coroutine[Any, Any, object]) -> None:
        """Runs the last of something in the loop; gives up after `CLOSING` seconds."""
        future = asyncio.run_coroutine_threadsafe(ending, self._loop)
        try:
            future.result(CLOSING)
        except TimeoutError:
            future.cancel()

    def close(self) -> None:
        """Ends the loop; close who uses it first."""
        self.soon(self._loop.stop)
        self._thread.join(CLOSING)

    def _run(self) -> None:
        with asyncio.Runner(loop_factory=lambda: self._loop) as runner:  # at its end it cancels what is still there
            runner.get_loop().run_forever()


class WebSocketServer:
    """A WebSocket server with the limits of every source and sink, at its address at once, or an OptionError.

    With port 0 its attribute `address` has the port it really listens at. A client that sends a message with more bytes
    than the largest is disconnected.
    """

    def __init__(self, address: Address, network: Network, largest: int) -> None:
        self.clients: set[ServerConnection] = set()
        self.network, self._largest = network, largest
        quiet = logging.getLogger("kinecast.websockets")  # what clients do wrong is counted, not traced
        quiet.setLevel(logging.CRITICAL)

        async def opening() -> Server:
            return await serve(
                self._attend,
                address.host,
                address.port,
                origins=OWN_PAGES,
                compression=None,  # 10 MB of zeros in 10 kB, and time
                server_header=None,
                max_size=largest,
                close_timeout=GOODBYE,
                logger=quiet,
            )

        self._server = network.open(address, opening())
        port = int(next(iter(self._server.sockets)).getsockname()[1])
        self.address = str(Address(address.scheme, address.host, port))

    async def listen(self, client: ServerConnection) -> None:
        """Takes what a client says, until it goes; here it is passed over."""
        async for _ in client:
            pass

    def refuse(self, problem: str) -> None:
        """What is said of a client that is too many, or says too much; here nothing."""

    def close(self) -> None:
        """Says goodbye to clients and stops listening."""

        async def closing() -> None:
            self._server.close()
            await self._server.wait_closed()

        self.network.finish(closing())

    async def _attend(self, client: ServerConnection) -> None:
        if len(self.clients) >= MOST_CLIENTS:
            self.refuse(f"more than {MOST_CLIENTS} clients")
            await client.close(TRY_LATER, "too many clients")
            return
        self.clients.add(client)
        try:
            await self.listen(client)
        except ConnectionClosed as end:
            if end.sent is not None and end.sent.code == TOO_BIG:
                self.refuse(f"a message above {self._largest} bytes; its client is disconnected")
        finally:
            self.clients.discard(client)
