"""Public recordings whose licence allows it, downloaded, resumed and checked."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from fnmatch import fnmatchcase
from http.client import HTTPException
from importlib.resources import files
from pathlib import Path, PurePosixPath
from urllib.parse import quote, urlsplit

import pooch
from rich.progress import Progress

from kinecast.datasets.transfer import RemoteFile, ResumableTransfer, open_url
from kinecast.errors import DownloadError, OptionError

__all__ = ["PublicSet", "download", "public_sets"]

LARGEST_LISTING = 10_000_000
"""Bytes of a record's file list."""

MOST_FILES = 10_000

CHECKSUM = re.compile(r"(md5:[0-9a-f]{32}|sha256:[0-9a-f]{64})\Z")

UNSAFE = re.compile(r'[\x00-\x1f\x7f\\:*?"<>|]')
"""Characters that no file is given: control characters, and what means something to a shell or to Windows."""


@dataclass(frozen=True)
class PublicSet:
    """A set of recordings on the net.

    Attributes:
        name: what `download` calls it.
        about: one line.
        licence: its name.
        home: page to read first: licence and how to cite.
        url: address its files stand under; the address of its record where there is no list of files.
        files: name to checksum and size, from verified copies; None for a Zenodo record, which lists its own.
    """

    name: str
    about: str
    licence: str
    home: str
    url: str
    files: Mapping[str, tuple[str, int]] | None


def public_sets() -> dict[str, PublicSet]:
    """The sets `download` knows, by name."""
    table = json.loads((files("kinecast") / "data" / "downloads.json").read_text(encoding="utf-8"))
    return {
        name: PublicSet(
            name,
            entry["about"],
            entry["licence"],
            entry["home"],
            entry["url"],
            None
            if entry["files"] is None
            else {file: (f"sha256:{facts['sha256']}", facts["bytes"]) for file, facts in entry["files"].items()},
        )
        for name, entry in table.items()
    }


def download(
    name: str,
    folder: str | Path,
    progress: Progress | None = None,
    only: str = "*",
    url: str | None = None,
    patience: float = 1.0,
) -> list[Path]:
    """Download a public set; files already there and whole are kept, broken ones are continued.

    Args:
        name: one of `public_sets()`.
        folder: where the files go; nothing is written outside it.
        progress: a bar to advance, or None.
        only: which files, as a pattern on their names, e.g. `"PickPlace*"`.
        url: in place of the set's own address, e.g. a mirror.
        patience: seconds before a broken connection is tried again; doubles with each attempt.

    Returns:
        The files, each with the right checksum.

    Raises:
        OptionError: no such set.
        DownloadError: no connection, a wrong checksum or name, too little space. Files that are complete
            stay; an incomplete one never has its final name.
    """
    known = public_sets()
    if name not in known:
        raise OptionError(f"no public set {name!r}; there are {', '.join(known)}")
    remotes = [file for file in _listing(known[name], url or known[name].url) if fnmatchcase(file.name, only)]
    if not remotes:
        raise DownloadError(f"{name}: no file matches {only!r}")
    root = Path(folder)
    targets = [_target(root, remote.name) for remote in remotes]
    missing = sum(remote.size for remote, target in zip(remotes, targets, strict=True) if not target.exists())
    root.mkdir(parents=True, exist_ok=True)
    if missing > (free := shutil.disk_usage(root).free):
        raise DownloadError(f"{name}: {missing / 1e9:.2f} GB are missing, {root} has {free / 1e9:.2f} GB left")
    pooch.get_logger().setLevel("WARNING")  # the bar says what is going on
    store = pooch.create(
        path=root,
        base_url="",
        registry={remote.name: remote.checksum for remote in remotes},
        urls={remote.name: remote.url for remote in remotes},
    )
    task = None if progress is None else progress.add_task(name, total=sum(remote.size for remote in remotes))
    done = 0
    for remote, target in zip(remotes, targets, strict=True):

        def advance(present: int, before: int = done) -> None:
            if progress is not None and task is not None:
                progress.update(task, completed=before + present)

        _fetch(store, remote, target, ResumableTransfer(remote, _part(remote, target), advance, patience))
        done += remote.size
        advance(remote.size)
    return targets


