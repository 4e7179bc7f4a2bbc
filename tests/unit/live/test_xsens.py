"""Datagrams of MVN's network streamer: whole, in parts, late, lost, lying, and 30,000 of them that raise nothing."""

from __future__ import annotations

import random
import struct
import subprocess
import sys
from collections.abc import Sequence

import numpy as np
import pytest

from kinecast.body.skeleton import ARM_JOINTS, XSENS_23
from kinecast.live.mailbox import Feed, Mailbox
from kinecast.live.sender_guard import FORGET, MOST_PERSONS
from kinecast.live.xsens import XsensGuard, XsensOptions
from kinecast.types import SkeletonFrame

FUZZED = 30_000
BODY = np.random.default_rng(5).uniform((2.6, -2.4, 0.8), (3.4, -1.6, 1.6), (23, 3))
"""Origins of Xsens 23 [m], z up."""
QUATERNION, EULER = b"02", b"01"


def datagram(
    sample: int,
    items: Sequence[tuple[int, Sequence[float]]],
    part: int = 0x80,
    character: int = 0,
    kind: bytes = QUATERNION,
    milliseconds: int | None = None,
    old: bool = False,
) -> bytes:
    """As MVN packs it: (segment id, x y z) of each item; before MVN 2019 the header ended with seven empty bytes."""
    rest = (0.0, 0.0, 0.0) if kind == EULER else (1.0, 0.0, 0.0, 0.0)
    payload = b"".join(struct.pack(f">I{3 + len(rest)}f", number, *place, *rest) for number, place in items)
    code = 10 * sample % 2**32 if milliseconds is None else milliseconds
    header = b"MXTP" + kind + struct.pack(">IBBIB", sample, part, len(items), code, character)
    return header + (bytes(7) if old else struct.pack(">BBBHH", 23, 0, 40, 0, len(payload))) + payload


def body(positions: np.ndarray = BODY, first: int = 0, end: int = 23) -> list[tuple[int, Sequence[float]]]:
    """Items of segments; ids begin at 1."""
    return [(k + 1, positions[k]) for k in range(first, end)]


FINGERS = [(k, (9.0, 9.0, 9.0)) for k in range(24, 64)]


class Listener:
    """A guard, and what came through it."""

    def __init__(self, options: XsensOptions | None = None) -> None:
        self.mailbox = Mailbox()
        self.feed: Feed = self.mailbox.feed("xsens")
        self.guard = XsensGuard(self.feed, options or XsensOptions())
        self.now = 0.0

    def hear(self, *contents: bytes, sender: str = "suit") -> list[SkeletonFrame]:
        """The frames that datagrams make, a millisecond apart."""
        frames = []
        for content in contents:
            self.now += 0.001
            self.guard.take(content, sender, self.now)
            while (arrival := self.mailbox.take(0.0)) is not None:
                frames.append(arrival.frame)
        return frames


def test_a_pose_with_quaternions_is_a_frame() -> None:
    content = datagram(7, body(), character=3)
    assert len(content) == 760  # as MVN sends it
    (frame,) = Listener().hear(content)
    assert (frame.stamp, frame.person, frame.frame_id, frame.joints) == (0.07, "3", "world", XSENS_23.joints)
    np.testing.assert_allclose(frame.positions, BODY, atol=1e-6)
    wrist = frame.joints.index("left_wrist")
    np.testing.assert_allclose(frame.positions[wrist], BODY[14], atol=1e-6)  # Left Hand has index 14


@pytest.mark.parametrize(
    ("kind", "options", "scale", "old"),
    [
        (EULER, XsensOptions(), 100, False),
        (EULER, XsensOptions(), 1, True),
        (QUATERNION, XsensOptions(up="y"), 1, False),
        (QUATERNION, XsensOptions(up="y"), 100, True),
    ],
)
def test_units_and_axes_are_told(kind: bytes, options: XsensOptions, scale: float, old: bool) -> None:
    y_up = scale * BODY[:, [0, 2, 1]] * [1, 1, -1]  # right-handed still
    (frame,) = Listener(options).hear(datagram(1, body(y_up), kind=kind, old=old))
    np.testing.assert_allclose(frame.positions, BODY, atol=1e-5)
    (frame,) = Listener(XsensOptions(up="z")).hear(datagram(1, body(scale * BODY), kind=kind))
    np.testing.assert_allclose(frame.positions, BODY, atol=1e-5)


