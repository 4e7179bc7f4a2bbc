"""Bags of both generations: what is written is read, and what is no bag is said to be none."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.highlevel import AnyReader

from kinecast.body.skeleton import ARM_JOINTS
from kinecast.errors import DatasetError, OptionError
from kinecast.ros.bags import BagInputOptions, BagOutputOptions, BagWriter, read_frames
from kinecast.ros.publisher import PredictionPublisher
from kinecast.ros.transport import RosSink

REST = np.array([[0, 0.2, 1.4], [0, 0.25, 1.1], [0.2, 0.2, 1.0], [0, -0.2, 1.4], [0, -0.25, 1.1], [0.2, -0.2, 1.0]])
NOW = 1_760_000_000.0
KINDS = [
    ("take.bag", BagOutputOptions()),
    ("humble", BagOutputOptions(distro="humble", storage="sqlite3")),
    ("jazzy", BagOutputOptions()),
]


def write_poses(path: Path, options: BagOutputOptions, count: int = 20) -> None:
    writer = BagWriter(path, options)
    for k in range(count):
        stamp = NOW + k / 32
        poses = [{"position": dict(zip("xyz", xyz, strict=True))} for xyz in (REST + k / 1024).tolist()]
        fields = {"header": {"stamp": stamp, "frame_id": "cell"}, "poses": poses}
        content = writer.messages.encode("geometry_msgs/PoseArray", fields)
        writer.write("/arms", "geometry_msgs/PoseArray", content, stamp)
    writer.publish("/arms", "geometry_msgs/PoseArray", b"no message")
    writer.close()


@pytest.mark.parametrize(("name", "options"), KINDS)
def test_what_is_written_is_read(tmp_path: Path, name: str, options: BagOutputOptions) -> None:
    path = tmp_path / name
    write_poses(path, options)
    frames, wrong = read_frames(path, BagInputOptions(joints=",".join(ARM_JOINTS)))
    assert wrong == 1
    assert [frame.stamp for frame in frames] == [NOW + k / 32 for k in range(20)]
    for k, frame in enumerate(frames):
        np.testing.assert_array_equal(frame.positions, REST + k / 1024)
    with pytest.raises(OptionError, match="a bag is never replaced"):
        BagWriter(path, options)
    with pytest.raises(DatasetError, match=r"those that may have some: /arms \(geometry_msgs/PoseArray\)"):
        read_frames(path, BagInputOptions(topic="/legs"))


@pytest.mark.parametrize(("name", "options"), KINDS)
def test_predictions_in_a_bag_are_read_by_its_own_definitions(
    tmp_path: Path, publish: Any, name: str, options: BagOutputOptions
) -> None:
    path = tmp_path / name
    sink = RosSink("bag", PredictionPublisher(options), BagWriter(path, options), 100)
    for k in range(8):
        sink.publish(publish(REST, k / 30))
    sink.close()
    assert (sink.counters.published, sink.counters.dropped, sink.counters.failure) == (8, 0, None)
    with AnyReader([path]) as reader:
        messages: dict[str, list[Any]] = {}
        for connection, _, content in reader.messages():
            messages.setdefault(connection.topic, []).append(reader.deserialize(content, connection.msgtype))
    assert len(messages["/kinecast/prediction"]) == 8
    assert [each.person for each in messages["/kinecast/prediction"]] == ["0"] * 8
    last = messages["/kinecast/planning_scene"][-1].world.collision_objects
    assert [each.operation for each in last] == [1] * 12  # closing takes back what was put into the scene


@pytest.mark.parametrize(("name", "options"), KINDS)
def test_damaged_bags_are_data_errors(tmp_path: Path, name: str, options: BagOutputOptions) -> None:
    write_poses(tmp_path / name, options)
    rng = np.random.default_rng(2)
    refused = 0
    for turn in range(25):
        path = tmp_path / f"{turn}{name}"
        (shutil.copytree if (tmp_path / name).is_dir() else shutil.copy)(tmp_path / name, path)
        file = next(each for each in ([path] if path.is_file() else sorted(path.iterdir())) if each.suffix != ".yaml")
        content = bytearray(file.read_bytes())
        for place in rng.integers(0, len(content), 40):
            content[place] = int(rng.integers(256))
        file.write_bytes(content[: rng.integers(1, len(content))] if turn % 2 else content)
        try:
            read_frames(path, BagInputOptions(joints=",".join(ARM_JOINTS)))
        except DatasetError:
            refused += 1
    assert refused > 5


def test_what_is_no_bag_is_said_to_be_none(tmp_path: Path) -> None:
    for name in ("a.bag", "b.db3", "c.mcap"):
        (tmp_path / name).write_bytes(b"nothing")
        with pytest.raises(DatasetError, match="no bag that can be read"):
            read_frames(tmp_path / name, BagInputOptions())
    with pytest.raises(DatasetError, match="no bag that can be read"):
        read_frames(tmp_path / "nowhere", BagInputOptions())
    (tmp_path / "d").mkdir()
    (tmp_path / "d" / "metadata.yaml").write_text("rosbag2_bagfile_information: {version: 99}")
    with pytest.raises(DatasetError, match="no bag that can be read"):
        read_frames(tmp_path / "d", BagInputOptions())
    with pytest.raises(OptionError, match="there is no folder"):
        BagWriter(tmp_path / "a.bag" / "b.bag", BagOutputOptions())
