"""Result files: written whole or not at all."""

from __future__ import annotations

import secrets
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

DRAFTS: set[Path] = set()
"""What a process that ends at once has to remove (kinecast.cli)."""


def write_atomically(path: Path, content: bytes) -> None:
    """Write a file so that a reader sees the old one or all of the new one, also after a crash.

    Args:
        path: of the file; its folder is made where missing.
        content: all of it.

    Raises:
        OSError: it cannot be written; nothing is left behind.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    with draft(path.parent, path.name) as folder:
        part = folder / "part"
        part.write_bytes(content)
        part.replace(path)


@contextmanager
def all_or_none(folder: Path) -> Iterator[Path]:
    """A place for files that go to a folder together, once all are there; if one fails, none does.

    Args:
        folder: where the files go; made where missing, and only then.

    Yields:
        A folder to write them in.

    Raises:
        OSError: the folder cannot be written.
    """
    near = next(place for place in (folder.absolute(), *folder.absolute().parents) if place.is_dir())
    with draft(near, folder.name) as part:
        yield part
        folder.mkdir(parents=True, exist_ok=True)
        for file in sorted(part.iterdir()):
            file.replace(folder / file.name)


@contextmanager
def draft(near: Path, name: str) -> Iterator[Path]:
    """A folder in another, beside what is to be there under a name once it is whole; it goes whatever happens."""
    folder = near / f".{name}.{secrets.token_hex(4)}"
    DRAFTS.add(folder)
    try:
        folder.mkdir(mode=0o700)
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)
        DRAFTS.discard(folder)
