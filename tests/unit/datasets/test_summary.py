"""Summaries: the numbers are those of the recording, in JSON and in words."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from kinecast.body.skeleton import ARM_JOINTS
from kinecast.datasets.loading import load
from kinecast.datasets.recording import Recording
from kinecast.datasets.summary import summarise

ELBOW, WRIST = ARM_JOINTS.index("left_elbow"), ARM_JOINTS.index("right_wrist")
PLACES = np.array([[0, 0.2, 1.4], [0, 0.2, 1.1], [0.25, 0.2, 1.1], [0, -0.2, 1.4], [0, -0.2, 1.1], [0.25, -0.2, 1.1]])


def walking(frames: int = 100) -> Recording:
    """A body carried along at 0.5 m/s, elbows at a right angle, bones of 0.30 and 0.25 m."""
    t = np.arange(frames) / 50.0
    positions = PLACES + t[:, None, None] * [0.5, 0.0, 0.0]
    labels = (("walk",) * 30 + ("stand",) * 70)[:frames]
    return Recording("walking", ARM_JOINTS, t, positions, 50.0, labels=labels, notes=("made by hand",))


def test_the_numbers_of_a_known_recording() -> None:
    recording = walking()
    recording.positions[10] = recording.positions[9]
    recording.positions[20:23, ELBOW] = np.nan
    recording.positions[40:80, ELBOW] = np.nan
    recording.positions[50:52, WRIST] += [0.0, 0.0, 0.5]
    summary = summarise(recording)

    said = summary.as_json()
    assert (said["frames"], said["rate"]) == (100, 50.0)
    assert summary.measured_rate == pytest.approx(50.0)
    assert said["duration"] == pytest.approx(1.98)
    assert summary.repeated_frames == 1
    assert dict(summary.labels) == {"stand": 70, "walk": 30}
    elbow = summary.joints["left_elbow"]
    assert (elbow["gaps"], elbow["missing"], elbow["jumps"]) == (2, 0.43, 0)
    assert elbow["longest_gap"] == pytest.approx(0.8)
    assert (elbow["interpolated"], elbow["left_missing"]) == (4, 40)
    wrist = summary.joints["right_wrist"]
    assert (wrist["gaps"], wrist["jumps"], wrist["interpolated"], wrist["left_missing"]) == (0, 1, 3, 0)
    assert summary.bones["right_upper_arm"]["median"] == pytest.approx(0.30)
    assert summary.bones["left_forearm"]["median"] == pytest.approx(0.25)
    assert summary.bones["shoulder_width"]["median"] == pytest.approx(0.4)
    assert summary.bones["left_forearm"]["variation"] == pytest.approx(0.0, abs=1e-9)
    speed = summary.speeds["right_wrist"]
    assert (speed["p50"], speed["p99"], speed["max"]) == pytest.approx((0.5, 0.5, 0.5)), "repeats and jumps left out"
    assert (summary.outside_range, summary.too_fast) == (0.0, 0.0)


def test_bones_that_breathe_are_told() -> None:
    recording = walking()
    swell = 1.0 + 0.05 * np.sin(np.arange(100))
    shoulder = recording.positions[:, 0].copy()
    recording.positions[:, ELBOW] = shoulder + swell[:, None] * (recording.positions[:, ELBOW] - shoulder)
    assert summarise(recording).bones["left_upper_arm"]["variation"] == pytest.approx(0.05, abs=0.003)


def test_an_arm_bent_backwards_is_outside_its_range() -> None:
    recording = walking()
    # Upper arm behind the back by 120 degrees.
    recording.positions[:25, ELBOW] += [-0.26, 0.0, 0.45]
    summary = summarise(recording)
    assert summary.outside_range == pytest.approx(0.25, abs=0.01)


def test_words_and_json_say_the_same() -> None:
    recording = walking()
    recording.positions[40:80, ELBOW] = np.nan
    summary = summarise(recording)
    said = json.loads(json.dumps(summary.as_json(), allow_nan=False))
    assert said["joints"]["left_elbow"]["longest_gap"] == pytest.approx(0.8)
    assert said["joint_names"] == list(ARM_JOINTS)
    text = "\n".join(summary.lines())
    for fact in (
        "walking: generated, 100 frames, 2.0 s at 50 Hz",
        "labels: stand (70), walk (30)",
        "left_elbow: missing in 40.0% of frames (gaps: 1, longest 0.80 s)",
        "left_forearm: 250 mm",
        "note: made by hand",
        "leave 40 missing",
    ):
        assert fact in text


def test_what_cannot_be_known_is_none() -> None:
    recording = walking(1)
    said = summarise(recording).as_json()
    assert said["measured_rate"] is None
    empty = replace(walking(), positions=np.full((100, 6, 3), np.nan))
    summary = summarise(empty)
    assert np.isnan(summary.outside_range)
    json.dumps(summary.as_json(), allow_nan=False)
    assert summary.lines()
    armless = replace(walking(), joints=("head",), positions=np.zeros((100, 1, 3)))
    json.dumps(summarise(armless).as_json(), allow_nan=False)


def test_a_real_recording(data_root: Path) -> None:
    (recording,) = load(data_root / "ha4m_features_demo" / "UpSkel" / "IDU001V001.npy")
    summary = summarise(recording)
    assert summary.repeated_frames / len(recording.stamps) == pytest.approx(0.028, abs=0.001)
    assert all(summary.joints[joint]["jumps"] >= 3 for joint in ARM_JOINTS)
    assert 0.2 < summary.bones["left_forearm"]["median"] < 0.3
    assert summary.outside_range < 0.05
    assert len(summary.labels) == 13
