"""Public recordings and pose models, downloaded: resumed where they broke off, checked, inside their folder."""

from __future__ import annotations

import hashlib
import http.client
import json
import os
import re
import shutil
import time
import urllib.error
import urllib.request
import zipfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from http.client import HTTPException
from importlib import resources
from pathlib import Path
from urllib.parse import quote, urlsplit

from rich.progress import Progress

from kinecast.errors import DownloadError, OptionError

TIMEOUT = 30.0  # [s] without a byte after which a connection counts as broken
ATTEMPTS = 5  # broken connections in a row without any progress before giving up
LARGEST_LISTING = 10_000_000  # bytes
MOST_FILES = 10_000
CHUNK = 1 << 16
FOLDER = "KINECAST_MODELS"  # environment variable that names another folder for models
CHECKSUM = re.compile(r"(md5:[0-9a-f]{32}|sha256:[0-9a-f]{64})\Z")

UNSAFE = re.compile(r'[\x00-\x1f\x7f\\:*?"<>|]')
"""Characters that no file is given: control characters, and what means something to a shell or to Windows."""


@dataclass(frozen=True)
class RemoteFile:
    """A file somewhere else: the relative path it is stored under, with `/`, and `sha256:…` or `md5:…` of its bytes."""

    name: str
    checksum: str
    size: int
    url: str = ""  # empty: its name, under the address of its set

    def is_at(self, path: Path) -> bool:
        """Whether there is a file of its checksum at a path."""
        if not path.is_file():
            return False
        kind, _, expected = self.checksum.partition(":")
        with path.open("rb") as file:
            return hashlib.file_digest(file, kind).hexdigest() == expected


@dataclass(frozen=True)
class PublicSet:
    """A set of recordings, or a model, on the net."""

    name: str
    about: str  # one line
    licence: str
    home: str  # page to read first: licence and how to cite
    url: str  # its files stand under it; of its record where there is no list of files
    files: tuple[RemoteFile, ...] | None  # None for a Zenodo record, which lists its own
    model: RemoteFile | None = None  # the network that is its file, or in it; None of recordings


def public_sets() -> dict[str, PublicSet]:
    """The sets `download` knows, by name."""
    sets = {}
    table = json.loads((resources.files("kinecast") / "data" / "downloads.json").read_text(encoding="utf-8"))
    for name, entry in table.items():
        files, model = entry.pop("files"), entry.pop("model", None)
        listed = files and tuple(RemoteFile(**file) for file in files)
        sets[name] = PublicSet(name, **entry, files=listed, model=model and RemoteFile(**model))
    return sets


def cache_folder() -> Path:
    """Where models are kept: $KINECAST_MODELS, else the system's place for what programs fetch."""
    if told := os.environ.get(FOLDER):
        return Path(told)
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "kinecast" / "models"


