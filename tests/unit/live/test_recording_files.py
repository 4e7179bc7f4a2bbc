"""Recordings as JSON lines and MCAP: back to the last bit, refused where damaged, read from what live wrote."""

from __future__ import annotations

import json
import random
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

pytest.importorskip("mcap")

import lz4.frame
from mcap.data_stream import RecordBuilder
from mcap.reader import make_reader
from mcap.records import Chunk, Header

from kinecast.body.skeleton import ARM_JOINTS, JOINTS
from kinecast.datasets import table
from kinecast.datasets.recording import Recording, differences
from kinecast.errors import DatasetError
from kinecast.live import mcap_file, message_file
from kinecast.live.publication import Publication
from kinecast.live.sinks import JsonlSink
from kinecast.types import Prediction, SkeletonFrame

WORDS = st.text(st.characters(min_codepoint=32, max_codepoint=0x2FFF, exclude_categories=["C", "Z"]), max_size=12)
OTHERS = [joint for joint in JOINTS if joint not in ARM_JOINTS]


@st.composite
def scenes(draw: st.DrawFn) -> list[dict[str, Any]]:
    """One or two persons at the same time; anything a recording may hold, as its arguments."""
    found = []
    for person in range(draw(st.integers(1, 2))):
        frames = draw(st.integers(2, 6))
        rng = np.random.default_rng(draw(st.integers(0, 2**32)))
        joints = (*draw(st.permutations(ARM_JOINTS)), *draw(st.lists(st.sampled_from(OTHERS), unique=True, max_size=3)))
        positions = rng.standard_normal((frames, len(joints), 3)) * 10.0 ** rng.integers(-6, 4, (frames, 1, 1))
        positions[rng.random((frames, len(joints))) < 0.2] = np.nan
        found.append(
            {
                "name": draw(WORDS),
                "joints": tuple(joints),
                "stamps": draw(st.floats(-1e3, 2e9)) + np.cumsum(0.001 + rng.random(frames)),
                "positions": positions.clip(-1e4, 1e4),
                "rate": draw(st.floats(1.0, 500.0)),
                "source": draw(st.sampled_from([None, Path("a/b.csv")])),
                "format": draw(WORDS),
                "person": f"{person}{draw(WORDS)}",
                "subject": draw(WORDS),
                "task": draw(WORDS),
                "labels": draw(st.none() | st.just(tuple(draw(WORDS) for _ in range(frames)))),
                "notes": tuple(draw(st.lists(WORDS, max_size=2))),
            }
        )
    return found


FILES = settings(max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture])


@FILES
@given(scenes())
def test_mcap_and_tables_give_every_recording_back_bit_for_bit(tmp_path: Path, scene: list[dict[str, Any]]) -> None:
    recordings = [Recording(**each) for each in scene]
    mcap_file.write(tmp_path / "a.mcap", recordings)
    once = mcap_file.load(tmp_path / "a.mcap")
    assert differences(recordings, once) == []
    table.write(tmp_path / "b.parquet", once)
    twice = table.load(tmp_path / "b.parquet")
    assert differences(recordings, twice) == []
    for a, b in zip(recordings, twice, strict=True):
        np.testing.assert_array_equal(a.positions, b.positions)
        np.testing.assert_array_equal(a.stamps, b.stamps)
        assert (a.joints, a.labels, a.notes, a.rate) == (b.joints, b.labels, b.notes, b.rate)


@FILES
@given(scenes())
def test_json_lines_keep_every_number_and_label(tmp_path: Path, scene: list[dict[str, Any]]) -> None:
    recordings = [Recording(**each) for each in scene]
    path = tmp_path / "a.jsonl"
    message_file.write(path, recordings)
    back = {recording.person: recording for recording in message_file.load(path)}
    for recording in recordings:
        found = back.pop(recording.person)
        np.testing.assert_array_equal(found.stamps, recording.stamps)
        np.testing.assert_array_equal(found.positions, recording.positions)
        assert (found.joints, found.labels) == (recording.joints, recording.labels)
        assert "rate not stated" in found.notes[0]
        assert differences([recording], [replace(found, stamps=found.stamps + 1.0)])
    assert not back


def person(frames: int = 4) -> Recording:
    still = np.array([[0, 0.2, 1.4], [0, 0.25, 1.1], [0.2, 0.2, 1.0], [0, -0.2, 1.4], [0, -0.25, 1.1], [0.2, -0.2, 1]])
    return Recording("still", ARM_JOINTS, np.arange(frames) / 30.0, np.repeat(still[None], frames, 0), 30.0)


def test_foxglove_finds_a_drawing_of_every_frame(tmp_path: Path) -> None:
    mcap_file.write(tmp_path / "a.mcap", [person()])
    with (tmp_path / "a.mcap").open("rb") as file:
        drawn = [
            (message.log_time, json.loads(message.data))
            for schema, _, message in make_reader(file).iter_messages()
            if schema is not None and schema.name == "foxglove.SceneUpdate"
        ]
    assert [time for time, _ in drawn] == [int(k / 30.0 * 1e9) for k in range(4)]
    (entity,) = drawn[0][1]["entities"]
    assert (len(entity["spheres"]), len(entity["lines"][0]["points"])) == (6, 8)


