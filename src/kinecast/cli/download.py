"""`kinecast download`: public recordings whose licence allows it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Annotated

from rich.progress import BarColumn, DownloadColumn, Progress, TextColumn, TransferSpeedColumn
from tyro.conf import Positional, arg

from kinecast.cli.options import Folder, check_folder
from kinecast.cli.progress import CONSOLE
from kinecast.datasets.download import download as fetch
from kinecast.datasets.download import public_sets


def download(
    name: Positional[Annotated[str | None, arg(metavar="[NAME]", help_behavior_hint="")]] = None,
    out: Folder = Path("recordings"),
    only: Annotated[str, arg(metavar="PATTERN")] = "*",
    url: Annotated[str | None, arg(metavar="URL", help_behavior_hint="")] = None,
) -> None:
    """Downloads a public set of recordings, checked and resumable; without a name, lists the sets.

    Args:
        name: of the set.
        out: folder for the set's own folder.
        only: which files, as a pattern on their names, e.g. "PickPlace*".
        url: fetch from this address, e.g. a mirror, instead of the set's own.
    """
    if name is None:
        for each in public_sets().values():
            print(f"{each.name}\n  {each.about}\n  licence: {each.licence}; see {each.home}")
        return
    check_folder(out)
    columns = (TextColumn("{task.description}"), BarColumn(), DownloadColumn(), TransferSpeedColumn())
    bars = Progress(*columns, console=CONSOLE, transient=True, disable=not CONSOLE.is_terminal)
    with _without_empty_folders((out / name).absolute()), bars as progress:
        files = fetch(name, out / name, progress, only, url)
    print(f"{len(files)} file{'s' * (len(files) != 1)} in {out / name}")


@contextmanager
def _without_empty_folders(out: Path) -> Iterator[None]:
    """After an error, removes `out`, what is in it and what it is in, as far as they are empty and new."""
    old = {folder for folder in (out, *out.parents, *out.rglob("*")) if folder.exists()}
    try:
        yield
    except BaseException:
        new = {out, *out.parents, *out.rglob("*")} - old
        for folder in sorted(new, key=lambda folder: len(folder.parts), reverse=True):
            with suppress(OSError):
                folder.rmdir()
        raise
