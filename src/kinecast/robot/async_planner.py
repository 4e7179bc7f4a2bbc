"""Where plans are asked for and fetched: the supervisor never waits for one."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor

from kinecast.robot.choice import Choice, Request
from kinecast.robot.planner import NoPlan

log = logging.getLogger(__name__)

LATENCY = 0.1  # how long a plan takes [s]; in a thread, how long it is likely to take
Solve = Callable[[Request], Choice | NoPlan]
"""Chooses (kinecast.robot.choice)."""


class AsyncPlanner:
    """Takes one request at a time: one that is pending is dropped for the next, and its answer never seen.

    In a simulation it plans at once and hands the answer over `LATENCY` later: the same on every machine.

    Args:
        solve: the planner.
        threaded: whether it plans in a thread of its own, beside a real arm.
    """

    def __init__(self, solve: Solve, threaded: bool = False) -> None:
        self.pending: Request | None = None
        """What is being worked on."""
        self.worked = 0.0
        """Time spent planning in all [s], so that whoever measures the rest can take it off."""
        self._solve = solve
        self._pool = ThreadPoolExecutor(max_workers=1, thread_name_prefix="planner") if threaded else None
        self._future: Future[Choice | NoPlan] = Future()
        self._ready = 0.0

    def ask(self, request: Request, now: float) -> None:
        """Sets about a request, after the one it is working on."""
        self._future.cancel()
        self.pending = request
        if self._pool is not None:
            self._future = self._pool.submit(self._answered, request)
        else:
            self._future, self._ready = Future(), now + LATENCY
            self._future.set_result(self._answered(request))

    def answer(self, now: float) -> Choice | NoPlan | None:
        """What is best, or why there is no way: once, when it is there."""
        if self.pending is None or not self._future.done() or now < self._ready - 1e-9:
            return None
        self.pending = None
        return self._future.result()

    def close(self) -> None:
        """Ends the thread, once it is done with what it works on."""
        if self._pool is not None:
            self._pool.shutdown(cancel_futures=True)

    def _answered(self, request: Request) -> Choice | NoPlan:
        """Never raises: the arm goes on whatever happens to its planner."""
        began = time.perf_counter()
        try:
            return self._solve(request)
        except Exception as error:
            log.exception("planning of %r failed", request.options[0].step)
            return NoPlan(f"the planner failed: {error}", crashed=True)
        finally:
            self.worked += time.perf_counter() - began