def cached_model(name: str) -> Path:
    """The file of a model that was downloaded before; an OptionError with the command where it was not."""
    models = {each.name: each.model for each in public_sets().values() if each.model}
    if name not in models:
        raise OptionError(f"no model {name!r}; there are {', '.join(models)}")
    path = cache_folder() / models[name].name
    if not path.is_file():
        raise OptionError(f"the model {name} is not there ({path}); fetch it once with: kinecast download {name}")
    return path


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
        The files, or of a model its file alone, taken out of its archive; each with the right checksum.

    Raises:
        OptionError: no such set.
        DownloadError: no http(s) address, no connection, a wrong checksum or name, or too little space. Files that are
            complete stay; an incomplete one never has its final name.
    """
    known, root = public_sets(), Path(folder)
    if name not in known:
        raise OptionError(f"no public set {name!r}; there are {', '.join(known)}")
    public = known[name]
    if public.model and public.model.is_at(root / public.model.name):
        return [root / public.model.name]
    address = url or public.url
    if not re.match("https?://[^/[]", address):
        raise DownloadError(f"{address[:200]}: only http and https addresses are downloaded")
    listed = _record(public, address) if public.files is None else public.files
    base = address.removesuffix("/") + "/"
    remotes = [
        replace(file, url=file.url or base + quote(file.name)) for file in listed if fnmatchcase(file.name, only)
    ]
    if not remotes:
        raise DownloadError(f"{name}: no file matches {only!r}")
    targets = [_target(root, remote.name) for remote in remotes]
    missing = sum(remote.size for remote, target in zip(remotes, targets, strict=True) if not target.exists())
    root.mkdir(parents=True, exist_ok=True)
    if missing > (free := shutil.disk_usage(root).free):
        raise DownloadError(f"{name}: {missing / 1e9:.2f} GB are missing, {root} has {free / 1e9:.2f} GB left")
    bar = Progress(disable=True) if progress is None else progress
    task = bar.add_task(name, total=sum(remote.size for remote in remotes))
    done = 0

    def advance(present: int) -> None:
        bar.update(task, completed=done + present)

    for remote, target in zip(remotes, targets, strict=True):
        _fetch(remote, target, advance, patience)
        done += remote.size
        advance(0)
    if public.model and public.model.name != targets[0].name:
        return [_unpacked(targets[0], root / public.model.name, public.model.size)]
    return targets


def _target(root: Path, name: str) -> Path:
    """The place of a file inside the folder; refuses a name that leads elsewhere, or that some system cannot store."""
    parts = name.split("/")
    bad = any(not part or part != part.strip(" .") or len(part) > 200 for part in parts)
    if bad or UNSAFE.search(name) or len(name) > 400:
        raise DownloadError(f"refusing the file name {name[:80]!r}: it is not a plain path inside the folder")
    target = root.joinpath(*parts)
    if not target.resolve().is_relative_to(root.resolve()):
        raise DownloadError(f"refusing the file name {name!r}: a link in {root} leads outside")
    return target


def _record(public: PublicSet, url: str) -> tuple[RemoteFile, ...]:
    """The files of a Zenodo record, with the checksums its API states."""
    try:
        with _open(url, {"Accept": "application/json"}) as response:
            content = response.read(LARGEST_LISTING + 1)
    except (OSError, HTTPException) as error:
        raise DownloadError(f"{public.name}: cannot read the list of files at {url}: {error}") from None
    if len(content) > LARGEST_LISTING:
        raise DownloadError(f"{public.name}: the list of files at {url} is larger than {LARGEST_LISTING} bytes")
    try:
        record = json.loads(content)
        access = record["metadata"].get("access_right", "open")
        remotes = tuple(
            RemoteFile(str(f["key"]), str(f["checksum"]), int(f["size"]), str(f["links"]["self"]))
            for f in record["files"]
        )
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


def _fetch(remote: RemoteFile, target: Path, advance: Callable[[int], None], patience: float) -> None:
    """One file: kept if whole, else gathered in a `.part` file also across runs, checked and moved into place."""
    # another version of the file waits under another name
    part = target.with_name(f"{target.name}.{remote.checksum.partition(':')[2][:8]}.part")
    failures = most = 0
    try:
        if remote.is_at(target):
            return
        target.parent.mkdir(parents=True, exist_ok=True)
        part.touch()
        while part.stat().st_size != remote.size:
            problem, present = _gather(remote, part, advance), part.stat().st_size
            failures, most = 1 if present > most else failures + 1, max(most, present)
            if present != remote.size and failures >= ATTEMPTS:
                kept = f"{present} of {remote.size} bytes are kept: the same command continues there."
                raise DownloadError(f"{remote.name}: {problem} ({remote.url}). {kept}")
            if present != remote.size:
                time.sleep(patience * 2 ** (failures - 1))
        if not remote.is_at(part):
            part.unlink()
            problem = f"is not the file it should be (its checksum differs from {remote.checksum})"
            raise DownloadError(f"{remote.name}: what {remote.url} sent {problem}; nothing of it is kept")
        part.replace(target)
    except DownloadError:
        raise
    except OSError as error:
        raise DownloadError(f"{remote.name}: cannot be stored in {target.parent}: {error}") from None
    finally:
        if part.exists() and not part.stat().st_size:
            part.unlink()


def _gather(remote: RemoteFile, part: Path, advance: Callable[[int], None]) -> str:
    """Appends what is missing, from the start if the server cannot resume; says what ended the connection."""
    have = part.stat().st_size if part.stat().st_size <= remote.size else 0
    try:
        with _open(remote.url, {"Range": f"bytes={have}-"} if have else {}) as response:
            resumed = response.status == 206 and response.headers.get("Content-Range", "").startswith(f"bytes {have}-")
            have = have if resumed else 0
            with part.open("ab" if resumed else "wb") as file:
                while have <= remote.size and (chunk := response.read(CHUNK)):
                    have += len(chunk)
                    file.write(chunk)
                    advance(have)
    except urllib.error.HTTPError as error:
        with error:
            if error.code == 416:  # what is there does not fit the file: start again
                part.write_bytes(b"")
            elif error.code < 500 and error.code != 429:
                answer = f"{error.code} {error.reason} for {remote.url}"
                raise DownloadError(f"{remote.name}: the server answers {answer}") from None
            return str(error.reason)
    except (OSError, HTTPException) as error:
        return str(getattr(error, "reason", None) or error) or type(error).__name__
    if have > remote.size:
        part.unlink()
        more = f"the server sends more than the file's {remote.size} bytes ({remote.url})"
        raise DownloadError(f"{remote.name}: {more}; nothing of it is kept")
    return "connection closed"


def _unpacked(archive: Path, path: Path, size: int) -> Path:
    """The path, once it is the one entry of its ending and size of a checked archive; the archive goes."""
    part = path.with_name(f"{path.name}.part")
    try:
        with zipfile.ZipFile(archive) as opened:
            entries = (each for each in opened.infolist() if each.filename.endswith(path.suffix))
            (entry,) = (each for each in entries if each.file_size == size)
            with opened.open(entry) as content, part.open("wb") as file:
                shutil.copyfileobj(content, file)
        part.replace(path)
        archive.unlink()
    except OSError as error:
        raise DownloadError(f"{path.name}: cannot be stored in {path.parent}: {error}") from None
    finally:
        part.unlink(missing_ok=True)
    return path


def _open(url: str, headers: dict[str, str]) -> http.client.HTTPResponse:
    """An open HTTP connection; errors as urllib raises them."""
    written_out = quote(url, safe="%/:?#[]@!$&'()*+,;=~")  # some listings leave blanks and umlauts as they are
    # no compression on the way: sizes, ranges and checksums are those of the file
    request = urllib.request.Request(written_out, headers={"Accept-Encoding": "identity", **headers})
    response: http.client.HTTPResponse = urllib.request.urlopen(request, timeout=TIMEOUT)
    return response