def test_parts_come_in_any_order_and_twice_of_several_persons_with_fingers_and_props() -> None:
    parts = {
        (character, sample, part): datagram(sample, items, part, character)
        for character in (0, 1)
        for sample in (5, 6, 9)
        for part, items in ((0, body(BODY + sample, 0, 12)), (1, body(BODY + sample, 12, 23)), (0x82, FINGERS))
    }
    order = [(0, 5, 1), (1, 5, 0x82), (0, 5, 1), (1, 5, 0), (0, 6, 1), (0, 5, 0), (1, 5, 1), (1, 5, 1), (0, 5, 0x82),
             (0, 6, 0x82), (0, 6, 0), (1, 6, 0), (1, 9, 1), (1, 6, 1), (1, 9, 0), (0, 9, 0), (0, 9, 0x82), (0, 9, 1),
             (1, 9, 0x82), (0, 9, 1)]  # fmt: skip
    listener = Listener()
    frames = listener.hear(*(parts[each] for each in order))
    assert [(frame.person, round(100 * frame.stamp)) for frame in frames] == [
        ("0", 5), ("1", 5), ("0", 6), ("1", 6), ("1", 9), ("0", 9)
    ]  # fmt: skip
    for frame in frames:
        np.testing.assert_allclose(frame.positions, BODY + 100 * frame.stamp, atol=1e-5)
    assert listener.feed.refused == 0
    assert len(Listener(XsensOptions(person=1)).hear(*(parts[each] for each in order))) == 3


def test_a_sample_whose_part_is_lost_is_given_up_for_a_newer_one() -> None:
    listener = Listener()
    first, second = body(end=12), body(first=12)
    frames = listener.hear(
        datagram(1, first, 0), datagram(1, second, 0x81), datagram(2, first, 0), datagram(3, first, 0),
        datagram(3, second, 0x81), datagram(2, second, 0x81),
    )  # fmt: skip
    assert [frame.stamp for frame in frames] == [0.01, 0.03]
    assert listener.feed.refused == 2  # one for the loss, one for what came too late


def test_where_a_part_never_comes_its_joints_are_not_seen() -> None:
    listener = Listener()
    frames = listener.hear(*(datagram(k, body(end=12), 0) for k in range(20)))
    assert [round(100 * frame.stamp) for frame in frames] == list(range(17))
    np.testing.assert_array_equal(frames[0].valid, [True] * 12 + [False] * 11)  # one arm, and of the other the clavicle
    items = [(number, place if number != 15 else (np.nan, 0.0, 0.0)) for number, place in body()]
    (frame,) = listener.hear(datagram(100, items))
    assert [joint for joint, seen in zip(frame.joints, frame.valid, strict=True) if not seen] == ["left_wrist"]


def test_a_suit_that_begins_anew_or_from_elsewhere_is_followed() -> None:
    listener = Listener()
    assert len(listener.hear(*(datagram(k, body()) for k in range(1000, 1010)))) == 10
    assert len(listener.hear(*(datagram(k, body()) for k in range(10)))) == 10
    listener.now += FORGET
    assert len(listener.hear(*(datagram(k, body()) for k in range(10)))) == 10
    assert not listener.hear(datagram(10, body()), sender="another")
    listener.now += FORGET
    assert len(listener.hear(datagram(11, body()), sender="another")) == 1
    listener.now += FORGET
    assert len(listener.hear(*(datagram(k % 2**32, body()) for k in range(2**32 - 2, 2**32 + 2)))) == 4


def test_a_time_code_that_stands_still_says_what_to_do(caplog: pytest.LogCaptureFixture) -> None:
    still = [datagram(k, body(), milliseconds=5) for k in range(3)]
    assert len(Listener().hear(*still)) == 1
    assert "the time code stands still; ?stamps=arrival" in caplog.text
    assert [frame.stamp for frame in Listener(XsensOptions(stamps="arrival")).hear(*still)] == [0.001, 0.002, 0.003]


@pytest.mark.parametrize("kind", [b"10", b"11", b"12", b"13", b"20", b"21", b"22", b"23", b"24", b"25"])
def test_what_is_streamed_beside_the_pose_is_passed_over(kind: bytes) -> None:
    listener = Listener()
    frames = listener.hear(datagram(1, body()), b"MXTP" + kind + bytes(18) + b"name:Anna\n", datagram(2, body()))
    assert len(frames) == 2
    assert listener.feed.refused == 0


def test_the_same_pose_in_two_types_is_one() -> None:
    listener = Listener()
    assert len(listener.hear(datagram(1, body()), datagram(1, body(), kind=EULER), datagram(2, body()))) == 2
    assert listener.feed.refused == 0


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "0 bytes are no datagram of MVN's"),
        (b"NATNET" + bytes(30), "36 bytes are no datagram of MVN's"),
        (b"MXTP0x" + bytes(30), "36 bytes are no datagram of MVN's"),
        (datagram(1, body(), kind=b"05"), "type 05: choose position and orientation (quaternion)"),
        (datagram(1, body())[:-1], "735 bytes for 23 segments of 32 bytes, said to be 736"),
        (datagram(1, body()) + b"\0", "737 bytes for 23 segments"),
        (datagram(1, body(end=3) + body(end=3)), "sample 1 has a segment twice"),
        (datagram(1, body(1e5 + BODY)), "a segment is 1e+05 m away, at most 10000 m"),
    ],
)
def test_what_is_wrong_is_said_in_a_line(content: bytes, words: str, caplog: pytest.LogCaptureFixture) -> None:
    listener = Listener()
    assert not listener.hear(content)
    assert listener.feed.refused == 1
    assert words in caplog.text


