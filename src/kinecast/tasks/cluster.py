"""Tasks spread over the workers of a Dask cluster, on this machine or others (extra `cluster`).

What passes between client, scheduler and workers is pickled: whoever can reach one of them can run code there. A
cluster on this machine listens to this machine alone.
"""

from __future__ import annotations

import logging
import os
import pickle
import platform
import signal
import uuid
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager
from functools import partial
from importlib.metadata import PackageNotFoundError, version
from multiprocessing import resource_tracker
from pathlib import Path
from typing import Any

import numba
from threadpoolctl import threadpool_info

from kinecast.errors import ClusterError, MissingExtraError, OptionError
from kinecast.tasks.workers import CARRIED, Progress, alone

try:
    import cloudpickle
    import dask
    from distributed import Client, Future, KilledWorker, LocalCluster, as_completed
except ImportError as error:  # pragma: no cover - the tests install it
    raise MissingExtraError("clusters", "cluster") from error

__all__ = ["Cluster", "cluster_at", "worker_count"]

THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "NPROC")
ENVIRONMENT = {**dict.fromkeys(THREADS, "1"), "OMP_WAIT_POLICY": "PASSIVE"}
"""Of a worker on this machine: one thread, since there are as many workers as cores. Dask sets it in this process too
while one starts, so that numba, which would take it for this process, is told by each task."""
PATIENCE = 60
"""How long the first worker may take to come [s]."""
DEATHS = 3
"""Workers of this machine that may die under the same task before it is given up."""
MATTERING = ("numpy", "scipy", "numba", "jax", "jaxlib")
"""Packages whose version may change the last bits of results."""


class Cluster:
    """See kinecast.tasks.workers.Workers; the tasks of a worker that is lost are done again by others.

    Args:
        client: connected to a scheduler.
    """

    def __init__(self, client: Client) -> None:
        self.client = client
        self._waiting: list[Any] = []

    def submit(self, function: Callable[..., Any], *arguments: Any) -> Any:
        """See Workers."""
        for module in CARRIED:
            cloudpickle.register_pickle_by_value(module)
        name = getattr(function.func if isinstance(function, partial) else function, "__name__", "task")
        key = f"{name.strip('_')}-{uuid.uuid4().hex}"
        future = self.client.submit(_on_a_core, *map(_packed, (function, *arguments)), key=key, pure=False)
        self._waiting.append(future)
        return future

    def _as_completed(self, futures: Sequence[Any]) -> Iterator[Any]:
        """Each future once it is done.

        Raises:
            ClusterError: no worker is left to do the rest.
        """
        rest = dict.fromkeys(futures)
        while rest:
            try:
                for future in as_completed(list(rest), loop=self.client.loop, timeout=PATIENCE):
                    del rest[future]
                    yield future
            except TimeoutError:
                if not self.client.scheduler_info(n_workers=-1)["workers"]:
                    raise ClusterError(f"no worker is left; {len(rest)} tasks are not done") from None

    def results(self, handles: Sequence[Any], progress: Progress | None = None) -> list[Any]:
        """See Workers.

        Raises:
            ClusterError: the scheduler is gone, or no worker is left, or workers died again and again under a task.
        """
        waiting, self._waiting = self._waiting, []
        try:
            for done, future in enumerate(self._as_completed(waiting), 1):
                if future.status != "finished":
                    future.result()  # raises what the task raised
                if progress:
                    progress(done, len(waiting))
            found: list[Any] = self.client.gather(list(handles))
        except KilledWorker as error:
            task = str(error.task).partition("-")[0]
            raise ClusterError(f"{DEATHS} workers died under the task {task}: is there enough memory?") from None
        except BaseException as error:
            if self.client.status == "running":
                self.client.cancel(waiting, force=True)
                raise
            raise ClusterError("the scheduler is gone") from error
        return found


