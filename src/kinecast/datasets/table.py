"""The project's own exchange format: rows of (stamp, person, joint) as parquet or csv, lossless both ways."""

from __future__ import annotations

import csv
import io
import json
from array import array
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from io import BufferedWriter
from operator import itemgetter
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from jaxtyping import Float, Int, Shaped

from kinecast.datasets.files import BYTE_ORDER_MARK, MOST_POINTS, base_name, head, numbers, read_bytes
from kinecast.datasets.recording import Description, Recording, describe
from kinecast.datasets.resampling import measured_rate
from kinecast.errors import DatasetError, MissingExtraError, OptionError
from kinecast.output import draft

_WORLD = "z up, right-handed, metres, seconds"
_CSV_METADATA = b"# kinecast "
_PARQUET_MAGIC = b"PAR1"
_PARQUET_METADATA = b"kinecast"
_POSITION = ("x", "y", "z")
_COVARIANCE = ("sxx", "sxy", "sxz", "syy", "syz", "szz")
_REQUIRED = ("stamp", "person", "joint", *_POSITION)
_WORDS = ("person", "joint", "label")
_NUMBERS = ("stamp", *_POSITION, *_COVARIANCE, "made")
_CHUNK = 1 << 16  # rows written at a time


Words = Shaped[np.ndarray, " R"]
"""Each row's word, a str: "" where it is missing, since csv knows no empty words, only missing ones."""


def words(names: Iterable[str], times: Int[np.ndarray, " W"] | int = 1) -> Words:
    """A column of these words, each so many times."""
    return np.repeat(np.array(list(names), dtype=object), times)


@dataclass(frozen=True)
class Rows:
    """What a table holds, R rows, one for each (stamp, person, joint)."""

    stamp: Float[np.ndarray, " R"]  # [s]
    person: Words
    joint: Words
    position: Float[np.ndarray, "R 3"]  # [m], z up; NaN where missing
    covariance: Float[np.ndarray, "R 6"] | None = None  # xx, xy, xz, yy, yz, zz of the position [m²]
    label: Words | None = None  # what the person is doing
    made: Float[np.ndarray, " R"] | None = None  # when a predicted row was predicted [s]; None for measured rows
    metadata: dict[str, Any] | None = None  # rate, world frame, source and what else is of the whole; JSON values


def matches(path: Path) -> bool:
    """Whether a file is parquet, or csv with the table's metadata or column names."""
    if not path.is_file():
        return False
    start = head(path)
    columns = {name.strip().strip(b'"') for name in start.partition(b"\n")[0].split(b",")}
    return start.startswith((_PARQUET_MAGIC, _CSV_METADATA)) or {name.encode() for name in _REQUIRED} <= columns


def write(path: Path, recordings: Sequence[Recording]) -> None:
    """Write recordings so that `load` gives them back bit for bit; the file appears whole or not at all.

    Raises:
        OptionError: the path ends neither in `.parquet` nor in `.csv`.
        MissingExtraError: parquet without the extra.
        DatasetError: two recordings are of one person, there is none, or the file cannot be written.
    """
    persons = [recording.person for recording in recordings]
    if not recordings or len(set(persons)) < len(persons):
        raise DatasetError(path, f"persons {persons}: a table holds one recording of each person, and at least one")
    frames, joints = zip(*(each.positions.shape[:2] for each in recordings), strict=True)
    width = np.repeat(joints, frames)
    labels = [label for each, n in zip(recordings, frames, strict=True) for label in each.labels or [""] * n]
    labelled = any(recording.labels is not None for recording in recordings)
    write_rows(
        path,
        Rows(
            stamp=np.repeat(np.concatenate([recording.stamps for recording in recordings]), width),
            person=words(persons, np.multiply(frames, joints)),
            joint=words(joint for each, n in zip(recordings, frames, strict=True) for joint in each.joints * n),
            position=np.concatenate([recording.positions.reshape(-1, 3) for recording in recordings]),
            label=words(labels, width) if labelled else None,
            metadata={"world": _WORLD, "recordings": [asdict(describe(recording)) for recording in recordings]},
        ),
    )


