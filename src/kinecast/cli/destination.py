"""Where results go: refused before the work starts, not after it."""

from __future__ import annotations

import os
from pathlib import Path

from kinecast.errors import OptionError

__all__ = ["check_file", "check_folder"]


def check_file(out: Path, endings: tuple[str, ...]) -> None:
    """Check that a file can be written.

    Args:
        out: the file; one that is there will be replaced.
        endings: of its name, any of them.

    Raises:
        OptionError: it has another ending, is a folder, or its folder is missing or not writable.
    """
    if out.suffix not in endings:
        raise OptionError(f"--out {out}: its name must end in {' or '.join(endings)}")
    if out.is_dir():
        raise OptionError(f"--out {out}: is a folder")
    folder = out.absolute().parent
    if not folder.is_dir():
        raise OptionError(f"--out {out}: there is no folder {folder}")
    _check_writable(out, folder)


def check_folder(out: Path) -> None:
    """Check that a folder is there or can be made, and files in it.

    Raises:
        OptionError: it is a file, or lies where nothing can be written.
    """
    place = out.absolute()
    while not place.exists() and place != place.parent:
        place = place.parent
    if not place.is_dir():
        raise OptionError(f"--out {out}: {place} is a file, not a folder")
    _check_writable(out, place)


def _check_writable(out: Path, folder: Path) -> None:
    if not os.access(folder, os.W_OK | os.X_OK):
        raise OptionError(f"--out {out}: the folder {folder} is not writable")
