"""Files: read through their compression, bounded; numbers in their lines, and messages that name the place."""

from __future__ import annotations

import gzip
import itertools
import lzma
from pathlib import Path

import numpy as np
import pytest

from kinecast.datasets.files import base_name, chunks, head, number, read_bytes, rows, split_lines
from kinecast.errors import DatasetError

CONTENT = b"some text\n" * 50_000


def written(path: Path, content: bytes) -> Path:
    path.write_bytes(content)
    return path


@pytest.mark.parametrize(
    ("name", "pack"), [("a.txt", bytes), ("a.txt.gz", gzip.compress), ("a.txt.xz", lzma.compress), ("a", lzma.compress)]
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


FILE = Path("a.csv")


def test_values_are_read_to_the_last_bit() -> None:
    values = np.random.default_rng(0).normal(size=(50, 4)) * 10.0 ** np.arange(-9, 11, 6)
    text = "\n".join(",".join(repr(float(x)) for x in row) for row in values).encode()
    np.testing.assert_array_equal(rows(text, 4, FILE), values)


def test_empty_cells_and_nan_are_missing_and_blank_lines_are_passed_over() -> None:
    table = rows(b"1,,3\r\n\r\nnan,5,NaN\r\n", 3, FILE)
    np.testing.assert_array_equal(table, [[1, np.nan, 3], [np.nan, 5, np.nan]])


def test_any_white_space_is_a_delimiter() -> None:
    np.testing.assert_array_equal(rows(b"  1 \t 2\r\n3  4 \n", 2, FILE, delimiter=None), [[1, 2], [3, 4]])


def test_only_the_cells_asked_for_are_read_in_the_order_asked() -> None:
    np.testing.assert_array_equal(rows(b"1,a,3\n4,b,6\n", 3, FILE, use=[2, 0]), [[3, 1], [6, 4]])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (b"1,2,3\n4,5\n", r"a\.csv, line 8: 2 columns, expected 3"),
        (b"1,2,3\n4,5,6,7\n", r"a\.csv, line 8: 4 columns, expected 3"),
        (b"1,2,3\n\n4,five,6\n", r"a\.csv, line 9: column 2 is 'five', expected a number"),
        (b"1,2,3\n1_0,5,6\n", r"a\.csv, line 8: column 1 is '1_0', expected a number"),
        (b"1,2,3\n4,5,inf\n", r"a\.csv, line 8: column 3 is 'inf', expected a number"),
        (b"1,2,3\n4,5,\xff\n", r"a\.csv, line 8: column 3 is '.', expected a number"),
        (b"\n \n", r"a\.csv: no data from line 7 on"),
    ],
)
def test_what_is_wrong_is_named_with_its_line(text: bytes, message: str) -> None:
    with pytest.raises(DatasetError, match=message):
        rows(text, 3, FILE, first_line=7)


def test_split_lines() -> None:
    assert split_lines(b"\xef\xbb\xbfa\r\nb\nrest\nof it", 2, FILE) == (["a", "b"], b"rest\nof it")
    with pytest.raises(DatasetError, match=r"ends after line 1; expected 2 header lines"):
        split_lines(b"only", 2, FILE)
    with pytest.raises(DatasetError, match="not UTF-8"):
        split_lines(b"\xff\xfe\n", 1, FILE)


@pytest.mark.parametrize("text", ["", "fast", "nan", "inf"])
def test_number_refuses_what_is_not_finite(text: str) -> None:
    with pytest.raises(DatasetError, match=rf"a\.csv, line 2: rate is '{text}', expected a number"):
        number(text, "a.csv, line 2", "rate")
