"""What a run of the simulation has shown so far: moments that can be gone back to, in bounded memory."""

from __future__ import annotations

import threading
from bisect import bisect_right
from collections import deque

from kinecast.errors import OptionError
from kinecast.robot.episode import Scenery
from kinecast.types import Decision

__all__ = ["Film"]

TOLD = 400
"""Decisions kept, the newest."""


class Film:
    """Moments and decisions of one run; written by one thread, read by others.

    When it is full, every other moment is dropped, and from then on only every other one is kept: a film of any length
    can be gone through from its beginning, more coarsely.

    Args:
        capacity: most moments kept; one is about 25 kB.
    """

    def __init__(self, capacity: int = 2000) -> None:
        if capacity < 2:
            raise OptionError(f"capacity is {capacity}, allowed is 2 or more")
        self.capacity = capacity
        self._lock = threading.Lock()
        self._scenes: list[Scenery] = []
        self._stamps: list[float] = []
        self._decisions: deque[Decision] = deque(maxlen=TOLD)
        self._every, self._passed = 1, 0
        self._newest: Scenery | None = None
        self._ending = ""

    def add(self, scene: Scenery) -> None:
        """Takes the next moment; stamps must rise."""
        with self._lock:
            self._newest = scene
            self._passed += 1
            due = (self._passed - 1) % self._every == 0
            if due and len(self._scenes) == self.capacity:
                del self._scenes[1::2], self._stamps[1::2]
                self._every *= 2
                due = (self._passed - 1) % self._every == 0
            if not due:
                return
            self._scenes.append(scene)
            self._stamps.append(scene.stamp)

    def tell(self, decision: Decision) -> None:
        """Takes a decision that is new."""
        with self._lock:
            self._decisions.append(decision)

    def finish(self, ending: str) -> None:
        """Nothing more will come.

        Args:
            ending: how it ended, in words.
        """
        with self._lock:
            self._ending = ending

    @property
    def finished(self) -> bool:
        """Whether nothing more will come."""
        return bool(self._ending)

    @property
    def ending(self) -> str:
        """How it ended, in words; empty while it goes on."""
        return self._ending

    @property
    def end(self) -> float:
        """Stamp of the newest moment [s]; 0 before the first."""
        newest = self._newest
        return 0.0 if newest is None else newest.stamp

    def __len__(self) -> int:
        return len(self._scenes)

    def at(self, time: float) -> Scenery | None:
        """The last moment not after a time [s], else the first; None before there is one."""
        with self._lock:
            if self._newest is None or time >= self._newest.stamp:
                return self._newest
            return self._scenes[max(bisect_right(self._stamps, time) - 1, 0)]

    def decisions(self, until: float, count: int) -> list[Decision]:
        """The last `count` decisions up to a time [s], the newest first."""
        with self._lock:
            told = [each for each in self._decisions if each.stamp <= until]
        return told[: -count - 1 : -1]
