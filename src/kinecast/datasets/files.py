"""Files of recordings: read through their compression in bounded memory, and the numbers in their lines."""

from __future__ import annotations

import gzip
import lzma
import math
import sys
import zlib
from array import array
from collections.abc import Iterator, Sequence
from io import BufferedReader
from pathlib import Path

import numpy as np
from jaxtyping import Float

from kinecast.errors import DatasetError

STREAM_LIMIT = 2 << 30  # largest decompressed size [bytes] of a file read in pieces
WHOLE_LIMIT = 256 << 20
"""Largest decompressed size [bytes] of a file held in memory: over an hour of nine Vicon bodies at 100 Hz."""

MOST_POINTS = 20_000_000  # most joint positions held of one file: an hour of 23 joints at 240 Hz
BYTE_ORDER_MARK = b"\xef\xbb\xbf"

_GZIP_MAGIC = b"\x1f\x8b"
_XZ_MAGIC = b"\xfd7zXZ\x00"
_SUFFIXES = (".gz", ".xz")
_MISSING = ("", "nan", "NaN", "NAN")


def chunks(path: Path, limit: int = STREAM_LIMIT, size: int = 1 << 20) -> Iterator[bytes]:
    """The decompressed content of a plain, gzip or xz file, told apart by content, in pieces of at most `size` bytes.

    Raises:
        DatasetError: the file is empty, unreadable, truncated, damaged or larger than `limit` bytes.
    """
    too_large = f"larger than the limit of {limit >> 20} MiB"
    total = 0
    try:
        if path.stat().st_size > limit:
            raise DatasetError(path, too_large)
        with _open(path) as stream:
            while piece := stream.read(size):
                total += len(piece)
                if total > limit:
                    raise DatasetError(path, too_large)
                yield piece
    except (EOFError, zlib.error, lzma.LZMAError, gzip.BadGzipFile) as error:
        raise DatasetError(path, f"truncated or damaged compressed file: {error}") from error
    except (OSError, MemoryError) as error:
        raise DatasetError(path, f"cannot be read: {error}") from error
    if total == 0:
        raise DatasetError(path, "empty file")


def _open(path: Path) -> gzip.GzipFile | lzma.LZMAFile | BufferedReader:
    with path.open("rb") as file:
        magic = file.read(len(_XZ_MAGIC))
    if magic.startswith(_GZIP_MAGIC):
        return gzip.open(path, "rb")
    if magic == _XZ_MAGIC:
        return lzma.open(path, "rb")
    if magic and path.suffix in _SUFFIXES:
        raise DatasetError(path, f"named {path.suffix} but not {path.suffix[1:]} data")
    return path.open("rb")


def read_bytes(path: Path, limit: int = WHOLE_LIMIT) -> bytes:
    """The whole decompressed content of a file; raises as `chunks`."""
    return b"".join(chunks(path, limit))


def head(path: Path, size: int = 4096) -> bytes:
    """The first decompressed bytes of a file, without a byte-order mark; raises as `chunks`."""
    return next(chunks(path, limit=sys.maxsize, size=size)).removeprefix(BYTE_ORDER_MARK)


def base_name(path: Path) -> str:
    """File name without compression and format endings: `trial1` for `trial1.txt.gz`."""
    name = path.name.removesuffix(path.suffix) if path.suffix in _SUFFIXES else path.name
    return name.rpartition(".")[0] or name


def split_lines(text: bytes, count: int, path: Path) -> tuple[list[str], bytes]:
    """The first `count` lines as text, stripped and without a byte-order mark, and the bytes after them.

    Raises:
        DatasetError: there are fewer lines, or they are not UTF-8.
    """
    *first, rest = text.removeprefix(BYTE_ORDER_MARK).split(b"\n", count)
    if len(first) < count:
        found = len(first) + bool(rest)
        raise DatasetError(path, f"ends after line {found}; expected {count} header lines and then data")
    try:
        return [line.decode("utf-8").strip() for line in first], rest
    except UnicodeDecodeError as error:
        raise DatasetError(path, f"header is not UTF-8 text: {error}") from error


def number(text: str, where: object, what: str, infinite: bool = False) -> float:
    """One number; `where` (file and line) and `what` it is are for the message.

    Raises:
        DatasetError: the text is no number, or an infinite one where that is not allowed.
    """
    try:
        value = math.nan if "_" in text else float(text)  # Python reads 1_000
    except ValueError:
        value = math.nan
    if math.isnan(value) or (math.isinf(value) and not infinite):
        raise DatasetError(where, f"{what} is {text[:40]!r}, expected a number")
    return value


def numbers(cells: Sequence[str], names: Sequence[str], path: Path, line: int, infinite: bool = False) -> list[float]:
    """The cells of a line as numbers, NaN where one is empty or says nan; `names` of the columns are for the message.

    Raises:
        DatasetError: as `number`.
    """
    try:
        values = list(map(float, cells))
        if (infinite or math.isfinite(sum(values))) and "_" not in "".join(cells):
            return values
    except ValueError:
        pass
    return [
        math.nan if cell.strip() in _MISSING else number(cell, f"{path}, line {line}", name, infinite)
        for cell, name in zip(cells, names, strict=True)
    ]


def rows(
    text: bytes, columns: int, path: Path, *,
    delimiter: str | None = ",", first_line: int = 1, use: Sequence[int] | None = None,
) -> Float[np.ndarray, "N C"]:  # fmt: skip
    """(N, C) numbers of lines, NaN where a cell is empty or says nan; blank lines are passed over.

    A line has `columns` cells, a `delimiter` (None for any white space) between them; `use` are the places of the C
    cells to read, in this order, None for all. `text` starts on `first_line` of the file, for the message.

    Raises:
        DatasetError: no rows, a wrong column count, or a cell that is no number; names line and column.
    """
    values = array("d")
    names = [f"column {place + 1}" for place in (range(columns) if use is None else use)]
    for line, content in enumerate(text.decode("utf-8-sig", errors="replace").split("\n"), first_line):
        if not content or content.isspace():
            continue
        cells = content.split(delimiter)
        if len(cells) != columns:
            raise DatasetError(f"{path}, line {line}", f"{len(cells)} columns, expected {columns}")
        values.extend(numbers(cells if use is None else [cells[place] for place in use], names, path, line))
    if not values:
        raise DatasetError(path, f"no data from line {first_line} on")
    return np.array(values).reshape(-1, len(names))
