"""The file behind the table format: rows of (stamp, person, joint), as parquet or csv, with metadata."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from io import BufferedWriter
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet
from jaxtyping import Float, Int

from kinecast.datasets.compressed import MOST_POINTS, head, read_bytes
from kinecast.errors import DatasetError, OptionError

__all__ = ["Rows", "Words", "is_table", "read_rows", "write_rows"]

_METADATA_KEY = b"kinecast"
_CSV_METADATA = b"# kinecast "
_POSITION = ("x", "y", "z")
_COVARIANCE = ("sxx", "sxy", "sxz", "syy", "syz", "szz")
_REQUIRED = ("stamp", "person", "joint", *_POSITION)
_WORDS = ("person", "joint", "label")
_PARQUET_MAGIC = b"PAR1"


@dataclass(frozen=True)
class Words:
    """A column of words, most of them repeated.

    Attributes:
        names: the different words.
        codes: (R,) place in `names` of each row's word; −1 where it is missing.
    """

    names: tuple[str, ...]
    codes: Int[np.ndarray, " R"]

    @classmethod
    def of(cls, words: Iterable[str | None]) -> Words:
        """The column of these words; None is missing."""
        places: dict[str, int] = {}
        codes = [-1 if word is None else places.setdefault(word, len(places)) for word in words]
        return cls(tuple(places), np.array(codes, dtype=np.int32))


@dataclass(frozen=True)
class Rows:
    """What a table holds, one row for each (stamp, person, joint).

    Attributes:
        stamp: (R,) [s].
        person: (R,) person ids.
        joint: (R,) joint names.
        position: (R, 3) [m], z up; NaN where missing.
        confidence: (R,) or None.
        covariance: (R, 6) xx, xy, xz, yy, yz, zz of the position [m²], or None.
        label: (R,) what the person is doing, or None.
        made: (R,) when a predicted row was predicted [s], or None for measured rows.
        metadata: rate, world frame, source and what else belongs to the whole; JSON values.
    """

    stamp: Float[np.ndarray, " R"]
    person: Words
    joint: Words
    position: Float[np.ndarray, "R 3"]
    confidence: Float[np.ndarray, " R"] | None = None
    covariance: Float[np.ndarray, "R 6"] | None = None
    label: Words | None = None
    made: Float[np.ndarray, " R"] | None = None
    metadata: dict[str, Any] | None = None


def is_table(path: Path) -> bool:
    """Whether a file is parquet, or csv with the table's metadata or column names."""
    start = head(path)
    columns = {name.strip().strip(b'"') for name in start.partition(b"\n")[0].split(b",")}
    return start.startswith((_PARQUET_MAGIC, _CSV_METADATA)) or {name.encode() for name in _REQUIRED} <= columns


def write_rows(path: Path, rows: Rows) -> None:
    """Write a table; the file appears whole or not at all.

    Args:
        path: ends in `.parquet` or `.csv`.
        rows: what to write.

    Raises:
        OptionError: the path has another ending.
        DatasetError: the file cannot be written.
    """
    columns: dict[str, Any] = {
        "stamp": rows.stamp,
        "person": _array(rows.person),
        "joint": _array(rows.joint),
    }
    columns |= {name: rows.position[:, place] for place, name in enumerate(_POSITION)}
    if rows.confidence is not None:
        columns["confidence"] = rows.confidence
    if rows.covariance is not None:
        columns |= {name: rows.covariance[:, place] for place, name in enumerate(_COVARIANCE)}
    if rows.label is not None:
        columns["label"] = _array(rows.label)
    if rows.made is not None:
        columns["made"] = rows.made
    table = pa.table(columns)
    metadata = json.dumps(rows.metadata or {}, allow_nan=False).encode()
    if path.suffix == ".parquet":
        with _whole(path) as file:
            pa.parquet.write_table(table.replace_schema_metadata({_METADATA_KEY: metadata}), file, compression="zstd")
    elif path.suffix == ".csv":
        with _whole(path) as file:
            file.write(_CSV_METADATA + metadata + b"\n")
            pa.csv.write_csv(_plain_words(table), file)
    else:
        raise OptionError(f"a table is written as .parquet or .csv, not {path.name!r}")


def read_rows(path: Path) -> Rows:
    """Read a table.

    Raises:
        DatasetError: the file is no table, lacks a column, holds another type in one, or has too many rows.
    """
    try:
        table = _parquet(path) if head(path).startswith(_PARQUET_MAGIC) else _csv(path)
        table.validate(full=True)  # a damaged file may hold codes of words that are not there
        return _rows(table, path)
    except (pa.ArrowException, OSError, UnicodeDecodeError) as error:
        line = re.search(r"Row #(\d+): (.*)", str(error))  # as the csv reader says it
        where, problem = (f"{path}, line {line[1]}", line[2]) if line else (path, str(error))
        raise DatasetError(where, f"damaged table: {problem}") from error


