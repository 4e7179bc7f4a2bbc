"""Where predictions go: every sink takes them without ever making the predictor wait."""

from __future__ import annotations

import queue
import threading
import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, Literal, Protocol, runtime_checkable

from websockets.asyncio.server import broadcast

from kinecast.live.counters import SinkCounters
from kinecast.live.network import CLOSING, Address, Network, WebSocketServer
from kinecast.live.publication import Publication

MOST_WAITING = 100  # publications that wait for a disc; of more the oldest are dropped and counted
MOST_UNSENT = 256 * 1024  # bytes that may wait for one client; while there are more, it misses what is published
LARGEST_REQUEST = 1024  # clients have nothing to say here; what they say is passed over
LOOK = 0.05  # longest wait for a publication before looking whether to end, or whether something has expired [s]


@runtime_checkable
class Sink(Protocol):
    """Takes publications; `address` says where they go, in messages."""

    address: str
    counters: SinkCounters

    def publish(self, publication: Publication) -> None: ...  # neither waits nor raises

    def close(self) -> None: ...  # sends or writes what it has taken, and ends within seconds


class BackgroundWriter:
    """Writes what it is given in a thread of its own; of more than there is room for, the oldest that waits is dropped.

    What `write`, `expire` (at least every `LOOK` seconds) and `finish` raise is counted.
    """

    def __init__(self, address: str, most_waiting: int = MOST_WAITING, verb: str = "written") -> None:
        self.address, self.counters = address, SinkCounters(address, verb, OSError)
        self._room = most_waiting
        self._waiting: queue.Queue[tuple[Any, float]] = queue.Queue()
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run, name=address, daemon=True)
        self._thread.start()

    def write(self, item: Any) -> None:
        """Writes or sends one."""
        raise NotImplementedError

    def expire(self) -> None:
        """Takes back what holds no more."""

    def finish(self) -> None:
        """Writes what comes last, unless an error has ended it."""

    def release(self) -> None:
        """Closes what was opened."""

    def publish(self, publication: Publication) -> None:
        """See Sink."""
        self.put(publication, publication.acquired)

    def put(self, item: Any, acquired: float) -> None:
        """Takes one that was acquired at a time [s] on `time.monotonic`; never waits."""
        if self._waiting.qsize() >= self._room:
            with suppress(queue.Empty):
                self._waiting.get_nowait()
                self.counters.drop()
        self._waiting.put((item, acquired))

    def close(self) -> None:
        """See Sink."""
        self._closing.set()
        self._thread.join(CLOSING)
        if self._thread.is_alive():
            self.counters.drop(self._waiting.qsize())
            self.counters.fail(TimeoutError(f"still writing after {CLOSING:g} s"))

    def _run(self) -> None:
        while not (self._closing.is_set() and self._waiting.empty()):
            with suppress(queue.Empty):
                self.counters.deliver(self.write, *self._waiting.get(timeout=LOOK))
            self.counters.attempt(self.expire)
        self.counters.attempt(self.finish)
        try:
            self.release()
        except Exception as error:
            self.counters.fail(error)


class FileSink(BackgroundWriter):
    """A file of publications; one that is at the path is replaced, or an OSError raised."""

    def __init__(self, path: Path) -> None:
        self.file: IO[bytes] = path.open("wb")
        super().__init__(str(path))

    def release(self) -> None:
        self.file.close()


class JsonlSink(FileSink):
    """A line of JSON for each prediction (docs/live.md)."""

    def write(self, publication: Publication) -> None:
        self.file.write(publication.json + b"\n")


@dataclass(frozen=True)
class WebSocketOptions:
    """What clients get."""

    format: Literal["json", "msgpack"] = "json"


class WebSocketSink(WebSocketServer):
    """Sends every client each prediction (docs/live.md), as JSON text or binary msgpack, and waits for none of them."""

    def __init__(self, address: Address, network: Network, options: WebSocketOptions) -> None:
        super().__init__(address, network, LARGEST_REQUEST)
        self.counters = SinkCounters(self.address, "sent")
        self._msgpack = options.format == "msgpack"
        self._newest: dict[tuple[str, str], Publication] = {}
        self._lock = threading.Lock()

    def publish(self, publication: Publication) -> None:
        """See Sink; one that a newer of the same person replaces before it is sent counts as dropped."""
        with self._lock:
            due = not self._newest
            self.counters.drop(publication.key in self._newest)
            self._newest[publication.key] = publication
        if due:
            self.network.soon(self._send)

    def _send(self) -> None:
        with self._lock:
            newest, self._newest = self._newest, {}
        for publication in newest.values():
            if not self.counters.attempt(self._broadcast, publication):
                self.counters.drop()

    def _broadcast(self, publication: Publication) -> None:
        if self.clients:
            content = publication.msgpack if self._msgpack else publication.json
            ready = [client for client in self.clients if client.transport.get_write_buffer_size() <= MOST_UNSENT]
            self.counters.drop(len(self.clients) - len(ready))
            broadcast(ready, content, text=not self._msgpack)
            if ready:
                self.counters.sent(time.monotonic() - publication.acquired)