def test_parts_that_contradict_are_refused() -> None:
    listener = Listener()
    assert not listener.hear(
        datagram(1, body(end=12), 0), datagram(1, body(first=11), 0x81), datagram(1, body(first=12), 0x81, 0, b"02", 9)
    )
    assert listener.feed.refused == 2


def test_characters_are_few() -> None:
    listener = Listener()
    frames = listener.hear(*(datagram(1, body(), character=k) for k in range(MOST_PERSONS + 3)))
    assert (len(frames), listener.feed.refused) == (MOST_PERSONS, 3)


def test_whatever_comes_is_a_frame_or_refused_with_types_checked() -> None:
    fuzz(3000)


def test_whatever_comes_is_a_frame_or_refused() -> None:
    """30,000 datagrams, in a process of its own: checking types takes longer than reading."""
    done = subprocess.run([sys.executable, "-W", "error", __file__], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def fuzz(count: int) -> None:
    """Seeded streams of whole and split poses, lost, repeated, shuffled and damaged: nothing is raised or piles up."""
    rng = random.Random(9)
    bursts = [[content for _ in range(8) for content in odd_sample(rng)] for _ in range(300)]
    listener = Listener()
    guard, mailbox, feed = listener.guard, listener.mailbox, listener.feed
    now, taken = 0.0, 0
    while taken < count:
        burst = rng.choice(bursts)
        for content in rng.sample(burst, len(burst)):
            now += rng.choice((0.1, 3.0)) if rng.random() < 0.02 else 0.001
            taken += 1
            guard.take(damaged(content, rng), rng.randrange(30) if rng.random() < 0.2 else "suit", now)
        while (arrival := mailbox.take(0.0)) is not None:
            assert plausible(arrival.frame)
    assert feed.received > count // 20
    assert feed.refused > count // 10
    assert sum(len(each.pending) for each in guard.characters.values()) <= 4 * MOST_PERSONS


def plausible(frame: SkeletonFrame) -> bool:
    """What the source promises."""
    near = np.abs(frame.positions[frame.valid]).max(initial=0.0) <= 1e4
    return near and frame.positions.shape == (23, 3) and set(ARM_JOINTS) <= set(frame.joints) and frame.stamp < 1e8


def odd_sample(rng: random.Random) -> list[bytes]:
    """Datagrams of one pose, whole or split, with odd numbers in some."""
    number = rng.choice((rng.randrange(400), rng.randrange(400), rng.randrange(2**32), 0, 2**32 - 1))
    character = rng.randrange(3) if rng.random() < 0.95 else rng.randrange(256)
    kind = rng.choices((b"02", b"01", b"12", b"05", b"99", b"25"), (20, 5, 1, 1, 1, 1))[0]
    items = list(body())
    if rng.random() < 0.2:
        odd = rng.choice((float("nan"), float("inf"), -3e38, 1e-45, 0.0))
        items[rng.randrange(23)] = (rng.choice((0, 1, 9, 10, 24, 2**32 - 1)), (odd, 0.0, odd))
    if rng.random() < 0.4:
        return [datagram(number, items, 0x80, character, kind)]
    cut = rng.randrange(24)
    parts = [(0, items[:cut]), (1, items[cut:]), (rng.choice((0x82, 2, 0xFF, 0x81)), FINGERS[: rng.randrange(41)])]
    kept = [each for each in parts if rng.random() < 0.9]
    return [datagram(number, each, part, character, kind) for part, each in kept for _ in range(rng.choice((1, 1, 2)))]


def damaged(content: bytes, rng: random.Random) -> bytes:
    """The same, or cut, changed, lengthened or noise."""
    raw, kind = bytearray(content), rng.random()
    if kind < 0.05:
        del raw[rng.randrange(len(raw) + 1) :]
    elif kind < 0.2:
        for _ in range(rng.randrange(1, 4)):
            raw[rng.randrange(len(raw))] = rng.randrange(256)
    elif kind < 0.22:
        raw += rng.randbytes(rng.randrange(1, 2000))
    elif kind < 0.24:
        raw[rng.randrange(24) :] = rng.randbytes(rng.randrange(800))
    return bytes(raw)


if __name__ == "__main__":
    fuzz(FUZZED)
