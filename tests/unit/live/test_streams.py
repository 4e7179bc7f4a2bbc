"""Clocks of senders, the mailbox between sources and predictor, and recordings as cameras."""

from __future__ import annotations

import numpy as np
import pytest

from kinecast.body.skeleton import ARM_JOINTS
from kinecast.errors import OptionError
from kinecast.live.clock import CONFIRM, SourceClock
from kinecast.live.mailbox import Mailbox
from kinecast.live.network import Address
from kinecast.live.settings import read_settings
from kinecast.live.sources import PlaybackOptions, RecordedSource
from kinecast.types import SkeletonFrame


def frame(stamp: float, person: str = "0") -> SkeletonFrame:
    return SkeletonFrame(float(stamp), ARM_JOINTS, np.zeros((6, 3)), person)


def test_a_sender_is_as_late_as_beyond_its_fastest_message() -> None:
    clock = SourceClock()
    delays = [0.03, 0.01, 0.05, 0.01]
    acquired = [clock.acquired(1000.0 + k / 30, k / 30 + delay) for k, delay in enumerate(delays)]
    late = [k / 30 + delay - each for k, (delay, each) in enumerate(zip(delays, acquired, strict=True))]
    np.testing.assert_allclose(late, [0.0, 0.0, 0.04, 0.0], atol=1e-9)
    assert clock.difference == pytest.approx(-999.99)
    assert clock.jumps == 0


def test_a_slow_drift_is_followed() -> None:
    clock = SourceClock()
    for k in range(4000):  # a clock that loses a millisecond a second, for 133 s
        arrived = k / 30
        acquired = clock.acquired(arrived * (1 - 1e-3), arrived)
    assert arrived - acquired < 0.031
    assert clock.jumps == 0


def test_a_stall_is_late_and_a_clock_that_was_set_is_followed() -> None:
    clock = SourceClock()
    clock.acquired(0.0, 0.0)
    assert clock.acquired(0.1, 3.1) == pytest.approx(0.1)  # three seconds in a network's buffers
    assert clock.acquired(3.2, 3.2) == pytest.approx(3.2)
    assert clock.jumps == 0
    for k in range(60):  # set back by an hour
        arrived = 3.3 + k / 30
        acquired = clock.acquired(arrived - 3600, arrived)
        assert (arrived - acquired < 0.01) == (k / 30 >= CONFIRM - 1e-9)
    assert clock.jumps == 1
    assert clock.acquired(9000.0, 6.0) == 6.0  # set forward
    assert clock.jumps == 2


def test_the_newest_frame_of_each_person_waits_and_sources_take_turns() -> None:
    mailbox = Mailbox()
    busy, calm = mailbox.feed("busy"), mailbox.feed("calm")
    for k in range(100):
        busy.put(frame(k, person=str(k % 4)), float(k))
    calm.put(frame(0.5), 0.5)
    taken = []
    while (arrival := mailbox.take(0.0)) is not None:
        taken.append((arrival.feed.name, arrival.frame.person, arrival.frame.stamp))
    assert [each[0] for each in taken] == ["busy", "calm", "busy", "busy", "busy"]
    assert sorted(each[1:] for each in taken if each[0] == "busy") == [("0", 96), ("1", 97), ("2", 98), ("3", 99)]
    assert (busy.received, busy.superseded, calm.superseded) == (100, 96, 0)
    assert not mailbox.finished
    busy.end()
    calm.end()
    assert mailbox.finished


def test_a_recording_is_played_to_its_end_and_again() -> None:
    mailbox = Mailbox()
    feed = mailbox.feed("recording")
    source = RecordedSource("recording", feed, [frame(k / 10) for k in range(10)], PlaybackOptions(20.0, 2))
    source.start()
    stamps, acquired = [], []
    while not mailbox.finished:
        if arrival := mailbox.take(1.0):
            stamps.append(arrival.frame.stamp)
            acquired.append(arrival.acquired)
    source.close()
    assert feed.received == 20
    assert len(stamps) + feed.superseded == 20
    assert stamps[-1] == pytest.approx(1.9)
    np.testing.assert_allclose(np.diff(acquired), np.diff(stamps) / 20, atol=1e-6)


@pytest.mark.parametrize(
    ("query", "words"),
    [
        ("speed=0", r"take: speed '0', expected 0\.01\.\.1000"),
        ("speed=nan&repeat=2", r"take: speed 'nan', expected 0\.01\.\.1000"),
        ("speed=fast", r"take: speed 'fast', expected 0\.01\.\.1000"),
        ("repeat=0", r"take: repeat '0', expected a whole number in 1\.\.100000"),
        ("repeat=1.5", "take: repeat '1.5', expected a whole number"),
        ("pace=1", "take: pace unknown; allowed are speed, repeat"),
        ("pace", "take: pace unknown; allowed are speed, repeat"),
        ("&", "take: & unknown"),
    ],
)
def test_settings_that_cannot_be_are_refused(query: str, words: str) -> None:
    with pytest.raises(OptionError, match=words):
        read_settings(PlaybackOptions, query, "take")


def test_settings_are_read_and_empty_ones_are_not_given() -> None:
    assert read_settings(PlaybackOptions, "repeat=3&speed=", "take") == PlaybackOptions(1.0, 3)


def test_without_a_host_only_this_machine_is_heard() -> None:
    assert Address.parse("ws://:8765") == Address("ws", "127.0.0.1", 8765)
    assert Address.parse("udp://0.0.0.0:1") == Address("udp", "0.0.0.0", 1)
    assert str(Address.parse("ws://[::1]:80/")) == "ws://[::1]:80"
