"""`kinecast download`: public recordings and models whose licence allows it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Annotated

from rich.progress import BarColumn, DownloadColumn, Progress, TextColumn, TransferSpeedColumn
from tyro.conf import Positional, arg

from kinecast.cli.options import check_folder
from kinecast.cli.progress import CONSOLE
from kinecast.datasets.remote_file import cache_folder, public_sets
from kinecast.datasets.remote_file import download as fetch

OutFolder = Annotated[
    Path | None, arg(metavar="FOLDER", help_behavior_hint="(default: recordings; of models the cache folder)")
]


def download(
    name: Positional[Annotated[str | None, arg(metavar="[NAME]", help_behavior_hint="")]] = None,
    out: OutFolder = None,
    only: Annotated[str, arg(metavar="PATTERN")] = "*",
    url: Annotated[str | None, arg(metavar="URL", help_behavior_hint="")] = None,
) -> None:
    """Downloads a public set of recordings or a model, checked and resumable; without a name, lists them.

    Args:
        name: of the set or model.
        out: folder for the set's own folder, or for the model.
        only: which files, as a pattern on their names, e.g. "PickPlace*".
        url: fetch from this address, e.g. a mirror, instead of the set's own.
    """
    if name is None:
        for each in public_sets().values():
            print(f"{each.name}\n  {each.about}\n  licence: {each.licence}; see {each.home}")
        return
    chosen = public_sets().get(name)
    model = chosen if chosen is not None and chosen.model is not None else None
    out = out or (cache_folder() if model else Path("recordings"))
    check_folder(out)
    if model:
        print(f"{model.about}\nlicence: {model.licence}; see {model.home}")
    place = out if model else out / name
    columns = (TextColumn("{task.description}"), BarColumn(), DownloadColumn(), TransferSpeedColumn())
    bars = Progress(*columns, console=CONSOLE, transient=True, disable=not CONSOLE.is_terminal)
    with _without_empty_folders(place.absolute()), bars as progress:
        found = fetch(name, place, progress, only, url)
    print(f"{name}: {found[0]}" if model else f"{len(found)} file{'s' * (len(found) != 1)} in {place}")


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
