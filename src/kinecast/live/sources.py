"""Where skeletons come from: a WebSocket, UDP, or a recording at its own pace."""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol, runtime_checkable

from websockets.asyncio.server import ServerConnection
from websockets.exceptions import ConnectionClosed

from kinecast.errors import OptionError
from kinecast.live.mailbox import Feed
from kinecast.live.message import LARGEST_MESSAGE
from kinecast.live.network import CLOSING, MOST_CLIENTS, TRY_LATER, Address, Network, WebSocketServer
from kinecast.live.sender_guard import SenderGuard
from kinecast.types import SkeletonFrame

TOO_BIG = 1009
"""Close code of RFC 6455."""


@runtime_checkable
class Source(Protocol):
    """Puts frames into its feed from a thread of its own; `address` says where they come from, in messages."""

    address: str

    def start(self) -> None: ...

    def close(self) -> None: ...  # no frame comes afterwards


class WebSocketSource:
    """A WebSocket server that clients send skeletons to, one a message; it listens from the beginning."""

    def __init__(self, address: Address, feed: Feed, network: Network, guard: SenderGuard) -> None:
        self._feed = feed
        self._guard = guard
        self._server = WebSocketServer(address, network, self._receive, LARGEST_MESSAGE)
        self.address = feed.name = self._server.address

    def start(self) -> None:
        pass

    def close(self) -> None:
        self._server.close()

    async def _receive(self, connection: ServerConnection) -> None:
        if self._feed.clients >= MOST_CLIENTS:
            self._feed.refuse(f"more than {MOST_CLIENTS} clients")
            await connection.close(TRY_LATER, "too many clients")
            return
        self._feed.clients += 1
        try:
            async for content in connection:
                self._guard.take(content, connection.id, time.monotonic())
        except ConnectionClosed as end:
            if end.sent is not None and end.sent.code == TOO_BIG:
                self._feed.refuse(f"a message above {LARGEST_MESSAGE} bytes; its client is disconnected")
        finally:
            self._feed.clients -= 1
            self._guard.leave(connection.id)


class UdpSource(asyncio.DatagramProtocol):
    """A UDP port that skeletons are sent to, one a datagram; it listens from the beginning."""

    def __init__(self, address: Address, feed: Feed, network: Network, guard: SenderGuard) -> None:
        self._feed = feed
        self._network = network
        self._guard = guard
        self._transport = network.open(address, self._listen(address))
        port = self._transport.get_extra_info("sockname")[1]
        self.address = feed.name = str(Address(address.scheme, address.host, port))

    def start(self) -> None:
        pass

    def close(self) -> None:
        self._network.finish(self._stop_listening())

    def datagram_received(self, data: bytes, addr: tuple[str | Any, int]) -> None:
        """Called by asyncio."""
        self._guard.take(data, addr, time.monotonic())
        self._feed.clients = self._guard.senders

    async def _listen(self, address: Address) -> asyncio.DatagramTransport:
        loop = asyncio.get_running_loop()
        return (await loop.create_datagram_endpoint(lambda: self, local_addr=(address.host, address.port)))[0]

    async def _stop_listening(self) -> None:
        self._transport.close()


@dataclass
class RecordedSource:
    """Plays a recording's frames, by stamp; each is acquired at the instant it is due."""

    address: str
    feed: Feed
    frames: Sequence[SkeletonFrame]
    speed: float = 1.0  # 2 plays twice as fast
    repeat: int = 1  # how often it is played, with stamps that go on

    def __post_init__(self) -> None:
        if not 0.01 <= self.speed <= 1000:
            raise OptionError(f"{self.address}: speed {self.speed:g} is outside 0.01..1000")
        if self.repeat < 1:
            raise OptionError(f"{self.address}: repeat {self.repeat} must be at least 1")
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._play, name=self.address, daemon=True)

    def start(self) -> None:
        self._thread.start()

    def close(self) -> None:
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join(CLOSING)

    def _play(self) -> None:
        begun = time.monotonic()
        for after, frame in self._due():
            due = begun + after
            if self._stop.wait(max(due - time.monotonic(), 0.0)):
                break
            self.feed.put(frame, due, self.speed)
        self.feed.end()

    def _due(self) -> Iterator[tuple[float, SkeletonFrame]]:
        """Every frame, and how long after the beginning it is due [s]."""
        first, last = self.frames[0].stamp, self.frames[-1].stamp
        period = (last - first) * len(self.frames) / max(len(self.frames) - 1, 1)
        for turn in range(self.repeat):
            for frame in self.frames:
                stamp = frame.stamp + turn * period
                yield (stamp - first) / self.speed, replace(frame, stamp=stamp) if turn else frame
