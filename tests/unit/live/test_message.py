"""Messages: what is read, what is refused with which words, and 10^5 bad ones that raise nothing else."""

from __future__ import annotations

import json
import random
import subprocess
import sys
from collections.abc import Callable
from contextlib import suppress
from copy import deepcopy
from typing import Any

import msgspec
import numpy as np
import pytest

from kinecast.body.skeleton import ARM_JOINTS, COCO_17
from kinecast.live.detection import Detection
from kinecast.live.mailbox import Mailbox
from kinecast.live.message import LARGEST_MESSAGE, MessageError, decode
from kinecast.live.sender_guard import FORGET, MOST_PERSONS, MOST_SENDERS, SenderGuard
from kinecast.types import SkeletonFrame

REST = [[0, 0.2, 1.4], [0, 0.25, 1.1], [0.2, 0.2, 1.0], [0, -0.2, 1.4], [0, -0.25, 1.1], [0.2, -0.2, 1.0]]
FUZZED = 100_000


def message(**changes: Any) -> dict[str, Any]:
    """A good one, changed."""
    return {"stamp": 12.5, "joints": list(ARM_JOINTS), "positions": [list(row) for row in REST], **changes}


@pytest.mark.parametrize("encode", [json.dumps, msgspec.json.encode, msgspec.msgpack.encode])
def test_a_skeleton_comes_through_either_encoding(encode: Callable[[Any], Any]) -> None:
    content = message(person=7, frame_id="camera", std=[0.01, 0.02, None, 0.0, 0.01, 0.5], extra={"ignored": [1]})
    content["positions"][2] = [0.1, None, 1.0]
    frame = decode(encode(content))
    assert (frame.stamp, frame.joints, frame.person, frame.frame_id) == (12.5, ARM_JOINTS, "7", "camera")
    np.testing.assert_array_equal(frame.valid, [True, True, False, True, True, True])
    np.testing.assert_allclose(frame.positions[[0, 5]], [REST[0], REST[5]])
    assert frame.std is not None
    np.testing.assert_array_equal(np.isnan(frame.std), [False, False, True, False, False, False])


def test_joints_may_stand_in_any_order_and_others_are_left_out() -> None:
    joints = ["tail", *reversed(ARM_JOINTS), "Left Hip"]
    frame = decode(json.dumps(message(joints=joints, positions=[[9, 9, 9], *reversed(REST), [0.0, 0.1, 0.9]])))
    assert frame.joints == (*reversed(ARM_JOINTS), "left_hip")
    np.testing.assert_allclose(frame.positions[0], REST[5])


def test_a_known_skeleton_needs_no_names() -> None:
    positions = [[0.0, 0.0, float(row)] for row in range(17)]
    frame = decode(json.dumps({"stamp": 0, "skeleton": "COCO 17", "positions": positions}))
    assert frame.joints == COCO_17.joints
    np.testing.assert_array_equal(frame.positions[:, 2], np.arange(17))


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "truncated"),
        (b'{"stamp": 1', "truncated"),
        (b"\xff" * 20, "Expected `object`"),
        (json.dumps(message(stamp="noon")), "Expected `float`, got `str` - at `$.stamp`"),
        (json.dumps(message(stamp=1.8e12)), "stamp 1.8e+12 is no time in seconds"),
        (msgspec.msgpack.encode(message(stamp=float("nan"))), "stamp nan is no time"),
        (json.dumps(message(joints=["left_wrist"])), "6 rows for 1 joints"),
        (json.dumps(message(joints=None)), "neither joints nor skeleton"),
        (json.dumps(message(skeleton="octopus")), "skeleton 'octopus' is unknown; known are Azure Kinect 32"),
        (json.dumps(message(joints=["tail", *ARM_JOINTS[1:]])), "left_shoulder missing"),
        (json.dumps(message(joints=["Left Elbow", *ARM_JOINTS[1:]])), "joint left_elbow is there twice"),
        (json.dumps(message(positions=[[0, 0]] * 6)), "a position is not three numbers"),
        (json.dumps(message(positions=[[2e4, 0, 0], *REST[1:]])), "a position is 2e+04 m away, at most 10000 m"),
        (json.dumps(message(positions=REST * 30)), "180 rows, at most 128"),
        (json.dumps(message(std=[0.1])), "1 std for 6 rows"),
        (json.dumps(message(std=[-0.1] * 6)), "std is below 0"),
        (json.dumps(message(person="x" * 65)), "person 'xxx"),
        (json.dumps(message(person="a\nb")), "person 'a?b'"),
        (json.dumps(message(frame_id="")), "frame_id ''"),
        (json.dumps(message(extra="x" * LARGEST_MESSAGE)), f"at most {LARGEST_MESSAGE} are taken"),
        (b'{"x":' + b"[" * 30_000, "recursion"),
    ],
)
def test_what_is_wrong_is_said_in_a_line(content: bytes | str, words: str) -> None:
    with pytest.raises(MessageError) as caught:
        decode(content)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_whatever_comes_is_a_frame_or_refused_with_types_checked() -> None:
    fuzz(5000)


