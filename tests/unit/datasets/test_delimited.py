"""Rows of numbers: values, missing ones, and messages that name the place."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from kinecast.datasets.delimited import number, rows, split_lines
from kinecast.errors import DatasetError

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
