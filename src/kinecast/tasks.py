"""Long work as tasks: one after another in this process, or spread over a Dask cluster, with the same results.

A task is a function and its arguments; an argument may be what `submit` returned for another task, alone or in a list.
Nothing else may pass between tasks: no global state, and no generator of random numbers but one made from a seed and
the task's own place (`generator`). Their order then does not matter, nor where they run.

What passes between client, scheduler and workers of a cluster is pickled: whoever can reach one of them can run code
there. A cluster on this machine listens to this machine alone.
"""

from __future__ import annotations

import logging
import os
import pickle
import platform
import re
import signal
import sys
import uuid
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError, Future
from contextlib import ExitStack, closing, contextmanager, suppress
from importlib.metadata import version
from importlib.util import find_spec
from types import ModuleType
from typing import Any

import numpy as np
from threadpoolctl import threadpool_info, threadpool_limits

from kinecast.errors import ClusterError, MissingExtraError, OptionError

CARRIED: set[ModuleType] = set()  # the user's own modules, whose code travels with tasks: workers may not have them
PATIENCE = 60  # how long the first worker may take to come, and how long there may be none [s]
MATTERING = ("kinecast", "numpy", "scipy", "numba", "jax", "jaxlib")  # their versions may change a result's last bits
THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")
SETTINGS = {
    # One thread, since there are as many workers as cores. This replaces Dask's own environment of a worker, which
    # makes the C library hand every array's memory back: half as fast.
    "distributed.nanny.pre-spawn-environ": {**dict.fromkeys(THREADS, "1"), "OMP_WAIT_POLICY": "PASSIVE"},
    "distributed.admin.large-graph-warning-threshold": 2**40,  # recordings and windows travel with the tasks
    "distributed.deploy.lost-worker-timeout": "1 hour",  # a busy machine needs long to start another; Dask gives up
}

Progress = Callable[[int, int], None]
"""Called with (done, total) tasks."""


class Serial:
    """Workers that are this process: each task in its turn."""

    def __init__(self) -> None:
        self._waiting: list[tuple[Future[Any], tuple[Any, ...]]] = []

    def submit(self, function: Callable[..., Any], *arguments: Any) -> Future[Any]:
        """Takes a task on: a function of a module, or a partial of one. Returns what stands for its result."""
        task = Future[Any]()
        self._waiting.append((task, (function, *arguments)))
        return task

    def results(self, handles: Sequence[Future[Any]], progress: Progress | None = None) -> list[Any]:
        """What tasks gave, once every task taken on is done and its arguments are let go.

        Args:
            handles: what `submit` returned.
            progress: called with (done, total) tasks taken on since the last results.

        Raises:
            Exception: what the first task that failed raised.
        """
        waiting, self._waiting = self._waiting[::-1], []
        total = len(waiting)
        while waiting:
            task, call = waiting.pop()
            task.set_result(single_threaded(*map(_value, call)))
            if progress:
                progress(total - len(waiting), total)
        return [_value(task) for task in handles]


def _value(argument: Any) -> Any:
    if isinstance(argument, list):
        return [_value(each) for each in argument]
    return argument.result(timeout=0) if isinstance(argument, Future) else argument


def single_threaded(function: Callable[..., Any], *arguments: Any) -> Any:
    """A function's result, its linear algebra in one thread: sums over several threads would depend on their number."""
    import scipy.linalg  # noqa: F401 - a BLAS that is not loaded yet could not be limited

    with threadpool_limits(1, user_api="blas"):
        return function(*arguments)


