"""Where results go: refused before the work starts, not after it."""

from __future__ import annotations

import tempfile
from pathlib import Path

from kinecast.errors import OptionError


def check_file(out: Path, endings: tuple[str, ...], option: str = "--out") -> None:
    """Check that a file can be written.

    Args:
        out: the file; one that is there will be replaced.
        endings: of its name, any of them.
        option: that it was given with, for the message.

    Raises:
        OptionError: it has another ending, is a folder, or its folder is missing or not writable.
    """
    if out.suffix not in endings:
        raise OptionError(f"{option} {out}: its name must end in {' or '.join(endings)}")
    if out.is_dir():
        raise OptionError(f"{option} {out}: is a folder, and folders are never replaced: remove it, or name another")
    folder = out.absolute().parent
    if not folder.is_dir():
        raise OptionError(f"{option} {out}: there is no folder {folder}")
    _check_writable(out, folder, option)


def check_folder(out: Path) -> None:
    """Check that a folder is there or can be made, and files in it.

    Raises:
        OptionError: it is a file, or lies where nothing can be written.
    """
    place = next(place for place in (out.absolute(), *out.absolute().parents) if place.exists())
    if not place.is_dir():
        raise OptionError(f"--out {out}: {place} is a file, not a folder")
    _check_writable(out, place, "--out")


def _check_writable(out: Path, folder: Path, option: str) -> None:
    try:
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise OptionError(f"{option} {out}: nothing can be written in {folder} ({error.strerror})") from None