def test_whatever_comes_is_a_frame_or_refused() -> None:
    """10^5 messages, in a process of its own: checking types takes ten times as long as reading messages."""
    done = subprocess.run([sys.executable, "-W", "error", __file__], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def fuzz(count: int) -> None:
    """Messages from good ones by seeded damage: no other exception, and only frames that a predictor can take."""
    rng = random.Random(5)
    messages = [odd_message(rng) for _ in range(2000)]
    mailbox = Mailbox()
    feed = mailbox.feed("fuzz")
    guard = SenderGuard(feed)
    now = 0.0
    for _ in range(count):
        now += rng.choice((0.0, 0.001, 0.03, 3.0))
        guard.take(damaged(rng.choice(messages), rng), rng.randrange(20), now)
        while (arrival := mailbox.take(0.0)) is not None:
            assert plausible(arrival.frame)
            assert arrival.acquired <= now
    assert feed.received + feed.refused == count
    assert min(feed.received, feed.refused) > count // 10
    assert feed.clock_jumps > 0


def plausible(frame: SkeletonFrame) -> bool:
    """What decode promises."""
    shapes = frame.positions.shape == (len(frame.joints), 3) and (
        frame.std is None or len(frame.std) == len(frame.joints)
    )
    far = np.abs(frame.positions[frame.valid]).max(initial=0.0) > 1e4
    return shapes and not far and set(ARM_JOINTS) <= set(frame.joints) and abs(frame.stamp) <= 1e11


ODD: tuple[Any, ...] = (
    None, True, -1, 0, 2**63, -(2**63), 10**30, 1e308, -1e308, 5e-324, "", "left_wrist", "\x00", "é" * 70, [], [[]], {},
    [None] * 3, [[1, 2, 3]], {"a": {"b": []}}, [1e5, 0, 0], 1.8e12,
)  # fmt: skip
ODD_BYTES = (*ODD[:6], *ODD[7:], float("nan"), float("inf"), -float("inf"), b"\xff\xfe")
FIELDS = ("stamp", "joints", "positions", "person", "frame_id", "std", "skeleton", "unknown")


def odd_message(rng: random.Random) -> bytes:
    """A message that is good, or has odd values."""
    packed = rng.random() < 0.5
    content: dict[str, Any] = message(stamp=rng.choice((rng.uniform(0, 100), 1e9, -5.0)), person=str(rng.randrange(30)))
    for _ in range(rng.choice((0, 0, 1, 1, 2))):
        odd = rng.choice(ODD_BYTES if packed else ODD)
        place = rng.random()
        if place < 0.5:
            content[rng.choice(FIELDS)] = deepcopy(odd)
        elif place < 0.8 and isinstance(content.get("positions"), list) and content["positions"]:
            row = rng.randrange(len(content["positions"]))
            content["positions"][row] = deepcopy(odd) if rng.random() < 0.5 else [odd, 0.0, 1.0]
        else:
            content.pop(rng.choice(FIELDS), None)
    return encoded(content, packed)


def damaged(content: bytes, rng: random.Random) -> bytes:
    """The same, or cut, changed, with something nested in it, or repeated."""
    raw, kind = bytearray(content), rng.random()
    if kind < 0.1:
        del raw[rng.randrange(len(raw) + 1) :]
    elif kind < 0.4:
        for _ in range(rng.randrange(1, 4)):
            raw[rng.randrange(len(raw))] = rng.randrange(256)
    elif kind < 0.45:
        raw[rng.randrange(len(raw)) : 0] = rng.choice((b"[" * 500, b"\x91" * 500, b"\x81\xa1a" * 500, b'{"a":' * 500))
    elif kind < 0.455:
        raw *= 100
    return bytes(raw)


def encoded(content: dict[str, Any], packed: bool) -> bytes:
    """As msgpack where it is wanted and has numbers as large, else as JSON."""
    if packed:
        with suppress(OverflowError):
            return msgspec.msgpack.encode(content)
    return json.dumps(content, default=str).encode()


# Who may send what


def send(guard: SenderGuard, person: str, sender: str, at: float) -> None:
    guard.take(json.dumps(message(person=person, stamp=at)), sender, at)


def test_a_person_belongs_to_one_sender_until_it_is_silent_or_leaves() -> None:
    mailbox = Mailbox()
    feed = mailbox.feed("cameras")
    guard = SenderGuard(feed)
    send(guard, "anna", "left", 0.0)
    send(guard, "anna", "right", 0.1)
    assert (feed.received, feed.refused) == (1, 1)
    send(guard, "anna", "right", 0.1 + FORGET)
    assert (feed.received, feed.refused) == (2, 1)
    guard.leave("right")
    send(guard, "anna", "left", 0.2 + FORGET)
    assert (feed.received, feed.refused) == (3, 1)


def test_persons_and_senders_are_few() -> None:
    mailbox = Mailbox()
    feed = mailbox.feed("cameras")
    guard = SenderGuard(feed)
    for number in range(MOST_PERSONS + 3):
        send(guard, str(number), "one", 0.0)
    assert (feed.received, feed.refused) == (MOST_PERSONS, 3)
    for number in range(MOST_SENDERS + 2):
        send(guard, str(number), f"sender {number}", 10.0)
    assert (feed.received, feed.refused) == (MOST_PERSONS + MOST_SENDERS, 5)


def test_the_log_has_a_line_and_not_one_for_each(caplog: pytest.LogCaptureFixture) -> None:
    guard = SenderGuard(Mailbox().feed("liar"))
    for _ in range(1000):
        guard.take(b"{", "one", 0.0)
    assert 1 <= len(caplog.records) < 10
    assert caplog.records[0].getMessage().startswith("liar: ")


def sighted(**changes: Any) -> dict[str, Any]:
    """A message of pixels, changed."""
    pixels = [[100.0 + 10 * row, 200.0] for row in range(6)]
    return {"stamp": 1.5, "joints": list(ARM_JOINTS), "pixels": pixels, "camera": "left", **changes}


def test_pixels_come_through_as_a_view() -> None:
    pixels = [[10, 20], None, [None, 5], [1, 2], [3, 4], [5, 6]]
    content = sighted(pixels=pixels, depth=[2.5, None, 2, 2, 2, 2], pixel_std=[3] * 6, person="7")
    view = decode(json.dumps(content))
    assert isinstance(view, Detection)
    assert (view.camera, view.person, view.stamp, view.joints) == ("left", "7", 1.5, ARM_JOINTS)
    np.testing.assert_array_equal(view.seen, [True, False, False, True, True, True])
    assert view.depth[0] == 2.5
    assert np.isnan(view.depth[1])
    assert np.isnan(view.depth_std).all()
    np.testing.assert_array_equal(view.confidence, 1.0)
    assert isinstance(decode(msgspec.msgpack.encode(content)), Detection)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"positions": REST}, "either positions or pixels"),
        ({"pixels": None}, "either positions or pixels"),
        ({"pixels": [[1, 2, 3]] * 6}, "a pixel is not two numbers"),
        ({"pixels": [[1, 2]] * 5}, "5 rows for 6 joints"),
        ({"pixels": [[1, 2]] * 200, "joints": ["left_wrist"] * 200}, "200 rows, at most 128"),
        ({"depth": [1.0]}, "1 depth for 6 rows"),
        ({"confidence": [1.0] * 7}, "7 confidence for 6 rows"),
        ({"camera": "a\nb"}, "camera 'a?b'"),
    ],
)
def test_what_is_wrong_with_pixels_is_said_in_a_line(changes: dict[str, Any], words: str) -> None:
    with pytest.raises(MessageError) as caught:
        decode(json.dumps(sighted(**changes)))
    assert words in str(caught.value)


if __name__ == "__main__":
    fuzz(FUZZED)
