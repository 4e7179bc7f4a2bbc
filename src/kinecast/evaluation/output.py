"""Result files: written whole or not at all."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

__all__ = ["BEING_WRITTEN", "all_or_none", "write_atomically"]

BEING_WRITTEN: list[Path] = []
"""Files and folders of which a draft lies on the disk: a process that ends at once would leave it there."""


@contextmanager
def _being_written(path: Path) -> Iterator[None]:
    BEING_WRITTEN.append(path)
    try:
        yield
    finally:
        BEING_WRITTEN.remove(path)


def write_atomically(path: Path, content: bytes) -> None:
    """Write a file so that a reader sees the old one or all of the new one, also after a crash.

    Args:
        path: of the file; its folder is made where missing.
        content: all of it.

    Raises:
        OSError: it cannot be written; nothing is left behind.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    with _being_written(path):
        handle, partial = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.", suffix=".part")
        try:
            with os.fdopen(handle, "wb") as file:
                file.write(content)
            os.chmod(partial, 0o644)  # mkstemp's is for its owner alone
            os.replace(partial, path)
        except BaseException:
            Path(partial).unlink(missing_ok=True)
            raise


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
    with _being_written(folder):
        draft = Path(tempfile.mkdtemp(dir=near, prefix=f".{folder.name}."))
        try:
            yield draft
            folder.mkdir(parents=True, exist_ok=True)
            for file in sorted(draft.iterdir()):
                file.replace(folder / file.name)
        finally:
            shutil.rmtree(draft, ignore_errors=True)
