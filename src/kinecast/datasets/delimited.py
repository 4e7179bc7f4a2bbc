"""Numbers read from delimited text: fast where all is well, naming line and column where not."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv
from jaxtyping import Float

from kinecast.errors import DatasetError

__all__ = ["number", "rows", "split_lines"]

_MISSING = ["", "nan", "NaN", "NAN"]


def split_lines(text: bytes, count: int, where: Path) -> tuple[list[str], bytes]:
    """The first `count` lines as text, stripped and without a byte-order mark, and the bytes after them.

    Raises:
        DatasetError: there are fewer lines, or they are not UTF-8.
    """
    *first, rest = text.removeprefix(b"\xef\xbb\xbf").split(b"\n", count)
    if len(first) < count:
        raise DatasetError(
            where, f"ends after line {len(first) + bool(rest)}; expected {count} header lines and then data"
        )
    try:
        return [line.decode("utf-8").strip() for line in first], rest
    except UnicodeDecodeError as error:
        raise DatasetError(where, f"header is not UTF-8 text: {error}") from error


def number(text: str, where: object, what: str) -> float:
    """One finite number.

    Args:
        text: the number's text.
        where: file and line, for the message.
        what: what the number is, for the message.

    Raises:
        DatasetError: the text is no finite number.
    """
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    if not np.isfinite(value):
        raise DatasetError(where, f"{what} is {text[:40]!r}, expected a number")
    return value


def rows(
    text: bytes,
    columns: int,
    where: Path,
    *,
    delimiter: str | None = ",",
    first_line: int = 1,
    use: Sequence[int] | None = None,
) -> Float[np.ndarray, "N C"]:
    """Rows of numbers.

    Args:
        text: lines of `columns` cells each; blank lines are passed over.
        columns: cells in a line.
        where: file for the message.
        delimiter: one character between numbers; None for any white space.
        first_line: line of the file on which `text` starts, for the message.
        use: places of the cells to read, in this order; None for all.

    Returns:
        (N, C) float64, one column a cell read; NaN where a cell is empty or says nan.

    Raises:
        DatasetError: no rows, a wrong column count, or a cell that is no number; names line and column.
    """
    clean = text if delimiter else re.sub(rb"(?m)^ +| +$", b"", re.sub(rb"[ \t\r]+", b" ", text))
    if not clean.strip():
        raise DatasetError(where, f"no data from line {first_line} on")
    names = [str(column) for column in range(columns)]
    used = names if use is None else [str(column) for column in use]
    try:
        table = pyarrow.csv.read_csv(
            pa.BufferReader(clean),
            read_options=pyarrow.csv.ReadOptions(column_names=names),
            parse_options=pyarrow.csv.ParseOptions(delimiter=delimiter or " ", quote_char=False),
            convert_options=pyarrow.csv.ConvertOptions(
                include_columns=used, column_types=dict.fromkeys(used, pa.float64()), null_values=_MISSING
            ),
        )
    except pa.ArrowException as error:
        _complain(text, columns, where, delimiter, first_line, used)
        raise DatasetError(where, str(error)) from error
    values = np.column_stack([table.column(name).to_numpy() for name in used])
    if np.isinf(values).any():
        _complain(text, columns, where, delimiter, first_line, used)
    return values


def _complain(
    text: bytes, columns: int, where: Path, delimiter: str | None, first_line: int, used: Sequence[str]
) -> None:
    """Raise for the first line that is not `columns` numbers."""
    for line_number, line in enumerate(text.split(b"\n"), first_line):
        if not line.strip():
            continue
        cells = line.decode("utf-8", errors="replace").rstrip("\r").split(delimiter)
        if len(cells) != columns:
            raise DatasetError(f"{where}, line {line_number}", f"{len(cells)} columns, expected {columns}")
        for column, cell in enumerate(cells, 1):
            if str(column - 1) in used and cell.strip() not in _MISSING:
                number(cell, f"{where}, line {line_number}", f"column {column}")
