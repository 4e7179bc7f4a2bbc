"""People, and the camera that sees them."""

from __future__ import annotations

import numpy as np
import pytest

from kinecast.datasets.recording import Recording
from kinecast.robot.cell import Cell
from kinecast.robot.collaboration import replayed_person
from kinecast.robot.separation import Moving
from kinecast.robot.simulated_person import Camera, PlayedPerson, ReactivePerson

from .conftest import FaultyCamera

JOINTS = (
    "left_shoulder", "left_elbow", "left_wrist", "right_shoulder", "right_elbow", "right_wrist", "head", "pelvis",
)  # fmt: skip
POSE = np.array([
    [0.0, 0.2, 1.4], [0.1, 0.25, 1.1], [0.35, 0.2, 1.05],
    [0.0, -0.2, 1.4], [0.1, -0.25, 1.1], [0.35, -0.2, 1.05], [0.05, 0.0, 1.65], [0.0, 0.0, 0.9],
])  # fmt: skip

THERE = Moving(np.array([[1.0, 0.2, 0.9, 1.0, 0.2, 1.3, 0.05]]), np.zeros((1, 6)), np.zeros(1))
"""An arm in the way."""


def mover(speed: float = 0.5, duration: float = 3.0) -> PlayedPerson:
    """Somebody who glides along x."""
    stamps = np.linspace(0.0, duration, 31)
    positions = POSE + (speed * stamps)[:, None, None] * [1.0, 0.0, 0.0]
    return PlayedPerson("a", JOINTS, stamps, positions)


def test_a_played_person_moves_evenly_and_stands_before_and_after() -> None:
    person = mover()
    np.testing.assert_allclose(person.at(1.234), POSE + np.array([0.617, 0, 0]), atol=1e-12)
    np.testing.assert_allclose(person.at(-5.0), POSE)
    np.testing.assert_allclose(person.at(50.0), POSE + np.array([1.5, 0, 0]))


def test_gaps_in_a_recording_are_bridged() -> None:
    positions = np.repeat(POSE[None], 5, axis=0)
    positions[:, 2, 0] += np.arange(5.0)
    positions[2, 2] = np.nan
    person = PlayedPerson("a", JOINTS, np.arange(5.0), positions)
    assert person.at(2.0)[2, 0] == pytest.approx(2.35)


def test_a_mindful_person_stops_short_of_an_arm_and_goes_on_when_it_is_gone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("kinecast.robot.simulated_person.PATIENCE", 9.0)
    person = ReactivePerson(mover())
    for k in range(200):
        person.mind(THERE, 0.02 * k)
    reached = person.at(4.0)[2, 0]
    assert 0.55 < reached < 0.85
    for k in range(200, 360):
        person.mind(THERE._replace(capsules=THERE.capsules + 9.0), 0.02 * k)
    assert person.at(7.2)[2, 0] > 1.4
    assert person.at(4.0)[2, 0] == pytest.approx(reached), "what was done stays done"


def test_a_mindful_person_does_not_wait_for_ever_but_draws_back_and_tries_again() -> None:
    person = ReactivePerson(mover())
    for k in range(400):
        person.mind(THERE, 0.02 * k)
    hand = np.array([person.at(0.02 * k)[2, 0] for k in range(400)])
    assert hand.max() < 0.85
    first = int(np.argmax(hand > 0.6))
    drawn_back = first + int(np.argmin(hand[first:]))
    assert hand[drawn_back] < 0.4
    assert hand[drawn_back:].max() > 0.6


def test_a_mindful_person_passes_a_standing_arm_that_leaves_some_room_at_the_second_try() -> None:
    beside = THERE._replace(capsules=THERE.capsules + 0.2 * np.eye(7)[[1, 4]].sum(axis=0))  # 4 cm from the elbow's way
    person = ReactivePerson(mover())
    hand = np.zeros(500)
    for k in range(500):
        person.mind(beside, 0.02 * k)
        hand[k] = person.at(0.02 * k)[2, 0]
    assert hand[100] < 1.3, "at first they stop"
    assert hand[-1] > 1.8