def _fetch(store: pooch.Pooch, remote: RemoteFile, target: Path, transfer: ResumableTransfer) -> None:
    """One file, through pooch: kept if whole, else downloaded, checked and moved into place."""
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        store.fetch(remote.name, downloader=transfer)
    except DownloadError:
        raise
    except ValueError:  # pooch: the checksum
        raise DownloadError(
            f"{remote.name}: what {remote.url} sent is not the file it should be (its checksum differs from"
            f" {remote.checksum}); nothing of it is kept"
        ) from None
    except OSError as error:
        raise DownloadError(f"{remote.name}: cannot be stored in {target.parent}: {error}") from None


def _part(remote: RemoteFile, target: Path) -> Path:
    """Where an incomplete file waits; another version of the file waits elsewhere."""
    return target.with_name(f"{target.name}.{remote.checksum.partition(':')[2][:8]}.part")


def _target(root: Path, name: str) -> Path:
    """The place of a file inside the folder.

    Raises:
        DownloadError: a name that leads elsewhere, or that some system cannot store.
    """
    parts = name.split("/")
    if (
        UNSAFE.search(name)
        or len(name) > 400
        or any(part in ("", ".", "..") or part != part.strip(" .") or len(part) > 200 for part in parts)
    ):
        raise DownloadError(f"refusing the file name {name[:80]!r}: it is not a plain path inside the folder")
    target = root.joinpath(*PurePosixPath(name).parts)
    if not target.resolve().is_relative_to(root.resolve()):
        raise DownloadError(f"refusing the file name {name!r}: a link in {root} leads outside")
    return target


def _listing(public: PublicSet, url: str) -> list[RemoteFile]:
    """What there is to download."""
    if public.files is None:
        return _zenodo_listing(public, url)
    base = url if url.endswith("/") else url + "/"
    return [RemoteFile(name, base + quote(name), checksum, size) for name, (checksum, size) in public.files.items()]


def _zenodo_listing(public: PublicSet, url: str) -> list[RemoteFile]:
    """The files of a Zenodo record, with the checksums its API states."""
    try:
        with open_url(url, {"Accept": "application/json"}) as response:
            content = response.read(LARGEST_LISTING + 1)
    except (OSError, HTTPException) as error:
        if isinstance(error, DownloadError):
            raise
        raise DownloadError(f"{public.name}: cannot read the list of files at {url}: {error}") from None
    if len(content) > LARGEST_LISTING:
        raise DownloadError(f"{public.name}: the list of files at {url} is larger than {LARGEST_LISTING} bytes")
    try:
        record = json.loads(content)
        access = record["metadata"].get("access_right", "open")
        remotes = [
            RemoteFile(str(f["key"]), str(f["links"]["self"]), str(f["checksum"]), int(f["size"]))
            for f in record["files"]
        ]
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
        raise DownloadError(f"{public.name}: {url} did not answer with a record and its files") from None
    if access != "open":
        raise DownloadError(f"{public.name}: its record is not open ({access}); see {public.home}")
    if len(remotes) > MOST_FILES or len({remote.name for remote in remotes}) != len(remotes):
        raise DownloadError(f"{public.name}: {len(remotes)} files, some of the same name or more than {MOST_FILES}")
    server = "{0.scheme}://{0.netloc}/".format(urlsplit(url))
    for remote in remotes:
        if not CHECKSUM.match(remote.checksum) or remote.size < 0:
            raise DownloadError(f"{public.name}: {remote.name!r} has no usable checksum: {remote.checksum[:80]!r}")
        if not remote.url.startswith(server):
            raise DownloadError(f"{public.name}: {remote.name!r} is listed on another server: {remote.url[:200]}")
    return remotes
