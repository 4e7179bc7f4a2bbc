"""A recording as a camera: its frames at the pace they were taken, or faster."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace

from kinecast.errors import OptionError
from kinecast.live.mailbox import Feed
from kinecast.types import SkeletonFrame

__all__ = ["RecordedSource"]


class RecordedSource:
    """Plays frames; each is acquired at the instant it is due.

    Args:
        name: for messages.
        feed: where frames go.
        frames: by stamp, at least one.
        speed: 2 plays twice as fast, 0.01..1000.
        repeat: how often it is played, with stamps that go on; 1 or more.

    Raises:
        OptionError: a speed or repeat outside its range.
    """

    def __init__(
        self, name: str, feed: Feed, frames: Sequence[SkeletonFrame], speed: float = 1.0, repeat: int = 1
    ) -> None:
        if not 0.01 <= speed <= 1000:
            raise OptionError(f"{name}: speed {speed:g} is outside 0.01..1000")
        if repeat < 1:
            raise OptionError(f"{name}: repeat {repeat} must be at least 1")
        self.address = name
        self.speed = speed
        self.repeat = repeat
        self._feed = feed
        self._frames = frames
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None

    def start(self) -> None:
        """Begins to play."""
        self._thread = threading.Thread(target=self._play, name=self.address, daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stops, and waits until it has."""
        self._stop.set()
        if self._thread:
            self._thread.join()

    def _play(self) -> None:
        begun = time.monotonic()
        for after, frame in self._due():
            due = begun + after
            if self._stop.wait(max(due - time.monotonic(), 0.0)):
                break
            self._feed.put(frame, due, self.speed)
        self._feed.end()

    def _due(self) -> Iterator[tuple[float, SkeletonFrame]]:
        """Every frame, and how long after the beginning it is due [s]."""
        first, last = self._frames[0].stamp, self._frames[-1].stamp
        period = (last - first) * len(self._frames) / max(len(self._frames) - 1, 1)
        for turn in range(self.repeat):
            for frame in self._frames:
                stamp = frame.stamp + turn * period
                yield (stamp - first) / self.speed, replace(frame, stamp=stamp) if turn else frame