def load(path: Path) -> list[Recording]:
    """One recording for each person, in the order written or of first appearance; those of `write` bit for bit.

    A table without kinecast's metadata takes its name from the file and its rate from the stamps.

    Raises:
        MissingExtraError: parquet without the extra.
        DatasetError: the file is no table; or a row repeats, lacks its stamp, person or joint, or is of a
            person or joint the metadata does not name.
    """
    return recordings_of(read_rows(path), path)


def recordings_of(rows: Rows, path: Path) -> list[Recording]:
    """As `load`, of rows that were read from the path."""
    persons = list(dict.fromkeys(rows.person.tolist()))
    if rows.metadata is None or "recordings" not in rows.metadata:
        _require_complete(rows, path)
        return [_recording(rows, _inferred(rows, person, persons, path), path) for person in persons]
    try:
        described = [Description(**each) for each in rows.metadata["recordings"]]
    except TypeError as error:
        raise DatasetError(path, f"metadata is damaged: {error}") from error
    known = {description.person for description in described}
    _require_complete(rows, path, nameless="" in known)
    if unknown := set(persons) - known:
        raise DatasetError(path, f"person {min(unknown)!r} is not in the metadata")
    return [_recording(rows, description, path) for description in described]


def _require_complete(rows: Rows, path: Path, nameless: bool = False) -> None:
    persons = (rows.person == "") & (not nameless)
    for column, missing in (("stamp", ~np.isfinite(rows.stamp)), ("joint", rows.joint == ""), ("person", persons)):
        if missing.any():
            raise DatasetError(f"{path}, row {int(np.argmax(missing)) + 1}", f"no {column}")


def _inferred(rows: Rows, person: str, persons: Sequence[str], path: Path) -> Description:
    """The description of a person in a table without metadata."""
    mine = rows.person == person
    stamps = np.unique(rows.stamp[mine])
    if len(stamps) < 2:
        raise DatasetError(path, f"{len(stamps)} frame of person {person!r}; at least 2 are needed to tell the rate")
    rate = measured_rate(stamps)
    name = base_name(path) if len(persons) == 1 else f"{base_name(path)}/{person}"
    joints = list(dict.fromkeys(rows.joint[mine].tolist()))
    note = f"rate not stated; {rate:.6g} Hz from the stamps"
    return Description(name, person, joints, rate, str(path), "table", "", "", [note])


def _recording(rows: Rows, description: Description, path: Path) -> Recording:
    """One person's rows as a recording; (stamp, joint) pairs without a row are NaN."""
    mine = np.flatnonzero(rows.person == description.person)
    stamps, frame = np.unique(rows.stamp[mine], return_inverse=True)
    places = {joint: place for place, joint in enumerate(description.joints)}
    if len(stamps) * len(places) > MOST_POINTS:
        raise DatasetError(path, f"{len(stamps)} frames of {len(places)} joints, at most {MOST_POINTS} positions")
    joint = np.array([places.get(name, -1) for name in rows.joint[mine].tolist()], dtype=np.intp)
    for row in mine[joint < 0]:
        raise DatasetError(f"{path}, row {row + 1}", f"joint {rows.joint[row]!r} is not in the metadata")
    cell = frame * len(places) + joint
    first = np.unique(cell, return_index=True)[1]
    if len(first) < len(cell):
        row = mine[np.setdiff1d(np.arange(len(cell)), first)[0]]
        raise DatasetError(f"{path}, row {row + 1}", "repeats the stamp, person and joint of an earlier row")
    positions = np.full((len(stamps) * len(places), 3), np.nan)
    positions[cell] = rows.position[mine]
    labels = _labels(rows, mine, frame, description.labelled, path)
    return description.recording(stamps, positions.reshape(len(stamps), len(places), 3), labels)