def test_the_camera_takes_every_shot_once_late_and_the_same_for_the_same_seed() -> None:
    person = mover()
    one, other = Camera(delay=0.05, seed=3), Camera(delay=0.05, seed=3)
    shots, arrivals = [], []
    for k in range(250):
        for shot in one.shots(k / 125, [person]):
            shots.append(shot)
            arrivals.append(k / 125)
    at_once = other.shots(2.0, [person])
    stamps = np.array([shot.stamp for shot in shots])
    assert np.all(np.diff(stamps) > 0.03)
    late = np.array(arrivals) - stamps
    assert 0.05 - 1e-9 <= late.min() <= late.max() < 0.05 + 1 / 125
    for a, b in zip(shots, at_once, strict=False):
        np.testing.assert_array_equal(a.frames[0].positions, b.frames[0].positions)
    errors = np.concatenate([shot.frames[0].positions - person.at(shot.stamp) for shot in shots]).ravel()
    errors = errors[np.isfinite(errors)]
    assert np.std(errors) == pytest.approx(one.noise, rel=5 / np.sqrt(2 * len(errors)))


def test_the_camera_falls_silent_goes_blind_and_loses_arms() -> None:
    camera = FaultyCamera(noise=0.0, dropped=0.0, lost=0.0, silent=((0.5, 1.0),), blind=((1.2, 1.4),))
    shots = camera.shots(2.0, [mover()])
    assert not any(0.5 <= shot.stamp < 1.0 for shot in shots)
    for shot in shots:
        assert np.isnan(shot.frames[0].positions).all() == (1.2 <= shot.stamp < 1.4)
    lossy = Camera(lost=0.5, dropped=0.0).shots(3.0, [mover()])
    lost = sum(not shot.frames[0].valid.all() for shot in lossy)
    assert abs(lost / len(lossy) - 0.5) < 4 * 0.5 / np.sqrt(len(lossy))
    assert all(shot.frames[0].valid[[0, 3, 6, 7]].all() for shot in lossy), "shoulders, head and hips are seen"


def test_a_recorded_person_stands_at_the_table_and_moves_as_they_did_without_the_trackers_noise() -> None:
    stamps = np.arange(0.0, 8.0, 1 / 30)
    way = 0.2 * np.sin(2 * np.pi * 1.0 * stamps)
    noise = np.random.default_rng(0).normal(0.0, 0.004, (len(stamps), len(JOINTS), 3))
    positions = POSE + noise
    positions[:, 2, 0] += way
    cell = Cell()
    person = replayed_person(Recording("take", JOINTS, stamps, positions, 30.0), cell)
    shoulders = np.mean([person.at(float(t))[[0, 3]] for t in stamps], axis=(0, 1))
    np.testing.assert_allclose(shoulders[:2], cell.person[:2, 3], atol=0.02)
    hand = np.array([person.at(float(t))[2] for t in stamps])
    towards = -(hand - hand.mean(axis=0))[:, 0]  # they look at the arm
    np.testing.assert_allclose(towards, way - way.mean(), atol=0.015)
    assert np.abs(np.diff(towards - way, 2)).std() < 0.3 * np.abs(np.diff(noise[:, 2, 0], 2)).std()


def test_no_joint_of_a_recorded_person_gains_speed_as_only_a_tracker_does() -> None:
    stamps = np.arange(0.0, 8.0, 1 / 30)
    positions = np.repeat(POSE[None], len(stamps), axis=0)
    positions[:, 2, 2] += 0.1 * np.sin(2 * np.pi * 0.5 * stamps)
    positions[(stamps > 4.0) & (stamps < 5.0), 2, 1] += 0.5  # the hand is taken for the other one
    person = replayed_person(Recording("take", JOINTS, stamps, positions, 30.0), Cell())
    gained = np.linalg.norm(np.diff(person.positions, n=2, axis=0), axis=2) * 30.0**2
    assert gained.max() <= 30.0
    before = person.positions[stamps < 3.5, 2, 2]
    assert np.ptp(before) == pytest.approx(0.2, rel=0.05), "what hands do remains"
