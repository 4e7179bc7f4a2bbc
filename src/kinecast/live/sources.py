"""Where skeletons come from: a WebSocket, UDP, or a recording at its own pace."""

from __future__ import annotations

import asyncio
import itertools
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any, Protocol, runtime_checkable

from msgspec import Meta
from websockets.asyncio.server import ServerConnection

from kinecast.live.mailbox import Feed
from kinecast.live.message import LARGEST_MESSAGE
from kinecast.live.network import CLOSING, Address, Network, WebSocketServer
from kinecast.live.sender_guard import SenderGuard
from kinecast.types import SkeletonFrame


@runtime_checkable
class Source(Protocol):
    """Puts frames into its feed from a thread of its own; `address` says where they come from, in messages."""

    address: str

    def start(self) -> None: ...

    def close(self) -> None: ...  # no frame comes afterwards


class WebSocketSource(WebSocketServer):
    """A WebSocket server that clients send skeletons to, one a message; it listens from the beginning."""

    def __init__(self, address: Address, feed: Feed, network: Network, guard: SenderGuard) -> None:
        self._feed, self._guard = feed, guard
        super().__init__(address, network, LARGEST_MESSAGE)
        feed.name = self.address

    def start(self) -> None:
        """See Source."""

    def refuse(self, problem: str) -> None:
        """Counts it."""
        self._feed.refuse(problem)

    async def listen(self, client: ServerConnection) -> None:
        """Takes a client's skeletons."""
        self._feed.clients += 1
        try:
            async for content in client:
                self._guard.take(content, client.id, time.monotonic())
        finally:
            self._feed.clients -= 1
            self._guard.leave(client.id)


class UdpSource(asyncio.DatagramProtocol):
    """A UDP port that skeletons are sent to, one a datagram; it listens from the beginning."""

    def __init__(self, address: Address, feed: Feed, network: Network, guard: SenderGuard) -> None:
        self._feed, self._guard, self._network = feed, guard, network

        async def opening() -> asyncio.DatagramTransport:
            loop = asyncio.get_running_loop()
            return (await loop.create_datagram_endpoint(lambda: self, local_addr=(address.host, address.port)))[0]

        self._transport = network.open(address, opening())
        port = self._transport.get_extra_info("sockname")[1]
        self.address = feed.name = str(Address(address.scheme, address.host, port))

    def start(self) -> None:
        """See Source."""

    def close(self) -> None:
        """See Source."""

        async def closing() -> None:
            self._transport.close()

        self._network.finish(closing())

    def datagram_received(self, data: bytes, addr: tuple[str | Any, int]) -> None:
        """Called by asyncio."""
        self._guard.take(data, addr, time.monotonic())
        self._feed.clients = self._guard.senders


@dataclass(frozen=True)
class PlaybackOptions:
    """How a recording is played."""

    speed: Annotated[float, Meta(ge=0.01, le=1000)] = 1.0  # 2 plays twice as fast
    repeat: Annotated[int, Meta(ge=1, le=100_000)] = 1  # how often it is played, with stamps that go on


@dataclass
class RecordedSource:
    """Plays a recording's frames, by stamp; each is acquired at the instant it is due."""

    address: str
    feed: Feed
    frames: Sequence[SkeletonFrame]
    options: PlaybackOptions

    def __post_init__(self) -> None:
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._play, name=self.address, daemon=True)

    def start(self) -> None:
        self._thread.start()

    def close(self) -> None:
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join(CLOSING)

    def _play(self) -> None:
        begun, speed = time.monotonic(), self.options.speed
        first, last = self.frames[0].stamp, self.frames[-1].stamp
        period = (last - first) * len(self.frames) / max(len(self.frames) - 1, 1)
        for turn, frame in itertools.product(range(self.options.repeat), self.frames):
            stamp = frame.stamp + turn * period
            due = begun + (stamp - first) / speed
            if self._stop.wait(max(due - time.monotonic(), 0.0)):
                break
            self.feed.put(replace(frame, stamp=stamp), due, speed)
        self.feed.end()
