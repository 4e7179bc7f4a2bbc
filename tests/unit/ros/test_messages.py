"""Bytes of every message that is used: published hashes, CycloneDDS's bytes, and what is no message."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from rosbags.typesys.msg import normalize_msgtype

from kinecast.live.message import MessageError
from kinecast.ros.dds import idl_type
from kinecast.ros.messages import LARGEST, Distribution, Messages, messages_of
from kinecast.ros.subscriber import INPUTS

USED = (
    *INPUTS,
    "geometry_msgs/PoseWithCovarianceStamped",
    "kinecast_msgs/PredictedDistribution",
    "moveit_msgs/PlanningScene",
)
SECOND = [Distribution.HUMBLE, Distribution.JAZZY]


@pytest.mark.parametrize(
    ("type_", "md5"),
    [
        ("geometry_msgs/PoseArray", "916c28c5764443f268b296bb671b9d97"),
        ("sensor_msgs/JointState", "3066dcd76a6cfaef579bd0f34173e9fd"),
        ("tf2_msgs/TFMessage", "94810edda583a504dfda3829e70d7eec"),
        ("moveit_msgs/CollisionObject", "dbba710596087da521c07564160dfccb"),
        ("moveit_msgs/PlanningScene", "acfc50bcfd6c7b978066bfa7c786002c"),
        ("zed_interfaces/Object", "20668bd5819407b0c69c8d1de510a3a2"),
    ],
)
def test_definitions_have_the_hashes_that_were_published(type_: str, md5: str) -> None:
    assert messages_of(Distribution.NOETIC).store.generate_msgdef(normalize_msgtype(type_))[1] == md5


@pytest.mark.parametrize("type_", USED)
def test_humble_and_jazzy_have_the_same_bytes(type_: str) -> None:
    """So that a bag of either is read by the definitions of one."""
    humble, jazzy = (messages_of(each).store.hash_rihs01(normalize_msgtype(type_)) for each in SECOND)
    assert humble == jazzy


@pytest.mark.parametrize("distribution", SECOND)
@pytest.mark.parametrize("type_", USED)
def test_cyclonedds_has_the_same_bytes(distribution: Distribution, type_: str, random_fields: Any) -> None:
    messages, rng = messages_of(distribution), np.random.default_rng(5)
    known: dict[str, Any] = {}
    class_ = idl_type(messages, type_, known)
    for _ in range(5):
        fields = random_fields(messages, type_, rng)
        bytes_ = messages.encode(type_, fields)
        sent = of_dds(messages, type_, fields, known)
        assert sent.serialize(use_version_2=False) == bytes_  # out: CycloneDDS's are the type store's
        assert class_.deserialize(bytes_) == sent  # in: what the type store wrote is what CycloneDDS reads
        assert repr(messages.decode(type_, sent.serialize(use_version_2=False))) == repr(messages.decode(type_, bytes_))


def of_dds(messages: Messages, type_: str, fields: dict[str, Any], known: dict[str, Any]) -> Any:
    """CycloneDDS's object of fields, made without the type store's encoder."""

    def value(kind: Any, given: Any) -> Any:
        if isinstance(given, dict):
            return of_dds(messages, kind[1], given, known)
        if isinstance(given, list):
            return [value(kind[1][0], each) for each in given]
        if kind[1] in ("builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration"):
            return known[kind[1]](sec=int(given), nanosec=round(given % 1 * 1e9))
        return given

    name = normalize_msgtype(type_)
    return known[name](**{field: value(kind, fields[field]) for field, kind in messages.store.fielddefs[name][1]})


@pytest.mark.parametrize("distribution", Distribution)
def test_nothing_that_is_no_message_raises_anything_else(distribution: Distribution, random_fields: Any) -> None:
    messages, rng = messages_of(distribution), np.random.default_rng(3)
    problems = []
    for type_ in (each for each in USED if normalize_msgtype(each) in messages.store.fielddefs):
        whole = messages.encode(type_, random_fields(messages, type_, rng))
        for _ in range(60):
            bytes_ = bytearray(whole[: rng.integers(0, len(whole), endpoint=True)])
            for place in rng.integers(0, max(len(bytes_), 1), rng.integers(0, 4)):
                bytes_[place : place + 4] = rng.bytes(4)
            try:
                messages.decode(type_, bytes(bytes_))
            except MessageError as problem:
                problems.append(str(problem))
    assert len(problems) > 100
    assert max(map(len, problems)) < 300
    with pytest.raises(MessageError, match=f"at most {LARGEST} are taken"):
        messages.decode("geometry_msgs/PoseArray", bytes(LARGEST + 1))


def test_what_is_left_out_is_zero_and_what_is_not_there_an_error() -> None:
    messages = messages_of(Distribution.JAZZY)
    stamp = 1_760_000_000.25
    bytes_ = messages.encode("geometry_msgs/PoseArray", {"header": {"stamp": stamp}, "poses": [{}]})
    read = messages.decode("geometry_msgs/PoseArray", bytes_)
    assert (read.header.stamp.sec, read.header.stamp.nanosec, read.header.frame_id) == (1_760_000_000, 250_000_000, "")
    assert read.poses[0].position.x == 0.0
    with pytest.raises(KeyError, match="position"):
        messages.encode("geometry_msgs/PoseArray", {"position": 1.0})