def publications(stamps: list[float]) -> list[Publication]:
    arms = person().positions[0] + 1e-5
    mean = np.zeros((2, 6, 3))
    return [
        Publication.of(
            k, "udp://x", SkeletonFrame(stamp, ARM_JOINTS, arms + k, "7"),
            Prediction(stamp, stamp + np.array([0.1, 0.2]), np.zeros((3, 2, 6, 3)), mean, np.zeros((2, 6, 3, 3)),
                       ARM_JOINTS, "7"),
            0.9, 0.0,
        )
        for k, stamp in enumerate(stamps, 1)
    ]  # fmt: skip


@pytest.mark.parametrize(("sink", "load"), [(JsonlSink, message_file.load), (mcap_file.McapSink, mcap_file.load)])
def test_what_live_wrote_is_a_recording_of_the_arms_as_measured(tmp_path: Path, sink: Any, load: Any) -> None:
    opened = sink(tmp_path / "out")
    for publication in publications([1.0, 1.1, 1.05, 1.1, 1.2]):
        opened.publish(publication)
    opened.close()
    (recording,) = load(tmp_path / "out")
    assert (recording.joints, recording.person) == (ARM_JOINTS, "7")
    np.testing.assert_array_equal(recording.stamps, [1.0, 1.1, 1.2])
    np.testing.assert_allclose(recording.positions[2], person().positions[0] + 5, atol=1e-4)
    assert "arms as `kinecast live` saw them, to 0.1 mm" in recording.notes
    assert "2 frames that came late or twice left out" in recording.notes


GOOD = json.loads(message_file.message(SkeletonFrame(0.0, ARM_JOINTS, person().positions[0]), None))
PREDICTED = {"kind": "prediction", "stamp": 0.0, "person": "a", "source": "b", "joints": ARM_JOINTS}


@pytest.mark.parametrize(
    ("lines", "problem"),
    [
        ([GOOD, GOOD], r"line 2: stamp 0.0 s does not come after 0.0 s"),
        ([GOOD], "1 frame of person '0'"),
        ([{"stamp": 1}], "line 1: neither skeleton nor prediction: expected either positions or pixels"),
        ([{**GOOD, "positions": [[1, 2]] * 6}], "line 1: neither skeleton nor prediction: a position is not three"),
        ([{**PREDICTED, "observed": [[1, 2, 3]] * 5}], "observed are 6 × 3"),
        ([{**PREDICTED, "observed": [[None] * 3] * 6}, GOOD], "line 2: predictions and skeletons in one file"),
        ([{"stamp": 0, "pixels": [[1, 2]] * 6, "joints": ARM_JOINTS}], "pixels of one camera"),
    ],
)
def test_lines_that_are_no_recording_are_named(tmp_path: Path, lines: list[Any], problem: str) -> None:
    path = tmp_path / "a.jsonl"
    path.write_text("\n\n".join(json.dumps(line) for line in lines[:1]) + "\n" + "\n".join(map(json.dumps, lines[1:])))
    with pytest.raises(DatasetError, match=problem):
        message_file.load(path)


def test_lines_are_bounded(tmp_path: Path) -> None:
    path = tmp_path / "a.jsonl"
    path.write_bytes(b"{" * (3 << 20))
    with pytest.raises(DatasetError, match="line 1: longer than 1048576 bytes"):
        message_file.load(path)


def test_damaged_mcap_files_are_refused_and_nothing_else_is_raised(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    mcap_file.write(path, [person(12)])
    whole, dice, refused = path.read_bytes(), random.Random(0), 0
    for _ in range(400):
        damaged = bytearray(whole[: dice.choice([len(whole), dice.randrange(len(whole))])])
        for _ in range(dice.randrange(1, 9)):
            if damaged:
                damaged[dice.randrange(len(damaged))] = dice.randrange(256)
        path.write_bytes(damaged)
        try:
            mcap_file.load(path)
        except DatasetError:
            refused += 1
    assert refused > 200


@pytest.mark.parametrize("size", [100, 1 << 40])
def test_a_chunk_that_is_larger_than_it_says_is_not_unpacked(tmp_path: Path, size: int) -> None:
    builder = RecordBuilder()
    Header(profile="", library="").write(builder)
    Chunk("lz4", lz4.frame.compress(bytes(1 << 24)), 0, 0, 0, size).write(builder)
    path = tmp_path / "bomb.mcap"
    path.write_bytes(b"\x89MCAP0\r\n" + builder.end())
    with pytest.raises(DatasetError, match="damaged MCAP file: a chunk"):
        mcap_file.load(path)