def _labels(
    rows: Rows, mine: Int[np.ndarray, " R"], frame: Int[np.ndarray, " R"], labelled: bool | None, path: Path
) -> tuple[str, ...] | None:
    """One label a frame, or None where there are none."""
    if rows.label is None or labelled is False:
        return None
    given = rows.label[mine]
    if labelled is None and (given == "").all():
        return None
    labels = np.full(frame.max(initial=-1) + 1, "", dtype=object)
    labels[frame] = given
    differs = labels[frame] != given
    if differs.any():
        raise DatasetError(f"{path}, row {mine[np.argmax(differs)] + 1}", "another label than other rows of its stamp")
    return tuple(labels)


def write_rows(path: Path, rows: Rows) -> None:
    """Write a table; the file appears whole or not at all. Raises as `write`."""
    columns: dict[str, Any] = {"stamp": rows.stamp, "person": rows.person, "joint": rows.joint}
    columns |= zip(_POSITION, rows.position.T, strict=True)
    columns |= () if rows.covariance is None else zip(_COVARIANCE, rows.covariance.T, strict=True)
    columns |= {name: column for name in ("label", "made") if (column := getattr(rows, name)) is not None}
    metadata = json.dumps(rows.metadata or {}, allow_nan=False).encode()
    if path.suffix not in (".parquet", ".csv"):
        raise OptionError(f"a table is written as .parquet or .csv, not {path.name!r}")
    require_extra(path)
    try:
        with draft(path.parent, path.name) as folder:
            with (folder / "part").open("wb") as file:
                (_write_csv if path.suffix == ".csv" else _write_parquet)(file, columns, metadata)
            (folder / "part").replace(path)
    except OSError as error:
        raise DatasetError(path, f"cannot be written: {error}") from error


def require_extra(path: Path) -> None:
    """MissingExtraError where a table of this name cannot be written or read because the extra is missing."""
    if path.suffix == ".parquet":
        _pyarrow()


def _pyarrow() -> ModuleType:
    """pyarrow and its parquet."""
    try:
        import pyarrow.parquet
    except ModuleNotFoundError as error:
        raise MissingExtraError("parquet", "parquet") from error
    return pyarrow


def read_rows(path: Path) -> Rows:
    """Read a table.

    Raises:
        MissingExtraError: parquet without the extra.
        DatasetError: the file is no table, lacks a column, holds another type in one, or has too many rows.
    """
    columns, text = (_read_parquet if head(path).startswith(_PARQUET_MAGIC) else _read_csv)(path)
    try:
        metadata = None if text is None else json.loads(text)
    except (ValueError, RecursionError) as error:
        raise DatasetError(path, f"metadata is not JSON: {error}") from error
    if not isinstance(metadata, dict | None):
        raise DatasetError(path, "metadata is not a JSON object")
    covariance = [columns[name] for name in _COVARIANCE if name in columns]
    return Rows(
        stamp=columns["stamp"],
        person=columns["person"],
        joint=columns["joint"],
        position=np.stack([columns[name] for name in _POSITION], axis=-1),
        covariance=np.stack(covariance, axis=-1) if len(covariance) == len(_COVARIANCE) else None,
        label=columns.get("label"),
        made=columns.get("made"),
        metadata=metadata,
    )


def _check_columns(names: Sequence[str], path: Path) -> None:
    """Each column is there, and once."""
    if missing := [name for name in _REQUIRED if name not in names]:
        raise DatasetError(path, f"no column {', '.join(missing)}; a table has {', '.join(_REQUIRED)}")
    if repeated := {name for name in names if names.count(name) > 1}:
        raise DatasetError(path, f"two columns {min(repeated)!r}")


def _check_length(rows: int, path: Path) -> None:
    if rows > MOST_POINTS:
        raise DatasetError(path, f"{rows} rows, at most {MOST_POINTS} are allowed")


def _write_parquet(file: BufferedWriter, columns: Mapping[str, Any], metadata: bytes) -> None:
    pa = _pyarrow()
    table = pa.table({name: pa.array(each, pa.string()) if name in _WORDS else each for name, each in columns.items()})
    pa.parquet.write_table(table.replace_schema_metadata({_PARQUET_METADATA: metadata}), file, compression="zstd")


