"""`kinecast download`: public recordings whose licence allows it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro
from rich.progress import BarColumn, DownloadColumn, Progress, TextColumn, TransferSpeedColumn

from kinecast.cli.progress import CONSOLE
from kinecast.datasets.download import download as fetch
from kinecast.datasets.download import public_sets

__all__ = ["download"]


def download(
    name: Annotated[str | None, tyro.conf.Positional] = None,
    out: Path = Path("recordings"),
    only: str = "*",
    url: str | None = None,
) -> None:
    """Downloads a public set of recordings, checked and resumable; without a name, lists the sets.

    Args:
        name: of the set.
        out: folder for the files.
        only: which files, as a pattern on their names, e.g. "PickPlace*".
        url: fetch from this address, e.g. a mirror, instead of the set's own.
    """
    if name is None:
        for each in public_sets().values():
            print(f"{each.name}: {each.about} ({each.licence}; {each.home})")
        return
    columns = (TextColumn("{task.description}"), BarColumn(), DownloadColumn(), TransferSpeedColumn())
    with Progress(*columns, console=CONSOLE, transient=True) as progress:
        files = fetch(name, out / name, progress, only, url)
    print(f"{len(files)} files in {out / name}")
