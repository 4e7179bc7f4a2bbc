"""Where plans are asked for and fetched: the supervisor never waits for one."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from typing import TypeAlias

from kinecast.errors import OptionError
from kinecast.robot.choice import Choice, Request
from kinecast.robot.planner import NoPlan

__all__ = ["Answer", "AsyncPlanner", "DeferredPlanner", "Solve", "ThreadPlanner"]

log = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class Answer:
    """What came of a request.

    Attributes:
        request: answered.
        choice: what is best; None where there is no way.
        reason: why there is none, in words.
        crashed: whether the planner failed rather than found nothing.
    """

    request: Request
    choice: Choice | None
    reason: str = ""
    crashed: bool = False


Solve = Callable[[Request], Choice | NoPlan]
"""Chooses (kinecast.robot.choice)."""


class DeferredPlanner:
    """Plans at once and hands the answer over a fixed time later: a simulation that is the same on every machine.

    Args:
        solve: the planner.
        latency: [s].
        clock: that its work is timed by [s].
    """

    def __init__(self, solve: Solve, latency: float = 0.1, clock: Callable[[], float] = time.perf_counter) -> None:
        if not latency >= 0:
            raise OptionError(f"latency {latency} s must be 0 or more")
        self.pending: Request | None = None
        """What is being worked on."""
        self.latency = latency
        self.worked = 0.0
        """Time spent planning in all [s], so that whoever measures the rest can take it off."""
        self._solve, self._clock = solve, clock

    def ask(self, request: Request, now: float) -> None:
        """Plans; the answer is there after the latency."""
        began = self._clock()
        self._answer, self._ready = _answered(self._solve, request), now + self.latency
        self.worked += self._clock() - began
        self.pending = request

    def answer(self, now: float) -> Answer | None:
        """The answer, once, when the latency has passed."""
        if self.pending is None or now < self._ready - 1e-9:
            return None
        self.pending = None
        return self._answer


class ThreadPlanner:
    """Plans in a thread of its own, beside a real arm.

    Args:
        solve: the planner; called from that thread only.
        latency: how long it is likely to take [s].
    """

    def __init__(self, solve: Solve, latency: float = 0.1) -> None:
        self.pending: Request | None = None
        """What is being worked on."""
        self.latency = latency
        self._solve = solve
        self._pool = ThreadPoolExecutor(max_workers=1, thread_name_prefix="planner")
        self._future: Future[Answer] | None = None

    def ask(self, request: Request, now: float) -> None:
        """Hands a request to the thread, after the one it is working on."""
        if self._future is not None:
            self._future.cancel()
        self.pending, self._future = request, self._pool.submit(_answered, self._solve, request)

    def answer(self, now: float) -> Answer | None:
        """The answer, once, when the thread is done."""
        if self._future is None or not self._future.done():
            return None
        answer, self._future, self.pending = self._future.result(), None, None
        return answer

    def close(self) -> None:
        """Ends the thread, once it is done with what it works on."""
        self._pool.shutdown(cancel_futures=True)


AsyncPlanner: TypeAlias = DeferredPlanner | ThreadPlanner
"""Takes one request at a time: one that is pending is dropped for the next, and its answer never seen."""


def _answered(solve: Solve, request: Request) -> Answer:
    """Never raises: the arm goes on whatever happens to its planner."""
    try:
        found = solve(request)
    except Exception as error:
        log.exception("planning for %s failed", request.why)
        return Answer(request, None, f"the planner failed: {error}", True)
    return Answer(request, None, found.reason) if isinstance(found, NoPlan) else Answer(request, found)
