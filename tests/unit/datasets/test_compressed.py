"""Compressed files: read as they are, bounded, and refused when they are broken."""

from __future__ import annotations

import gzip
import itertools
import lzma
from pathlib import Path

import pytest

from kinecast.datasets.compressed import base_name, chunks, head, read_bytes
from kinecast.errors import DatasetError

CONTENT = b"some text\n" * 50_000


def written(path: Path, content: bytes) -> Path:
    path.write_bytes(content)
    return path


@pytest.mark.parametrize(
    ("name", "pack"),
    [("a.txt", bytes), ("a.txt.gz", gzip.compress), ("a.txt.xz", lzma.compress), ("a", lzma.compress)],
)
def test_content_is_the_same_through_any_compression(tmp_path: Path, name: str, pack: type) -> None:
    path = written(tmp_path / name, pack(CONTENT))
    assert read_bytes(path) == CONTENT
    assert head(path, 12) == CONTENT[:12]
    assert max(map(len, chunks(path, size=1000))) <= 1000


def test_head_passes_over_a_byte_order_mark(tmp_path: Path) -> None:
    assert head(written(tmp_path / "a.csv", b"\xef\xbb\xbfObjects\n")) == b"Objects\n"


@pytest.mark.parametrize(("name", "pack"), [("a.gz", gzip.compress), ("a.xz", lzma.compress)])
def test_truncated_and_damaged_files_are_refused(tmp_path: Path, name: str, pack: type) -> None:
    packed = pack(CONTENT)
    with pytest.raises(DatasetError, match=rf"{name}: truncated or damaged"):
        read_bytes(written(tmp_path / name, packed[:-20]))
    middle = len(packed) // 2
    with pytest.raises(DatasetError, match="truncated or damaged"):
        read_bytes(written(tmp_path / name, packed[:middle] + b"\x00\xff\x00\xff" + packed[middle + 4 :]))


@pytest.mark.parametrize(
    ("name", "content"), [("a.csv", b""), ("a.gz", gzip.compress(b"", mtime=0)), ("a.xz", lzma.compress(b""))]
)
def test_empty_files_are_refused(tmp_path: Path, name: str, content: bytes) -> None:
    with pytest.raises(DatasetError, match=f"{name}: empty file"):
        read_bytes(written(tmp_path / name, content))


def test_a_name_that_promises_compression_must_keep_it(tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match=r"named \.xz but not xz data"):
        read_bytes(written(tmp_path / "a.csv.xz", b"Objects\n"))


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match=r"none\.csv: cannot be read"):
        read_bytes(tmp_path / "none.csv")


def test_a_bomb_stops_at_the_limit(tmp_path: Path) -> None:
    path = written(tmp_path / "bomb.xz", lzma.compress(bytes(64 << 20), preset=1))
    assert path.stat().st_size < 1 << 20
    sizes = map(len, chunks(path, limit=8 << 20))
    assert sum(itertools.islice(sizes, 8)) == 8 << 20
    with pytest.raises(DatasetError, match="larger than the limit of 8 MiB"):
        next(sizes)


def test_a_two_gigabyte_file_is_refused_unread(tmp_path: Path) -> None:
    path = tmp_path / "huge.csv"
    with path.open("wb") as file:
        file.truncate(2_000_000_000)  # sparse: no disk is used
    with pytest.raises(DatasetError, match="larger than the limit of 256 MiB"):
        read_bytes(path)


@pytest.mark.parametrize(
    ("name", "base"),
    [("0.csv.xz", "0"), ("trial1.txt.gz", "trial1"), ("a.b.mvnx", "a.b"), ("plain", "plain"), ("x.npy", "x")],
)
def test_base_name(name: str, base: str) -> None:
    assert base_name(Path("folder") / name) == base
