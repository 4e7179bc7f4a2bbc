"""A WebSocket server that sends every client each prediction, and waits for none of them."""

from __future__ import annotations

import threading
import time

from websockets.asyncio.server import ServerConnection, broadcast
from websockets.exceptions import ConnectionClosed

from kinecast.live.attempts import Attempts
from kinecast.live.network import MOST_CLIENTS, TRY_LATER, Address, Network, closed, listen, opened, port_of
from kinecast.live.publication import Publication
from kinecast.live.tally import Tally

__all__ = ["WebSocketSink"]

MOST_UNSENT = 256 * 1024
"""Bytes that may wait for one client; while there are more, it misses what is published."""
LARGEST_REQUEST = 1024
"""Clients have nothing to say here; what they say is passed over."""


class WebSocketSink:
    """Sends predictions (docs/live.md): JSON as text, or msgpack as binary messages.

    Args:
        address: where it listens, at once.
        network: that it runs in.
        msgpack: instead of JSON.

    Raises:
        OptionError: nothing can listen there.
    """

    def __init__(self, address: Address, network: Network, msgpack: bool = False) -> None:
        self.tally = Tally()
        self._network = network
        self._msgpack = msgpack
        self._clients: set[ServerConnection] = set()
        self._newest: dict[tuple[str, str], Publication] = {}
        self._lock = threading.Lock()
        self._server = opened(address, lambda: network.run(listen(address, self._attend, LARGEST_REQUEST)))
        self.address = str(Address(address.scheme, address.host, port_of(self._server)))
        self._attempts = Attempts(self.address, "sent")

    @property
    def failure(self) -> str | None:
        """See Sink."""
        return self._attempts.failure

    @property
    def clients(self) -> int:
        """How many are connected."""
        return len(self._clients)

    def publish(self, publication: Publication) -> None:
        """See Sink."""
        with self._lock:
            due = not self._newest
            self.tally.dropped += publication.key in self._newest
            self._newest[publication.key] = publication
        if due:
            self._network.soon(self._send)

    def close(self) -> None:
        """See Sink."""
        self._network.run(closed(self._server))

    def _send(self) -> None:
        with self._lock:
            newest, self._newest = self._newest, {}
        for publication in newest.values():
            if not self._attempts.succeeds(self._broadcast, publication):
                self.tally.dropped += 1

    def _broadcast(self, publication: Publication) -> None:
        if self._clients:
            content = publication.msgpack if self._msgpack else publication.json
            ready = [client for client in self._clients if client.transport.get_write_buffer_size() <= MOST_UNSENT]
            self.tally.dropped += len(self._clients) - len(ready)
            broadcast(ready, content, text=not self._msgpack)
            if ready:
                self.tally.sent(time.monotonic() - publication.acquired)

    async def _attend(self, client: ServerConnection) -> None:
        if len(self._clients) >= MOST_CLIENTS:
            await client.close(TRY_LATER, "too many clients")
            return
        self._clients.add(client)
        try:
            async for _ in client:
                pass
        except ConnectionClosed:
            pass
        finally:
            self._clients.discard(client)