def _read_parquet(path: Path) -> tuple[dict[str, Any], bytes | None]:
    """The known columns by name, and the metadata."""
    pa = _pyarrow()
    try:
        file = pa.parquet.ParquetFile(pa.BufferReader(read_bytes(path)))
        _check_length(file.metadata.num_rows, path)
        _check_columns(file.schema_arrow.names, path)
        table = file.read(columns=[name for name in (*_NUMBERS, *_WORDS) if name in file.schema_arrow.names])
        table.validate(full=True)  # a damaged file may hold codes of words that are not there
        columns: dict[str, Any] = {}
        for name in table.column_names:
            column = table.column(name)
            columns[name] = _decoded(column) if name in _WORDS else column.cast(pa.float64()).to_numpy()
    except (pa.ArrowException, OSError, UnicodeDecodeError) as error:
        raise DatasetError(path, f"damaged table: {error}") from error
    return columns, (table.schema.metadata or {}).get(_PARQUET_METADATA)


def _decoded(column: Any) -> Words:
    """A column of strings, plain or encoded, or of numbers that stand for names."""
    pa = _pyarrow()
    texts = column.cast(pa.string()).dictionary_encode().unify_dictionaries().combine_chunks()
    if isinstance(texts, pa.ChunkedArray):  # of no rows
        return words(())
    return words((*texts.dictionary.to_pylist(), ""))[texts.indices.fill_null(-1).to_numpy()]


def _write_csv(file: BufferedWriter, columns: Mapping[str, Any], metadata: bytes) -> None:
    """Every word in quotes, a missing one without; every number in as many digits as it needs."""
    file.write(_CSV_METADATA + metadata + b"\n" + ",".join(columns).encode() + b"\n")
    quoted = {
        word: word and '"' + word.replace('"', '""') + '"' for name in _WORDS for word in set(columns.get(name, ()))
    }
    for start in range(0, len(columns["stamp"]), _CHUNK):
        part = slice(start, start + _CHUNK)
        cells = [
            map(quoted.__getitem__ if name in _WORDS else repr, column[part].tolist())
            for name, column in columns.items()
        ]
        file.write("".join(",".join(row) + "\n" for row in zip(*cells, strict=True)).encode())


def _read_csv(path: Path) -> tuple[dict[str, Any], bytes | None]:
    """The known columns by name, and the metadata."""
    text = read_bytes(path).removeprefix(BYTE_ORDER_MARK)
    metadata, before = None, int(text.startswith(_CSV_METADATA))
    if before:
        line, _, text = text.partition(b"\n")
        metadata = line.removeprefix(_CSV_METADATA)
    reader = csv.reader(io.TextIOWrapper(io.BytesIO(text), "utf-8", newline=""), strict=True)
    try:
        names = next(reader, [])
        _check_columns(names, path)
        number_names = [name for name in _NUMBERS if name in names]
        number_cells = itemgetter(*map(names.index, number_names))
        what = [f"damaged table: {name}" for name in number_names]
        values = array("d")
        texts = {name: (names.index(name), list[str]()) for name in _WORDS if name in names}
        known, rows = dict[str, str](), 0  # each word once in memory
        for row in reader:
            if not row:
                continue
            if len(row) != len(names):
                problem = f"damaged table: Expected {len(names)} columns, got {len(row)}"
                raise DatasetError(f"{path}, line {reader.line_num + before}", problem)
            values.extend(numbers(number_cells(row), what, path, reader.line_num + before, infinite=True))
            for place, column in texts.values():
                column.append(known.setdefault(row[place], row[place]))
            rows += 1
    except (csv.Error, UnicodeDecodeError) as error:
        raise DatasetError(f"{path}, line {reader.line_num + before}", f"damaged table: {error}") from error
    _check_length(rows, path)
    columns: dict[str, Any] = dict(zip(number_names, np.array(values).reshape(rows, len(number_names)).T, strict=True))
    columns |= {name: words(column) for name, (_, column) in texts.items()}
    return columns, metadata
