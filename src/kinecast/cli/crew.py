"""Who does a command's tasks: this process, or a cluster."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from kinecast.cli.progress import note
from kinecast.tasks.workers import Serial, Workers

__all__ = ["crew"]


@contextmanager
def crew(where: str | None) -> Iterator[Workers]:
    """Workers for as long as they are needed.

    Args:
        where: of a cluster (kinecast.tasks.cluster.cluster_at), or None for this process.

    Raises:
        MissingExtraError: the extra for clusters is not installed.
        OptionError, ClusterError: as `cluster_at`.
    """
    if where is None:
        yield Serial()
        return
    from kinecast.tasks.cluster import cluster_at  # here, since clusters are an extra

    with cluster_at(where) as cluster:
        count = len(cluster.client.scheduler_info(n_workers=-1)["workers"])
        note(f"cluster {where}: {count} worker{'s' * (count != 1)}")
        yield cluster