def generator(seed: int, *place: int) -> np.random.Generator:
    """Random numbers of one task: the same for the same place, unlike those of every other place and seed."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=place))


def scatter(value: Any) -> Any:
    """A value as a task, so that it travels once to each worker, however many tasks need it."""
    return value


class Cluster:
    """Workers that are a Dask cluster's; the tasks of a worker that is lost are done again by others.

    Args:
        client: a distributed.Client, connected to a scheduler.
    """

    def __init__(self, client: Any) -> None:
        self.client = client
        self._waiting: list[Any] = []

    def submit(self, function: Callable[..., Any], *arguments: Any) -> Any:
        """See Serial."""
        import cloudpickle
        from distributed import Future as Remote

        for module in CARRIED:
            cloudpickle.register_pickle_by_value(module)
        name = getattr(getattr(function, "func", function), "__name__", "task").strip("_")
        # Bytes for Dask, which loses a worker that cannot unpickle what comes.
        call = [each if isinstance(each, Remote | list) else cloudpickle.dumps(each) for each in (function, *arguments)]
        self._waiting.append(self.client.submit(_on_worker, *call, key=f"{name}-{uuid.uuid4().hex}", pure=False))
        return self._waiting[-1]

    def results(self, handles: Sequence[Any], progress: Progress | None = None) -> list[Any]:
        """See Serial; a ClusterError where the scheduler is gone, no worker is left, or they die under a task."""
        from distributed import KilledWorker, as_completed

        waiting, self._waiting = self._waiting, []
        rest = dict.fromkeys(waiting)
        try:
            while rest:
                with suppress(TimeoutError):
                    for future in as_completed(list(rest), loop=self.client.loop, timeout=PATIENCE):
                        del rest[future]
                        if future.status != "finished":
                            future.result()  # raises what the task raised
                        if progress:
                            progress(len(waiting) - len(rest), len(waiting))
                if rest and not self.workers:
                    raise ClusterError(f"no worker is left; {len(rest)} tasks are not done")
            found: list[Any] = self.client.gather(list(handles))
        except KilledWorker as error:
            died, task = error.allowed_failures, str(error.task).partition("-")[0]
            raise ClusterError(f"{died} workers died under the task {task}: is there enough memory?") from None
        except (Exception, CancelledError) as error:
            if self.client.status != "running":
                raise ClusterError("the scheduler is gone") from error
            self.client.cancel(waiting, force=True)
            raise
        return found

    @property
    def workers(self) -> dict[str, Any]:
        """What is known of each worker that is there now, by address."""
        found: dict[str, Any] = self.client.scheduler_info(n_workers=-1)["workers"]
        return found


Workers = Serial | Cluster


def _on_worker(*call: Any) -> Any:
    try:
        loaded = [pickle.loads(each) if isinstance(each, bytes) else each for each in call]
    except ImportError as error:
        raise ClusterError(f"a worker lacks something: {error}") from error
    return single_threaded(*loaded)


@contextmanager
def cluster_at(where: str) -> Iterator[Cluster]:
    """A cluster, for as long as it is needed (extra `cluster`).

    Args:
        where: `local` for a worker on every core of this machine, `local:N` for N of them, or a scheduler's address.

    Raises:
        OptionError: it is neither.
        ClusterError: there is none, no worker comes, or the workers are not fit.
    """
    try:
        import dask
        from distributed import Client, LocalCluster
    except ImportError as error:  # pragma: no cover - the tests install it
        raise MissingExtraError("clusters", "cluster") from error

    count = worker_count(where)
    with dask.config.set(SETTINGS), ExitStack() as opened:
        try:
            scheduler: Any = where
            if count is not None:
                with _deaf_to_interrupts():
                    local = LocalCluster(
                        n_workers=count, threads_per_worker=1, host="127.0.0.1", dashboard_address="127.0.0.1:0",
                        memory_limit=0, silence_logs=logging.CRITICAL,
                    )  # fmt: skip
                    scheduler = opened.enter_context(closing(local))
            client = opened.enter_context(closing(Client(scheduler, timeout=PATIENCE, set_as_default=False)))
        except (OSError, ValueError) as error:
            raise ClusterError(f"--cluster {where}: no scheduler ({error})") from None
        cluster = Cluster(client)
        _check(cluster, f"--cluster {where}", count or 1)
        yield cluster


def worker_count(where: str) -> int | None:
    """Workers asked for on this machine; None for a scheduler's address.

    Raises:
        OptionError: no address, or a number of workers outside 1..1024.
    """
    kind, _, number = where.partition(":")
    if kind != "local" and number:
        return None
    if where == "local":
        return len(os.sched_getaffinity(0))
    if re.fullmatch("[0-9]{1,4}", number) and 1 <= int(number) <= 1024:
        return int(number)
    raise OptionError(f"--cluster {where}: expected local, local:N with N of 1..1024, or HOST:PORT, tls://HOST:PORT")


@contextmanager
def _deaf_to_interrupts() -> Iterator[None]:
    """Threads and processes begun meanwhile do not hear Ctrl-C, which a terminal sends to all."""
    from multiprocessing import resource_tracker

    sys.warnoptions.append("ignore:resource_tracker")  # it tidies up after a process that is killed, and says so
    resource_tracker.ensure_running()  # else the first process would start it, and let interrupts in again
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _check(cluster: Cluster, where: str, count: int) -> None:
    """Workers are there, with one thread each, and compute as this process does."""
    try:
        cluster.client.wait_for_workers(count, timeout=PATIENCE)
    except TimeoutError:
        raise ClusterError(f"{where}: no worker came within {PATIENCE} s") from None
    if any(worker["nthreads"] != 1 for worker in cluster.workers.values()):
        raise ClusterError(f"{where}: a worker has several threads; start workers with --nthreads 1")
    try:
        found = cluster.client.run(_facts)
    except ImportError as error:
        raise ClusterError(f"{where}: a worker cannot run kinecast ({error})") from None
    own = _facts()
    for worker, others in found.items():
        if unlike := [f"{name} {other} and not {own[name]}" for name, other in others.items() if other != own[name]]:
            raise ClusterError(f"{where}: {worker} has {', '.join(unlike)}; results would differ")


def _facts() -> dict[str, str]:
    """What the last bits of results depend on; not the BLAS that a wheel such as OpenCV's has for itself."""
    versions = {name: version(name) if find_spec(name) else "(none)" for name in MATTERING}
    pools = [pool for pool in threadpool_info() if pool["user_api"] == "blas"]
    ours = [pool for pool in pools if not re.search(r"(?<!numpy|scipy)\.libs/", pool["filepath"])]
    blas = "/".join(sorted({str(pool.get("architecture")) for pool in ours}))
    return {"processor": platform.machine(), "BLAS": blas, **versions}
