"""Tables as parquet files: the part of kinecast.datasets.table that needs the extra."""

from __future__ import annotations

from collections.abc import Mapping
from io import BufferedWriter
from pathlib import Path
from typing import Any

import numpy as np

from kinecast.datasets.files import read_bytes
from kinecast.datasets.table import NUMBERS, WORDS, Words, require_columns, require_few
from kinecast.errors import DatasetError, MissingExtraError

try:
    import pyarrow as pa
    import pyarrow.parquet
except ModuleNotFoundError as error:
    raise MissingExtraError("parquet", "parquet") from error

METADATA = b"kinecast"


def write(file: BufferedWriter, columns: Mapping[str, Any], metadata: bytes) -> None:
    """Write columns of numbers and `Words`."""

    def encoded(words: Words) -> pa.DictionaryArray:
        codes = pa.array(words.codes, mask=words.codes < 0)
        return pa.DictionaryArray.from_arrays(codes, pa.array(words.names, type=pa.string()))

    table = pa.table({name: encoded(each) if isinstance(each, Words) else each for name, each in columns.items()})
    pa.parquet.write_table(table.replace_schema_metadata({METADATA: metadata}), file, compression="zstd")


def read(path: Path) -> tuple[dict[str, Any], bytes | None]:
    """The known columns by name, and the metadata.

    Raises:
        DatasetError: damaged, a column missing or of another type, or too many rows.
    """
    try:
        file = pa.parquet.ParquetFile(pa.BufferReader(read_bytes(path)))
        require_few(file.metadata.num_rows, path)
        require_columns(file.schema_arrow.names, path)
        table = file.read(columns=[name for name in (*NUMBERS, *WORDS) if name in file.schema_arrow.names])
        table.validate(full=True)  # a damaged file may hold codes of words that are not there
        columns: dict[str, Any] = {}
        for name in table.column_names:
            column = table.column(name)
            columns[name] = _words(column) if name in WORDS else column.cast(pa.float64()).to_numpy()
    except (pa.ArrowException, OSError, UnicodeDecodeError) as error:
        raise DatasetError(path, f"damaged table: {error}") from error
    return columns, (table.schema.metadata or {}).get(METADATA)


def _words(column: pa.ChunkedArray) -> Words:
    """A column of strings, plain or encoded, or of numbers that stand for names."""
    words = column if pa.types.is_dictionary(column.type) else column.cast(pa.string()).dictionary_encode()
    words = words.unify_dictionaries().combine_chunks()
    if isinstance(words, pa.ChunkedArray):  # of no rows
        return Words((), np.empty(0, dtype=np.int32))
    return Words(tuple(words.dictionary.to_pylist()), words.indices.fill_null(-1).to_numpy().astype(np.int32))