def _parquet(path: Path) -> pa.Table:
    file = pa.parquet.ParquetFile(pa.BufferReader(read_bytes(path)))
    if file.metadata.num_rows > MOST_POINTS:
        raise DatasetError(path, f"{file.metadata.num_rows} rows, at most {MOST_POINTS} are allowed")
    known = (*_REQUIRED, "confidence", *_COVARIANCE, "label", "made")
    return file.read(columns=[name for name in known if name in file.schema_arrow.names])


def _csv(path: Path) -> pa.Table:
    text = read_bytes(path).removeprefix(b"\xef\xbb\xbf")
    described = text.startswith(_CSV_METADATA)
    numbers = ("stamp", *_POSITION, "confidence", *_COVARIANCE, "made")
    types = dict.fromkeys(numbers, pa.float64()) | dict.fromkeys(_WORDS, pa.dictionary(pa.int32(), pa.string()))
    table = pa.csv.read_csv(
        pa.BufferReader(text),
        # One thread, so that errors name the row.
        read_options=pa.csv.ReadOptions(skip_rows=int(described), use_threads=False),
        parse_options=pa.csv.ParseOptions(newlines_in_values=True),
        convert_options=pa.csv.ConvertOptions(
            column_types=types, null_values=[""], strings_can_be_null=True, quoted_strings_can_be_null=False
        ),
    )
    if not described:
        return table
    metadata = text.partition(b"\n")[0].removeprefix(_CSV_METADATA)
    return table.replace_schema_metadata({_METADATA_KEY: metadata})


def _rows(table: pa.Table, path: Path) -> Rows:
    """The table's columns as arrays, after a check that each is there once."""
    missing = [name for name in _REQUIRED if name not in table.column_names]
    if missing:
        raise DatasetError(path, f"no column {', '.join(missing)}; a table has {', '.join(_REQUIRED)}")
    repeated = {name for name in table.column_names if table.column_names.count(name) > 1}
    if repeated:
        raise DatasetError(path, f"two columns {min(repeated)!r}")
    if table.num_rows > MOST_POINTS:
        raise DatasetError(path, f"{table.num_rows} rows, at most {MOST_POINTS} are allowed")
    names = set(table.column_names)
    return Rows(
        stamp=_numbers(table, ("stamp",))[:, 0],
        person=_words(table.column("person")),
        joint=_words(table.column("joint")),
        position=_numbers(table, _POSITION),
        confidence=_numbers(table, ("confidence",))[:, 0] if "confidence" in names else None,
        covariance=_numbers(table, _COVARIANCE) if names.issuperset(_COVARIANCE) else None,
        label=_words(table.column("label")) if "label" in names else None,
        made=_numbers(table, ("made",))[:, 0] if "made" in names else None,
        metadata=_metadata(table, path),
    )


def _numbers(table: pa.Table, names: tuple[str, ...]) -> Float[np.ndarray, "R C"]:
    columns = [table.column(name).cast(pa.float64()).to_numpy() for name in names]
    return np.stack(columns, axis=-1)


def _words(column: pa.ChunkedArray) -> Words:
    """A column of strings, plain or encoded, or of numbers that stand for names."""
    words = column if pa.types.is_dictionary(column.type) else column.cast(pa.string()).dictionary_encode()
    words = words.unify_dictionaries().combine_chunks()
    if isinstance(words, pa.ChunkedArray):  # of no rows
        return Words((), np.empty(0, dtype=np.int32))
    return Words(tuple(words.dictionary.to_pylist()), words.indices.fill_null(-1).to_numpy().astype(np.int32))


def _array(words: Words) -> pa.DictionaryArray:
    missing = words.codes < 0
    return pa.DictionaryArray.from_arrays(pa.array(words.codes, mask=missing), pa.array(words.names, type=pa.string()))


def _plain_words(table: pa.Table) -> pa.Table:
    """The table with words in full, as csv needs them."""
    for name in (name for name in table.column_names if name in _WORDS):
        table = table.set_column(table.column_names.index(name), name, table.column(name).cast(pa.string()))
    return table


def _metadata(table: pa.Table, path: Path) -> dict[str, Any] | None:
    text = (table.schema.metadata or {}).get(_METADATA_KEY)
    if text is None:
        return None
    try:
        metadata = json.loads(text)
    except ValueError as error:
        raise DatasetError(path, f"metadata is not JSON: {error}") from error
    if not isinstance(metadata, dict):
        raise DatasetError(path, "metadata is not a JSON object")
    return metadata


@contextmanager
def _whole(path: Path) -> Iterator[BufferedWriter]:
    """A new file beside `path` that takes its place when all is written, and goes when it is not."""
    partial = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        with partial.open("wb") as file:
            yield file
        partial.replace(path)
    except OSError as error:
        raise DatasetError(path, f"cannot be written: {error}") from error
    finally:
        partial.unlink(missing_ok=True)
