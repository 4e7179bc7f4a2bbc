"""Pose models by name: official files, downloaded when told to, checked, and kept in one folder."""

from __future__ import annotations

import os
import shutil
import sys
import zipfile
import zlib
from pathlib import Path

from rich.progress import Progress

from kinecast.datasets.remote_file import PublicSet, RemoteFile, download, public_sets
from kinecast.errors import DownloadError, OptionError

FOLDER = "KINECAST_MODELS"
"""Environment variable that names another folder."""


def cache_folder() -> Path:
    """Where models are kept: $KINECAST_MODELS, else the system's place for what programs fetch."""
    if told := os.environ.get(FOLDER):
        return Path(told)
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA", Path.home() / "AppData" / "Local")) / "kinecast" / "models"
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches" / "kinecast" / "models"
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "kinecast" / "models"


def cached_model(name: str) -> Path:
    """The file of a model that was downloaded before; an OptionError with the command where it was not."""
    path = cache_folder() / _model(name)[1].name
    if not path.is_file():
        raise OptionError(f"the model {name} is not there ({path}); fetch it once with: kinecast download {name}")
    return path


def fetch_model(
    name: str, folder: Path, progress: Progress | None = None, url: str | None = None, patience: float = 1.0
) -> Path:
    """Downloads a model, and takes it out of its archive; one that is there and whole is kept.

    Args:
        name: one of `public_sets()` with a model.
        folder: where it goes; nothing is written outside it.
        progress, url, patience: as in `kinecast.datasets.remote_file.download`.

    Returns:
        The model's file, with the right checksum.

    Raises:
        OptionError: no such model.
        DownloadError: see `download`; or the archive does not hold the model. Nothing half-written has its name.
    """
    public, model = _model(name)
    path = folder / model.name
    if path.is_file() and model.is_at(path):
        return path
    (archive,) = download(name, folder, progress, url=url, patience=patience)
    if archive == path:
        return path
    part = path.with_name(f"{path.name}.part")
    try:
        _unpack(archive, part, model)
        part.replace(path)
    except (OSError, zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError) as error:
        raise DownloadError(f"{archive.name}: {error} ({public.home})") from None
    finally:
        part.unlink(missing_ok=True)
    archive.unlink()
    return path


def _unpack(archive: Path, part: Path, model: RemoteFile) -> None:
    """Writes the one entry of an archive whose size and ending are the model's; an OSError where it is another."""
    with zipfile.ZipFile(archive) as opened:
        ending = Path(model.name).suffix
        found = [each for each in opened.infolist() if each.filename.endswith(ending) and each.file_size == model.size]
        if len(found) != 1:
            raise DownloadError(f"holds {len(found)} files *{ending} of {model.size} bytes, expected one")
        with opened.open(found[0]) as content, part.open("wb") as file:
            shutil.copyfileobj(content, file)
    if not model.is_at(part):
        raise DownloadError(f"what it holds is not {model.name}: its checksum differs from {model.checksum}")


def _model(name: str) -> tuple[PublicSet, RemoteFile]:
    """A public model, and its own file, which may come in an archive."""
    known = {each.name: (each, each.model) for each in public_sets().values() if each.model}
    if name not in known:
        raise OptionError(f"no model {name!r}; there are {', '.join(known)}")
    return known[name]