@contextmanager
def cluster_at(where: str) -> Iterator[Cluster]:
    """A cluster, for as long as it is needed.

    Args:
        where: `local` for a worker on every core of this machine, `local:N` for N of them, or a scheduler's address.

    Raises:
        OptionError: it is neither.
        ClusterError: there is none, no worker comes, or the workers are not fit.
    """
    count = worker_count(where)
    settings = {
        # In place of Dask's own, which makes the C library hand every array's memory back: half as fast.
        "distributed.nanny.pre-spawn-environ": ENVIRONMENT,
        "distributed.admin.large-graph-warning-threshold": 2**40,  # recordings and windows travel with the tasks
        "distributed.scheduler.allowed-failures": DEATHS,
    }
    with dask.config.set(settings), ExitStack() as opened:
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
        _check(client, where, count or 1)
        yield Cluster(client)


@contextmanager
def _deaf_to_interrupts() -> Iterator[None]:
    """Threads and processes begun meanwhile do not hear Ctrl-C, which a terminal sends to all: this process ends them.

    One that comes meanwhile is heard at the end.
    """
    if not hasattr(signal, "pthread_sigmask"):  # pragma: no cover - Windows
        yield
        return
    resource_tracker.ensure_running()  # else the first process would start it, and let interrupts in again
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def worker_count(where: str) -> int | None:
    """Workers asked for on this machine; None for a scheduler's address.

    Raises:
        OptionError: no address, or a number of workers below 1.
    """
    kind, _, number = where.partition(":")
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    if where == "local":
        return cores
    if kind == "local" and number.isascii() and number.isdigit() and 1 <= int(number) <= 1024:
        return int(number)
    if kind == "local" or not number:
        raise OptionError(
            f"--cluster {where}: expected local, local:N with N of 1..1024, or HOST:PORT, tls://HOST:PORT"
        )
    return None


class _Packed:
    """A pickled value. A worker that cannot unpickle what comes is lost to Dask; a task that cannot just fails."""

    def __init__(self, content: bytes) -> None:
        self.content = content


def _packed(value: Any) -> Any:
    """A value for the way, but for what stands for other tasks."""
    if isinstance(value, Future):
        return value
    if isinstance(value, list):
        return [_packed(each) for each in value]
    return _Packed(cloudpickle.dumps(value))


def _unpacked(value: Any) -> Any:
    if isinstance(value, list):
        return [_unpacked(each) for each in value]
    return pickle.loads(value.content) if isinstance(value, _Packed) else value


def _on_a_core(*call: Any) -> Any:
    """A task on a worker: all of it in one thread."""
    numba.set_num_threads(1)
    try:
        function, *arguments = map(_unpacked, call)
    except ImportError as error:
        raise ClusterError(f"a worker lacks something: {error}") from error
    return alone(function, *arguments)


def _check(client: Client, where: str, count: int) -> None:
    """Workers are there, with one thread each, and compute as this process does."""
    try:
        client.wait_for_workers(count, timeout=PATIENCE)
    except TimeoutError:
        raise ClusterError(f"--cluster {where}: no worker came within {PATIENCE} s") from None
    workers = client.scheduler_info(n_workers=-1)["workers"]
    if any(worker["nthreads"] != 1 for worker in workers.values()):
        raise ClusterError(f"--cluster {where}: a worker has several threads; start workers with --nthreads 1")
    try:
        found = client.run(facts)
    except ImportError as error:
        raise ClusterError(f"--cluster {where}: a worker cannot run kinecast ({error})") from None
    own = facts()
    for worker, others in found.items():
        unlike = [f"{name} {other} and not {own[name]}" for name, other in others.items() if other != own[name]]
        if unlike:
            raise ClusterError(f"--cluster {where}: {worker} has {', '.join(unlike)}; results would differ")


def facts() -> dict[str, str]:
    """What the last bits of results depend on."""
    found = {"kinecast": version("kinecast"), "processor": platform.machine()}
    for package in MATTERING:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            found[package] = "(none)"
    pools = [pool for pool in threadpool_info() if pool["user_api"] == "blas"]
    kinds = {str(pool.get("architecture")) for pool in pools if not _brought_along(Path(pool["filepath"]))}
    return {**found, "BLAS": "/".join(sorted(kinds))}


def _brought_along(library: Path) -> bool:
    """Whether it is one that a wheel other than NumPy's and SciPy's, such as OpenCV's, has for itself."""
    folder = library.parent.name
    return folder.endswith(".libs") and folder not in ("numpy.libs", "scipy.libs")
