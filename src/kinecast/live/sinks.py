"""Where predictions go: every sink takes them without ever making the predictor wait."""

from __future__ import annotations

import queue
import threading
import time
from pathlib import Path
from typing import IO, Generic, Protocol, TypeVar, runtime_checkable

from websockets.asyncio.server import ServerConnection, broadcast
from websockets.exceptions import ConnectionClosed

from kinecast.live.counters import SinkCounters
from kinecast.live.network import CLOSING, MOST_CLIENTS, TRY_LATER, Address, Network, WebSocketServer
from kinecast.live.publication import Publication

MOST_WAITING = 100
"""Publications that wait for a disc; more are dropped and counted."""
MOST_UNSENT = 256 * 1024
"""Bytes that may wait for one client; while there are more, it misses what is published."""
LARGEST_REQUEST = 1024
"""Clients have nothing to say here; what they say is passed over."""
LOOK = 0.1
"""Longest wait for something to write before looking whether to end [s]."""

Item = TypeVar("Item")


@runtime_checkable
class Sink(Protocol):
    """Takes publications; `address` says where they go, in messages."""

    address: str
    counters: SinkCounters

    def publish(self, publication: Publication) -> None: ...  # neither waits nor raises

    def close(self) -> None: ...  # sends or writes what it has taken, and ends within seconds


class BackgroundWriter(Generic[Item]):
    """Writes what it is given in a thread of its own; what comes while too much waits is dropped and counted."""

    def __init__(self, address: str, most_waiting: int = MOST_WAITING) -> None:
        self.address = address
        self.counters = SinkCounters(address, "written", OSError)
        self._waiting: queue.Queue[tuple[float, Item]] = queue.Queue(most_waiting)
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run, name=address, daemon=True)
        self._thread.start()

    def write(self, item: Item) -> None:
        """Writes one."""
        raise NotImplementedError

    def finish(self) -> None:
        """Writes what comes last."""

    def put(self, item: Item, acquired: float) -> None:
        """Takes one that was acquired at a time [s] on `time.monotonic`; never waits."""
        try:
            self._waiting.put_nowait((acquired, item))
        except queue.Full:
            self.counters.drop()

    def close(self) -> None:
        """See Sink."""
        self._closing.set()
        self._thread.join(CLOSING)
        if self._thread.is_alive():
            self.counters.drop(self._waiting.qsize())
            self.counters.fail(TimeoutError(f"still writing after {CLOSING:g} s"))

    def _run(self) -> None:
        while not (self._closing.is_set() and self._waiting.empty()):
            try:
                acquired, item = self._waiting.get(timeout=LOOK)
            except queue.Empty:
                continue
            if self.counters.attempt(self.write, item):
                self.counters.sent(time.monotonic() - acquired)
            else:
                self.counters.drop()
        self.counters.attempt(self.finish)


class FileSink(BackgroundWriter[Publication]):
    """A file of publications; one that is at the path is replaced, or an OSError raised."""

    def __init__(self, path: Path) -> None:
        self.file: IO[bytes] = path.open("wb")
        self.begin()
        super().__init__(str(path))

    def begin(self) -> None:
        """Writes what comes first."""

    def publish(self, publication: Publication) -> None:
        self.put(publication, publication.acquired)

    def _run(self) -> None:
        super()._run()
        try:
            self.file.close()
        except OSError as error:
            self.counters.fail(error)


class JsonlSink(FileSink):
    """A line of JSON for each prediction (docs/live.md)."""

    def write(self, publication: Publication) -> None:
        self.file.write(publication.json + b"\n")


class WebSocketSink:
    """Sends every client each prediction (docs/live.md), as JSON text or binary msgpack, and waits for none of them."""

    def __init__(self, address: Address, network: Network, msgpack: bool = False) -> None:
        self._network = network
        self._msgpack = msgpack
        self._clients: set[ServerConnection] = set()
        self._newest: dict[tuple[str, str], Publication] = {}
        self._lock = threading.Lock()
        self._server = WebSocketServer(address, network, self._attend, LARGEST_REQUEST)
        self.address = self._server.address
        self.counters = SinkCounters(self.address, "sent")

    @property
    def unsent(self) -> list[int]:
        """Bytes that wait for each client."""
        return [client.transport.get_write_buffer_size() for client in self._clients]

    def publish(self, publication: Publication) -> None:
        """See Sink; one that a newer of the same person replaces before it is sent counts as dropped."""
        with self._lock:
            due = not self._newest
            self.counters.drop(publication.key in self._newest)
            self._newest[publication.key] = publication
        if due:
            self._network.soon(self._send)

    def close(self) -> None:
        self._server.close()

    def _send(self) -> None:
        with self._lock:
            newest, self._newest = self._newest, {}
        for publication in newest.values():
            if not self.counters.attempt(self._broadcast, publication):
                self.counters.drop()

    def _broadcast(self, publication: Publication) -> None:
        if self._clients:
            content = publication.msgpack if self._msgpack else publication.json
            ready = [client for client in self._clients if client.transport.get_write_buffer_size() <= MOST_UNSENT]
            self.counters.drop(len(self._clients) - len(ready))
            broadcast(ready, content, text=not self._msgpack)
            if ready:
                self.counters.sent(time.monotonic() - publication.acquired)

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
