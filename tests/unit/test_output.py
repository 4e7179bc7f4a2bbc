"""Files are written whole or not at all."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from kinecast.output import DRAFTS, draft, write_atomically


def test_writes_replaces_and_leaves_nothing_else(tmp_path: Path) -> None:
    path = tmp_path / "new" / "folder" / "file.bin"
    write_atomically(path, b"old")
    write_atomically(path, b"new")
    assert path.read_bytes() == b"new"
    assert os.listdir(path.parent) == ["file.bin"]


def test_a_failure_keeps_the_old_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "file.bin"
    write_atomically(path, b"old")

    def fail(*_: object) -> None:
        raise OSError("disk full")

    monkeypatch.setattr(Path, "replace", fail)
    with pytest.raises(OSError, match="disk full"):
        write_atomically(path, b"new")
    assert path.read_bytes() == b"old"
    assert os.listdir(tmp_path) == ["file.bin"]


def test_whatever_writes_a_draft_says_so(tmp_path: Path) -> None:
    """A process that ends at once looks there first (kinecast.cli)."""
    with draft(tmp_path, "model.npz") as folder:
        assert {folder} == DRAFTS
        assert folder.parent == tmp_path
        (folder / "part").write_bytes(b"half")
    assert not DRAFTS
    assert list(tmp_path.iterdir()) == []
