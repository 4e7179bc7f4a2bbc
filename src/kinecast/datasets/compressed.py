"""Files read through their compression: plain, gzip or xz, told apart by content, in bounded memory."""

from __future__ import annotations

import gzip
import lzma
import sys
import zlib
from collections.abc import Iterator
from io import BufferedReader
from pathlib import Path

from kinecast.errors import DatasetError

__all__ = ["MOST_POINTS", "STREAM_LIMIT", "WHOLE_LIMIT", "base_name", "chunks", "head", "read_bytes"]

STREAM_LIMIT = 2 << 30
"""Largest decompressed size [bytes] of a file read in pieces."""

WHOLE_LIMIT = 256 << 20
"""Largest decompressed size [bytes] of a file held in memory: over an hour of nine Vicon bodies at 100 Hz."""

MOST_POINTS = 20_000_000
"""Most joint positions held of one file: an hour of 23 joints at 240 Hz."""

_GZIP_MAGIC = b"\x1f\x8b"
_XZ_MAGIC = b"\xfd7zXZ\x00"
_SUFFIXES = (".gz", ".xz")


def chunks(path: Path, limit: int = STREAM_LIMIT, size: int = 1 << 20) -> Iterator[bytes]:
    """The decompressed content of a file, piece by piece.

    Args:
        path: a plain, gzip or xz file.
        limit: decompressed bytes beyond which the file is refused.
        size: largest piece [bytes].

    Yields:
        Pieces of at most `size` bytes; at least one.

    Raises:
        DatasetError: the file is empty, unreadable, truncated, damaged or larger than `limit`.
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
    """The file opened through the compression its first bytes tell."""
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
    return next(chunks(path, limit=sys.maxsize, size=size)).removeprefix(b"\xef\xbb\xbf")


def base_name(path: Path) -> str:
    """File name without compression and format endings: `trial1` for `trial1.txt.gz`."""
    name = path.name.removesuffix(path.suffix) if path.suffix in _SUFFIXES else path.name
    return name.rpartition(".")[0] or name
