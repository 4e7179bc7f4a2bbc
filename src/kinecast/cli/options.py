"""Options that several commands share: how help names them, what it says of their defaults, and what they stand for."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

from tyro.conf import FlagCreatePairsOff, Positional, arg

from kinecast.cli.formats import FORMAT_NAMES
from kinecast.cli.progress import note
from kinecast.errors import OptionError
from kinecast.prediction.methods import METHODS
from kinecast.tasks import Serial, Workers

_METHODS = "".join(f"\n• {name}: {about}" for name, about in METHODS.items())

Many = Annotated[tuple[Path, ...], arg(metavar="PATH [PATH ...]", help_behavior_hint="")]
What = Positional[Many]
File = Annotated[Path, arg(metavar="FILE")]
Folder = Annotated[Path, arg(metavar="FOLDER")]
Switch = FlagCreatePairsOff[bool]
SceneFile = Annotated[Path | None, arg(metavar="FILE", help_behavior_hint="(default: none)")]
ClusterPlace = Annotated[
    str | None,
    arg(metavar="ADDRESS|local[:N]", help_behavior_hint="(default: this process)"),
]
Action = Annotated[str | None, arg(metavar="ACTION", help_behavior_hint="(default: all)")]
FormatName = Annotated[
    str | None,
    arg(
        metavar="NAME",
        help=f"format of the recordings: {', '.join(FORMAT_NAMES)}.",
        help_behavior_hint="(default: found by content)",
    ),
]
MethodName = Annotated[
    str,
    arg(metavar="NAME", help=f"the method:{_METHODS}", help_behavior_hint=lambda default: f"\n(default: {default})"),
]
MethodNames = Annotated[
    str,
    arg(
        metavar="NAME,NAME,...",
        help=f"methods to train:{_METHODS}\nor MODULE:FUNCTION, your own (docs/predictor.md)",
        help_behavior_hint=lambda default: f"\n(default: {default.replace(',', ', ')})",
    ),
]


def check_seed(seed: int) -> None:
    """Raises OptionError for a seed that no random generator takes."""
    if seed < 0:
        raise OptionError(f"seed is {seed}, allowed is 0 or more")


@contextmanager
def worker_pool(where: str | None) -> Iterator[Workers]:
    """Workers for as long as they are needed: of a cluster (kinecast.tasks.cluster_at), or this process."""
    if where is None:
        yield Serial()
        return
    from kinecast.tasks import cluster_at  # here, since clusters are an extra

    with cluster_at(where) as cluster:
        count = len(cluster.client.scheduler_info(n_workers=-1)["workers"])
        note(f"cluster {where}: {count} worker{'s' * (count != 1)}")
        yield cluster
