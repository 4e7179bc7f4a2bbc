"""Skeletons from a WebSocket or UDP, and the thread in which everything that talks to a network runs."""

from __future__ import annotations

import asyncio
import logging
import re
import threading
import time
from collections.abc import Awaitable, Callable, Coroutine
from dataclasses import dataclass
from typing import Any, TypeVar
from urllib.parse import urlsplit

from kinecast.errors import MissingExtraError, OptionError
from kinecast.live.admission import Admission
from kinecast.live.mailbox import Feed
from kinecast.live.message import LARGEST_MESSAGE

try:
    from websockets.asyncio.server import Server, ServerConnection, serve
    from websockets.exceptions import ConnectionClosed
    from websockets.typing import Origin
except ImportError as error:  # pragma: no cover - the tests install it
    raise MissingExtraError("live streams", "live") from error

__all__ = [
    "MOST_CLIENTS",
    "TRY_LATER",
    "Address",
    "Network",
    "UdpSource",
    "WebSocketSource",
    "closed",
    "listen",
    "opened",
    "port_of",
]

LOOPBACK = "127.0.0.1"
MOST_CLIENTS = 16
"""WebSocket clients of one source or sink."""
TOO_BIG, TRY_LATER = 1009, 1013
"""Close codes of RFC 6455."""
OWN_PAGES: list[Origin | re.Pattern[str] | None] = [
    None,
    re.compile(r"https?://(localhost|127\.0\.0\.1|\[::1\])(:\d+)?"),
]
"""Programs, and web pages served by this machine: any other page open in a browser here must not listen or lie."""
CLOSING = 2.0
"""Seconds that a client has to say goodbye."""

_T = TypeVar("_T")


@dataclass(frozen=True)
class Address:
    """Where to listen.

    Attributes:
        scheme: "ws", "udp" or "xsens".
        host: a name or address of this machine.
        port: 0 is any that is free.
    """

    scheme: str
    host: str
    port: int

    @classmethod
    def parse(cls, text: str, default: int | None = None) -> Address:
        """From `SCHEME://HOST:PORT`; without a host it is the loopback.

        Args:
            text: the address.
            default: the port where none is given; None where it must be.

        Raises:
            OptionError: it is no such address.
        """
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
        self._thread = threading.Thread(target=self._loop.run_forever, name="network", daemon=True)
        self._thread.start()

    def run(self, coroutine: Coroutine[Any, Any, _T]) -> _T:
        """Runs it in the loop and waits for what it gives."""
        return asyncio.run_coroutine_threadsafe(coroutine, self._loop).result()

    def soon(self, call: Callable[[], object]) -> None:
        """Has the loop call it; does not wait."""
        self._loop.call_soon_threadsafe(call)

    def close(self) -> None:
        """Ends the loop; close who uses it first."""
        self.run(_last_tasks())
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._loop.close()


async def _last_tasks() -> None:
    others = asyncio.all_tasks() - {asyncio.current_task()}
    for task in others:
        task.cancel()
    await asyncio.gather(*others, return_exceptions=True)


async def listen(address: Address, handler: Callable[[ServerConnection], Awaitable[None]], largest: int) -> Server:
    """A WebSocket server with the limits of every source and sink.

    Args:
        address: where.
        handler: called for every client.
        largest: bytes of a message; a client that sends more is disconnected.

    Raises:
        OSError: nothing can listen there.
    """
    quiet = logging.getLogger("kinecast.websockets")  # what clients do wrong is counted, not traced
    quiet.setLevel(logging.CRITICAL)
    return await serve(
        handler,
        address.host,
        address.port,
        origins=OWN_PAGES,
        compression=None,  # 10 MB of zeros in 10 kB, and time
        server_header=None,
        max_size=largest,
        close_timeout=CLOSING,
        logger=quiet,
    )


def opened(address: Address, opening: Callable[[], _T]) -> _T:
    """What `opening` gives.

    Raises:
        OptionError: nothing can listen at the address.
    """
    try:
        return opening()
    except (OSError, UnicodeError, OverflowError) as error:
        why = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
        raise OptionError(f"{address}: nothing can listen there ({why})") from None


class _Listener:
    """What both sources share: frames pass `Admission` on their way to a feed.

    Args:
        feed: where frames go.
        network: that it runs in.
        admission: takes what comes.
    """

    def __init__(self, feed: Feed, network: Network, admission: Admission) -> None:
        self._feed = feed
        self._network = network
        self._admission = admission

    def start(self) -> None:
        """Nothing: it listens from the beginning, and the mailbox keeps the newest."""


class WebSocketSource(_Listener):
    """A WebSocket server that clients send skeletons to, one a message.

    Args:
        address: where it listens, at once.
        feed: where frames go.
        network: that it runs in.
        admission: takes the messages; None for skeletons in the world.

    Raises:
        OptionError: nothing can listen there.
    """

    def __init__(self, address: Address, feed: Feed, network: Network, admission: Admission | None = None) -> None:
        super().__init__(feed, network, admission or Admission(feed))
        self._server = opened(address, lambda: network.run(listen(address, self._receive, LARGEST_MESSAGE)))
        self.address = feed.name = str(Address(address.scheme, address.host, port_of(self._server)))

    def close(self) -> None:
        """Says goodbye to clients and stops listening."""
        self._network.run(closed(self._server))

    async def _receive(self, connection: ServerConnection) -> None:
        if self._feed.clients >= MOST_CLIENTS:
            self._feed.refuse(f"more than {MOST_CLIENTS} clients")
            await connection.close(TRY_LATER, "too many clients")
            return
        self._feed.clients += 1
        try:
            async for content in connection:
                self._admission.take(content, connection.id, time.monotonic())
        except ConnectionClosed as end:
            if end.sent is not None and end.sent.code == TOO_BIG:
                self._feed.refuse(f"a message above {LARGEST_MESSAGE} bytes; its client is disconnected")
        finally:
            self._feed.clients -= 1
            self._admission.leave(connection.id)


class UdpSource(_Listener, asyncio.DatagramProtocol):
    """A UDP port that skeletons are sent to.

    Args:
        address: where it listens, at once.
        feed: where frames go.
        network: that it runs in.
        admission: takes the datagrams; None for one skeleton in each, as a message.

    Raises:
        OptionError: nothing can listen there.
    """

    def __init__(self, address: Address, feed: Feed, network: Network, admission: Admission | None = None) -> None:
        super().__init__(feed, network, admission or Admission(feed))
        self._transport = opened(address, lambda: network.run(self._bind(address)))
        port = self._transport.get_extra_info("sockname")[1]
        self.address = feed.name = str(Address(address.scheme, address.host, port))

    def close(self) -> None:
        """Stops listening."""
        self._network.soon(self._transport.close)

    def datagram_received(self, data: bytes, addr: tuple[str | Any, int]) -> None:
        """Called by asyncio."""
        self._admission.take(data, addr, time.monotonic())
        self._feed.clients = self._admission.senders

    async def _bind(self, address: Address) -> asyncio.DatagramTransport:
        loop = asyncio.get_running_loop()
        transport, _ = await loop.create_datagram_endpoint(lambda: self, local_addr=(address.host, address.port))
        return transport


def port_of(server: Server) -> int:
    """The port it really listens at."""
    return int(next(iter(server.sockets)).getsockname()[1])


async def closed(server: Server) -> None:
    """Closes a server and its connections."""
    server.close()
    await server.wait_closed()
