"""The project's own tables: lossless both ways, whole or not at all."""

from __future__ import annotations

import gzip
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet
import pytest

from kinecast.body.skeleton import ARM_JOINTS
from kinecast.datasets import table, vicon
from kinecast.datasets.recording import Recording
from kinecast.datasets.table import Rows, read_rows, words, write_rows
from kinecast.errors import DatasetError, OptionError

SUFFIXES = (".parquet", ".csv")
HEADER = "stamp,person,joint,x,y,z\n"


def bits(array: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(array).view(np.int64)


def assert_identical(found: Recording, expected: Recording) -> None:
    np.testing.assert_array_equal(bits(found.positions), bits(expected.positions))
    np.testing.assert_array_equal(bits(found.stamps), bits(expected.stamps))
    nothing = np.empty((0, len(expected.joints), 3))
    bare = {"positions": nothing, "stamps": np.empty(0), "labels": None}
    assert repr(replace(found, **bare)) == repr(replace(expected, **bare))
    assert found.labels == expected.labels


@pytest.fixture
def recording() -> Recording:
    """Numbers of every size, missing coordinates, a frame with nothing seen, and awkward words."""
    rng = np.random.default_rng(0)
    positions = rng.normal(size=(7, 6, 3)) * 10.0 ** rng.integers(-300, 300, (7, 6, 3))
    positions[1, 2] = np.nan
    positions[2] = np.nan
    positions[3, 1, 0] = np.nan
    positions[4, 0] = [-0.0, 5e-324, 0.1 + 0.2]
    return Recording(
        name='odd "name", with\ncomma é',
        joints=tuple(reversed(ARM_JOINTS)),
        stamps=1.7e9 + np.cumsum(rng.uniform(0.01, 0.02, 7)),
        positions=positions,
        rate=1.0 / 0.0333,
        source=Path("folder") / "file.csv.xz",
        format="vicon",
        person='anne, "the first"',
        subject="S1",
        task="pick and place",
        labels=("reach", "reach", "", "a, b", 'say "go"', "two\nlines", "reach"),
        notes=("rate assumed", "nan"),
    )


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_round_trip_is_bit_exact(tmp_path: Path, recording: Recording, suffix: str) -> None:
    path = tmp_path / f"a{suffix}"
    other = replace(recording, person="ben", labels=None, joints=ARM_JOINTS, source=None, name="b", notes=())
    table.write(path, [recording, other])
    assert table.matches(path)
    first, second = table.load(path)
    assert_identical(first, recording)
    assert_identical(second, other)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_empty_words_and_infinite_numbers_come_back(tmp_path: Path, recording: Recording, suffix: str) -> None:
    recording.positions[0, 0] = [np.inf, -np.inf, np.nan]
    nameless = replace(recording, person="", labels=("",) * 7)
    table.write(tmp_path / f"a{suffix}", [recording, nameless])
    first, second = table.load(tmp_path / f"a{suffix}")
    assert_identical(first, recording)
    assert_identical(second, nameless)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_round_trip_of_a_real_take(tmp_path: Path, data_root: Path, suffix: str) -> None:
    (take,) = vicon.load(data_root / "human_robot_animations" / "CollaborativeLifting" / "0.csv.xz")
    table.write(tmp_path / f"a{suffix}", [take])
    (found,) = table.load(tmp_path / f"a{suffix}")
    assert_identical(found, take)


def test_a_compressed_table_is_read(tmp_path: Path, recording: Recording) -> None:
    table.write(tmp_path / "a.csv", [recording])
    packed = tmp_path / "b.csv.gz"
    packed.write_bytes(gzip.compress((tmp_path / "a.csv").read_bytes()))
    assert_identical(table.load(packed)[0], recording)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_every_column_round_trips(tmp_path: Path, suffix: str) -> None:
    rng = np.random.default_rng(1)
    rows = Rows(
        stamp=np.array([0.0, 0.0, 0.1]),
        person=words(["p", "p", "q"]),
        joint=words(["left_wrist", "nose", "nose"]),
        position=rng.normal(size=(3, 3)),
        made=np.array([0.0, np.nan, 0.1]),
        covariance=rng.normal(size=(3, 6)),
        label=words(["a", "", "é"]),
        metadata={"rate": 30.0, "source": "test"},
    )
    write_rows(tmp_path / f"a{suffix}", rows)
    found = read_rows(tmp_path / f"a{suffix}")
    for name in ("stamp", "position", "made", "covariance", "person", "joint", "label"):
        np.testing.assert_array_equal(getattr(found, name), getattr(rows, name))
    assert found.metadata == rows.metadata


def test_a_table_without_metadata(tmp_path: Path) -> None:
    path = tmp_path / "mine.csv"
    path.write_text(
        HEADER + "0.1,7,head,1,2,3\n0.0,7,head,4,5,6\n0.2,7,neck,7,8,\n0.1,8,neck,1,1,1\n0.3,8,neck,1,1,1\n"
    )
    first, second = table.load(path)
    assert (first.name, first.person, second.name) == ("mine/7", "7", "mine/8")
    assert first.joints == ("head", "neck")
    assert first.rate == pytest.approx(10.0)
    assert first.notes == ("rate not stated; 10 Hz from the stamps",)
    np.testing.assert_array_equal(first.stamps, [0.0, 0.1, 0.2])
    np.testing.assert_array_equal(first.joint("head"), [[4, 5, 6], [1, 2, 3], [np.nan] * 3])
    np.testing.assert_array_equal(first.joint("neck")[2], [7, 8, np.nan])
    assert (second.joints, second.rate) == (("neck",), pytest.approx(5.0))


def test_parquet_of_other_writers_is_read(tmp_path: Path) -> None:
    path = tmp_path / "a.parquet"
    columns = {
        "stamp": pa.array([0, 1], pa.int64()),
        "person": pa.array([3, 3], pa.int32()),
        "joint": pa.array(["head", "head"], pa.large_string()),
        **{axis: pa.array([0.5, 0.25], pa.float32()) for axis in "xyz"},
        "comment": pa.array(["passed", "over"]),
    }
    pa.parquet.write_table(pa.table(columns), path)
    (found,) = table.load(path)
    assert (found.person, found.rate) == ("3", 1.0)
    np.testing.assert_array_equal(found.joint("head"), [[0.5] * 3, [0.25] * 3])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (HEADER + "0,p,head,1,2,high\n", r"a\.csv, line 2: damaged table: .*'high'"),
        (HEADER + "0,p,head,1,2,1_0\n", r"a\.csv, line 2: damaged table: z is '1_0', expected a number"),
        (HEADER + '0,p,"head,1,2,3\n', r"a\.csv, line 2: damaged table: unexpected end of data"),
        (HEADER + "0,p,head,1,2,3\n0,p,neck,1,2\n", r"a\.csv, line 3: .* Expected 6 columns, got 5"),
        ("# kinecast {}\n" + HEADER + "0,p,head,1,2,3\n0,p,neck,1,2\n", r"a\.csv, line 4: .* Expected 6"),
        (HEADER + "0,p,head,1,2,3\n1,p,head,1,2,3\n0,p,head,9,9,9\n", r"a\.csv, row 3: repeats the stamp"),
        (HEADER + "0,p,head,1,2,3\n,p,head,1,2,3\n", r"a\.csv, row 2: no stamp"),
        (HEADER + "0,p,head,1,2,3\n1,,head,1,2,3\n", r"a\.csv, row 2: no person"),
        (HEADER + "0,p,head,1,2,3\n1,p,,1,2,3\n", r"a\.csv, row 2: no joint"),
        (HEADER + "0,p,head,1,2,3\n", r"a\.csv: 1 frame of person 'p'; at least 2"),
        (HEADER.replace(",z", ""), r"a\.csv: no column z; a table has stamp, person"),
        (HEADER[:-1] + ",label\n0,p,head,1,2,3,a\n0,p,neck,1,2,3,b\n1,p,neck,1,2,3,b\n", r"row 1: another"),
        (HEADER[:-1] + ",x\n0,p,head,1,2,3,4\n", r"a\.csv: two columns 'x'"),
        ("# kinecast {broken\n" + HEADER, r"a\.csv: metadata is not JSON"),
        ("# kinecast []\n" + HEADER, r"a\.csv: metadata is not a JSON object"),
        ('# kinecast {"recordings": [{"name": "a"}]}\n' + HEADER, r"a\.csv: metadata is damaged: .*missing"),
        ('# kinecast {"recordings": 5}\n' + HEADER, r"a\.csv: metadata is damaged"),
        ('# kinecast {"recordings": []}\n' + HEADER + "0,p,head,1,2,3\n", r"person 'p' is not in the"),
    ],
)  # fmt: skip
def test_a_spoilt_csv_is_refused(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "a.csv"
    path.write_text(text)
    with pytest.raises(DatasetError, match=message):
        table.load(path)


@pytest.mark.parametrize(
    "change", [{"rate": "fast"}, {"joints": 3}, {"notes": None}, {"source": 5}, {"name": None}, {"more": 1}]
)
def test_damaged_metadata_is_refused(tmp_path: Path, recording: Recording, change: dict[str, object]) -> None:
    path = tmp_path / "a.parquet"
    table.write(path, [recording])
    rows = read_rows(path)
    assert rows.metadata is not None
    rows.metadata["recordings"][0] |= change
    write_rows(path, rows)
    with pytest.raises(DatasetError, match=r"a\.parquet: metadata is damaged"):
        table.load(path)


def test_a_joint_the_metadata_does_not_name_is_refused(tmp_path: Path, recording: Recording) -> None:
    path = tmp_path / "a.parquet"
    table.write(path, [recording])
    rows = read_rows(path)
    assert rows.metadata is not None
    rows.metadata["recordings"][0]["joints"][2] = "tail"
    write_rows(path, rows)
    with pytest.raises(DatasetError, match=r"a\.parquet, row 3: joint 'right_shoulder' is not in the metadata"):
        table.load(path)


def test_without_the_extra_csv_works_and_parquet_names_it(tmp_path: Path, recording: Recording) -> None:
    for name in ("there.csv", "there.parquet"):
        table.write(tmp_path / name, [recording])
    script = """
import sys
sys.modules["pyarrow"] = None
from pathlib import Path
from kinecast.datasets import table
from kinecast.errors import MissingExtraError
people = table.load(Path("there.csv"))
table.write(Path("a.csv"), people)
assert Path("a.csv").read_bytes() == Path("there.csv").read_bytes()
for step in (lambda: table.write(Path("a.parquet"), people), lambda: table.load(Path("there.parquet"))):
    try:
        step()
    except MissingExtraError as error:
        print(error)
"""
    done = subprocess.run([sys.executable, "-c", script], cwd=tmp_path, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    assert done.stdout == "parquet needs optional packages: pip install 'kinecast[parquet]'\n" * 2


def test_damaged_parquet_is_refused(tmp_path: Path, recording: Recording) -> None:
    path = tmp_path / "a.parquet"
    table.write(path, [recording])
    path.write_bytes(path.read_bytes()[:-50])
    with pytest.raises(DatasetError, match=r"a\.parquet: damaged table"):
        table.load(path)


def test_too_many_rows_and_positions_are_refused(
    tmp_path: Path, recording: Recording, monkeypatch: pytest.MonkeyPatch
) -> None:
    for suffix in SUFFIXES:
        path = tmp_path / f"a{suffix}"
        table.write(path, [recording])
        rows = read_rows(path)
        with monkeypatch.context() as patch:
            patch.setattr(table, "MOST_POINTS", 41)
            with pytest.raises(DatasetError, match="42 rows, at most 41 are allowed"):
                table.load(path)
            patch.setattr(table, "read_rows", lambda _, rows=rows: rows)
            with pytest.raises(DatasetError, match="7 frames of 6 joints, at most 41 positions"):
                table.load(path)


def test_one_recording_a_person(tmp_path: Path, recording: Recording) -> None:
    with pytest.raises(DatasetError, match="one recording of each person"):
        table.write(tmp_path / "a.parquet", [recording, recording])
    with pytest.raises(DatasetError, match="at least one"):
        table.write(tmp_path / "a.parquet", [])
    assert not list(tmp_path.iterdir())


def test_nothing_half_written(tmp_path: Path, recording: Recording, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a.parquet"
    path.write_bytes(b"what was there")

    def fail(*_: object, **__: object) -> None:
        raise OSError("disk full")

    monkeypatch.setattr(pa.parquet, "write_table", fail)
    with pytest.raises(DatasetError, match=r"a\.parquet: cannot be written: disk full"):
        table.write(path, [recording])
    assert path.read_bytes() == b"what was there"
    assert [file.name for file in tmp_path.iterdir()] == ["a.parquet"]


def test_bad_places_to_write(tmp_path: Path, recording: Recording) -> None:
    with pytest.raises(OptionError, match=r"written as \.parquet or \.csv, not 'a\.txt'"):
        table.write(tmp_path / "a.txt", [recording])
    with pytest.raises(DatasetError, match="cannot be written"):
        table.write(tmp_path / "none" / "a.csv", [recording])
